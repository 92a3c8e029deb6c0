# SPDX-License-Identifier: GPL-3.0-or-later
"""Median depth against closed forms, and the CPU's against the reference."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize import median_depth, rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.tests.backend.rasterize.test_contract import camera, random_gaussians

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def planes(depths, opacities, size=3.0):
    """Gaussians so wide that each is a plane of one alpha, at ``depths`` before a camera at the origin."""
    count = len(depths)
    means = torch.tensor([[0.0, 0.0, -depth] for depth in depths])
    scales = torch.tensor([[1000.0 * size, 1000.0 * size, 0.01]]).expand(count, 3).contiguous()
    return means, torch.tensor([UPRIGHT]).expand(count, 4).contiguous(), scales, torch.tensor(opacities)


def straight(width=21, height=13) -> Camera:
    return Camera.from_field_of_view(np.eye(4), width, height, 0.8)


def summed_to_a_half(depths, opacities) -> float:
    """The closed form: the first plane at which Σ ln(1 − alpha), in float64, is ln ½ or less; else 0."""
    total = 0.0
    for depth, opacity in sorted(zip(depths, opacities, strict=True)):
        total += math.log1p(-min(opacity, 0.999))
        if total <= math.log(0.5):
            return depth
    return 0.0


@pytest.mark.parametrize("implementation", ["reference", "cpu"])
@pytest.mark.parametrize(
    "opacities, which",
    [
        ((0.9, 0.9, 0.9, 0.9), 0),
        ((0.3, 0.3, 0.9, 0.9), 1),  # 0.7 · 0.7 = 0.49
        ((0.2, 0.2, 0.2, 0.2), 3),
        ((0.1, 0.1, 0.1, 0.1), None),
        ((0.49, 0.003, 0.003, 0.05), 3),  # what is below 1/255 is not drawn
    ],
)
def test_a_stack_of_planes(implementation: str, opacities, which) -> None:
    depths = [3.0, 1.0, 2.5, 1.5]
    near_to_far = sorted(depths)
    by_depth = dict(zip(near_to_far, opacities, strict=True))
    alphas = [by_depth[depth] for depth in depths]
    drawn = [(d, a) for d, a in zip(depths, alphas, strict=True) if a >= 1.0 / 255.0]
    expected = summed_to_a_half(*zip(*drawn, strict=True))
    found = median_depth(*planes(depths, alphas), straight(), implementation=implementation)
    assert found.shape == (13, 21)
    torch.testing.assert_close(found, torch.full_like(found, expected))
    assert expected == (0.0 if which is None else near_to_far[which])


@pytest.mark.parametrize("size", [(67, 45), (1, 1), (128, 64)])
def test_the_cpu_finds_what_the_reference_finds(size) -> None:
    view = camera(*size)
    tensors = random_gaussians(90, 1, view)[:4]
    expected = median_depth(*(each.double() for each in tensors), view)
    found = median_depth(*tensors, view)
    covered = rasterize(*tensors, torch.ones(90, 1), view).alpha
    # Where rounding decides which side of a half a pixel is on, either Gaussian is right.
    is_equal = torch.isclose(found.double(), expected, atol=1e-5)
    assert is_equal.float().mean() > 0.998
    assert torch.equal(found > 0.0, covered >= 0.5)
    if size[0] > 1:
        assert 0.05 < (found > 0.0).float().mean() < 1.0


def test_the_median_is_on_a_surface_where_the_mean_is_between_two() -> None:
    shape = planes([1.0, 4.0], [0.4, 0.95])
    drawn = rasterize(*shape, torch.zeros(2, 1), straight(), with_depth=True)
    assert drawn.depth is not None and 2.0 < drawn.depth.mean() < 3.5
    torch.testing.assert_close(median_depth(*shape, straight()), torch.full((13, 21), 4.0))


@pytest.mark.parametrize("turn", [0.0, 0.6, 1.1])
def test_a_flat_gaussian_is_met_in_its_plane(turn: float) -> None:
    """Not at its centre's depth: a ray meets the tilted plane at depth n · m / n · d."""
    view = camera()
    quaternion = torch.tensor([[math.cos(turn / 2), math.sin(turn / 2), 0.0, 0.0]])
    mean = torch.from_numpy(view.camera_to_world[:3] @ [0.2, 0.1, -2.0, 1.0]).float()[None]
    shape = mean, quaternion, torch.tensor([[0.5, 0.5, 1e-4]]), torch.ones(1)
    found = median_depth(*shape, view).double().numpy()

    normal = view.world_to_camera[:3, :3] @ [0.0, -math.sin(turn), math.cos(turn)]
    centre = view.world_to_camera[:3] @ [*mean[0].tolist(), 1.0]
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    rays = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=-1)
    covered = found > 0.0
    assert covered.sum() > 30
    np.testing.assert_allclose(found[covered], (normal @ centre / (rays @ normal))[covered], rtol=1e-5)
    if turn:
        assert np.ptp(found[covered]) > 0.1


def test_what_is_behind_or_beside_the_camera_is_nowhere() -> None:
    means = torch.tensor([[0.0, 0.0, 2.0], [50.0, 0.0, -2.0]])
    shape = means, torch.tensor([UPRIGHT]).expand(2, 4).contiguous(), torch.full((2, 3), 0.1), torch.ones(2)
    assert not median_depth(*shape, straight()).any()
