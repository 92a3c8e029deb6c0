# SPDX-License-Identifier: GPL-3.0-or-later
"""Every rasteriser of float32 that runs on the CPU, against float64 autograd of the reference."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize import cpu, rasterize
from physhdr.backend.rasterize.cpu.projection import project
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.splatting import ALPHA_MAX
from physhdr.tests.backend.threads import assert_same_bits

NAMES = ("means", "quaternions", "scales", "opacities", "colours", "screen_offsets")


def camera(width=67, height=45, **changes) -> Camera:
    """A camera at (0.1, −0.2, 0.3), turned, with an off-centre principal point."""
    angle = 0.3
    pose = np.eye(4)
    pose[:3, :3] = [
        [math.cos(angle), 0, math.sin(angle)],
        [0, 1, 0],
        [-math.sin(angle), 0, math.cos(angle)],
    ]
    pose[:3, 3] = (0.1, -0.2, 0.3)
    values = {"fx": 60.0, "fy": 55.0, "cx": 0.45 * width, "cy": 0.55 * height} | changes
    return Camera(pose, width, height, **values)


def random_gaussians(count, channels, view, seed=0, spread=1.3):
    """Gaussians in front of the camera, ``spread`` times as wide as its view, of many shapes (float32)."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape):
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    depth = 0.5 + 4.0 * uniform(count)
    x = spread * (uniform(count) - 0.5) * view.width / view.fx * depth
    y = spread * (uniform(count) - 0.5) * view.height / view.fy * depth
    in_camera = torch.stack([x, -y, -depth], dim=1)
    pose = torch.from_numpy(view.camera_to_world)
    tensors = (
        in_camera @ pose[:3, :3].T + pose[:3, 3],
        3.0 * torch.randn(count, 4, generator=generator, dtype=torch.float64),
        0.01 * torch.exp(3.0 * uniform(count, 3)),
        uniform(count),
        2.0 * uniform(count, channels) - 0.5,
    )
    return [t.float() for t in tensors]


def draw_with_gradients(implementation, tensors, view, dtype, seed=1):
    """(Rasterization, the six gradients) for random weights on image and alpha."""
    tensors = [*tensors, torch.zeros(tensors[0].shape[0], 2)]
    tensors = [t.detach().to(dtype).clone().requires_grad_() for t in tensors]
    result = rasterize(*tensors[:5], view, screen_offsets=tensors[5], implementation=implementation)
    generator = torch.Generator().manual_seed(seed)
    weights = torch.randn(result.image.shape, generator=generator).to(dtype)
    alpha_weights = torch.randn(result.alpha.shape, generator=generator).to(dtype)
    ((result.image * weights).sum() + (result.alpha * alpha_weights).sum()).backward()
    return result, [t.grad for t in tensors]


def assert_matches_reference(implementation, tensors, view, image=2e-5, gradient=1e-4):
    ours, our_gradients = draw_with_gradients(implementation, tensors, view, torch.float32)
    truth, true_gradients = draw_with_gradients("reference", tensors, view, torch.float64)
    assert (ours.image - truth.image).abs().max() <= image
    assert (ours.alpha - truth.alpha).abs().max() <= image
    torch.testing.assert_close(ours.radii, truth.radii.float(), rtol=1e-4, atol=1e-3)
    for name, a, b in zip(NAMES, our_gradients, true_gradients, strict=True):
        error = (a - b).norm() / b.norm().clamp_min(1e-6)
        assert error <= gradient, f"gradient of {name} is off by {error:.1e}"
    return ours, our_gradients


@pytest.mark.parametrize("channels", [1, 3, 6, 10, 16])
def test_random_scene(implementation, channels):
    view = camera()
    assert_matches_reference(implementation, random_gaussians(600, channels, view, seed=channels), view)


def test_off_screen_and_behind(implementation):
    view = camera()
    tensors = random_gaussians(500, 3, view, seed=2, spread=4.0)
    tensors[0][::3] *= -1.0  # a third of them behind the camera
    ours, gradients = assert_matches_reference(implementation, tensors, view)
    hidden = ours.radii == 0
    assert hidden.any()
    assert all((g[hidden] == 0).all() for g in gradients)


def test_huge_tiny_and_anisotropic(implementation):
    view = camera()
    tensors = random_gaussians(400, 3, view, seed=3)
    tensors[2][:20] *= 30.0  # much larger than the picture
    tensors[2][20:120] *= 1e-3  # far below a pixel
    tensors[2][120:220, 0] *= 20.0  # needles
    tensors[2][220:300, 2] = 1e-7  # flat
    tensors[3][:20] *= 0.1
    assert_matches_reference(implementation, tensors, view, gradient=5e-4)


def test_nearly_transparent_and_opaque(implementation):
    view = camera()
    tensors = random_gaussians(500, 3, view, seed=4)
    tensors[3][:200] = torch.linspace(0.0, 0.01, 200)  # around the 1/255 below which nothing is drawn
    tensors[3][200:300] = 1.0  # alpha is clamped
    assert_matches_reference(implementation, tensors, view)


def test_where_alpha_is_clipped_only_colours_have_a_gradient(implementation):
    """min(ALPHA_MAX, ·) is constant there, in every pixel of this picture; what is behind keeps its own."""
    view = camera(16, 16, cx=8.0, cy=8.0)
    tensors = random_gaussians(2, 3, view, seed=9, spread=0.0)
    tensors[2][0] = 40.0 * tensors[0][0].norm()  # wider than the picture: 0.9995 of its opacity everywhere
    tensors[3][:] = torch.tensor([1.0, 0.5])
    view_axis = torch.from_numpy(-view.camera_to_world[:3, 2]).float()
    tensors[0] = torch.from_numpy(view.position).float() + torch.tensor([[1.0], [2.0]]) * view_axis
    # 1 − 0.999 has four digits in float32.
    _, gradients = assert_matches_reference(implementation, tensors, view, gradient=1e-3)
    clipped = dict(zip(NAMES, gradients, strict=True))
    for name in ("means", "quaternions", "scales", "opacities", "screen_offsets"):
        assert (clipped[name][0] == 0.0).all(), name
        assert (clipped[name][1] != 0.0).any(), name
    weights = torch.randn(3, 16, 16, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(clipped["colours"][0], ALPHA_MAX * weights.sum((1, 2)), rtol=1e-4, atol=1e-4)


def test_close_to_the_camera(implementation):
    """Gaussians beside the near plane, where the projection's Jacobian is limited."""
    view = camera()
    tensors = random_gaussians(300, 3, view, seed=5, spread=6.0)
    position = torch.from_numpy(view.position).float()
    tensors[0] = position + (tensors[0] - position) * 0.08
    tensors[2] *= 0.05
    assert_matches_reference(implementation, tensors, view)


def test_thousands_on_one_pixel(implementation):
    view = camera(8, 8, cx=4.0, cy=4.0)
    tensors = random_gaussians(4000, 3, view, seed=6, spread=0.05)
    tensors[3] = 0.004 + 0.01 * tensors[3]
    assert_matches_reference(implementation, tensors, view)


@pytest.mark.parametrize("size", [(1, 1), (33, 17), (64, 32), (3, 70)])
def test_image_sizes(implementation, size):
    view = camera(*size)
    assert_matches_reference(implementation, random_gaussians(200, 3, view, seed=7), view)


def test_no_gaussian(implementation):
    view = camera()
    tensors = [t[:0] for t in random_gaussians(2, 3, view)]
    result, gradients = draw_with_gradients(implementation, tensors, view, torch.float32)
    assert result.image.shape == (3, 45, 67) and not result.image.any() and not result.alpha.any()
    assert all(g.shape[0] == 0 for g in gradients)


def test_one_gaussian(implementation):
    """On the axis, in the centre of a pixel: its colour times its opacity, exactly."""
    view = Camera(np.eye(4), 9, 9, 20.0, 20.0, 4.5, 4.5)
    tensors = [
        torch.tensor([[0.0, 0.0, -2.0]]),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.full((1, 3), 0.1),
        torch.tensor([0.5]),
        torch.tensor([[2.0, 4.0, 8.0]]),
    ]
    result = rasterize(*tensors, view, implementation=implementation)
    torch.testing.assert_close(result.image[:, 4, 4], torch.tensor([1.0, 2.0, 4.0]), rtol=1e-6, atol=0)
    variance = (20.0 * 0.1 / 2.0) ** 2 + 0.3  # of the projection, with the low-pass filter, px²
    falloff = math.exp(-0.5 * 4.0 / variance)  # two pixels aside
    torch.testing.assert_close(result.alpha[4, 6].item(), 0.5 * falloff, rtol=1e-5, atol=0)
    assert_matches_reference(implementation, tensors, view)


def test_all_off_screen(implementation):
    view = camera()
    tensors = random_gaussians(50, 3, view)
    tensors[0] = tensors[0] * torch.tensor([1.0, 1.0, -1.0]) + torch.tensor([0.0, 0.0, 5.0])
    result, gradients = draw_with_gradients(implementation, tensors, view, torch.float32)
    assert not result.image.any() and not any(g.any() for g in gradients)


def test_same_bits_for_any_number_of_threads():
    view = camera(150, 100)
    tensors = random_gaussians(3000, 6, view, seed=8)

    def drawn():
        result, gradients = draw_with_gradients("cpu", tensors, view, torch.float32)
        return [result.image.detach(), result.alpha.detach(), result.radii, *gradients]

    assert_same_bits(drawn)


@pytest.mark.parametrize("threads", [1, 3])
def test_too_many_pairs_are_refused_before_memory_is(threads, monkeypatch):
    """2,000 that each cover a picture of 32 tiles; of a thread's share alone there may be few enough."""
    view, count, before = camera(256, 64), 2000, cpu.thread_count()
    tensors = random_gaussians(count, 3, view)
    tensors[2][:] = 100.0
    tensors[3][:] = 0.5
    largest = []
    monkeypatch.setattr(cpu, "MOST_PAIRS", 40_000)
    monkeypatch.setattr(cpu, "project", lambda *a: largest.append(a[-3].size) or project(*a))
    cpu.set_threads(threads)
    try:
        with pytest.raises(BadValueError, match=rf"{count} Gaussians touch 64000 tiles[\s\S]*in parts"):
            rasterize(*tensors, view, implementation="cpu")
    finally:
        cpu.set_threads(before)
    assert max(largest) <= 2 * count + 64


def test_without_gradients_the_picture_is_the_same(implementation):
    view = camera()
    tensors = random_gaussians(300, 3, view)
    with_gradients, _ = draw_with_gradients(implementation, tensors, view, torch.float32)
    assert torch.equal(with_gradients.image, rasterize(*tensors, view, implementation=implementation).image)


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_refuses_what_is_not_finite(implementation, index, value):
    view = camera()
    tensors = [*random_gaussians(50, 3, view), torch.zeros(50, 2)]
    tensors[index].view(-1)[31] = value
    with pytest.raises(BadValueError, match=NAMES[index]):
        rasterize(*tensors[:5], view, screen_offsets=tensors[5], implementation=implementation)


def test_refuses_other_types(implementation):
    view = camera()
    tensors = [t.double() for t in random_gaussians(5, 3, view)]
    with pytest.raises(BadValueError, match="float32"):
        rasterize(*tensors, view, implementation=implementation)
