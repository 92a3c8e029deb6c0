# SPDX-License-Identifier: GPL-3.0-or-later
"""Blend weights against the float64 reference's pictures and its gradients."""

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize.cpu.weights import blend_weights
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera

SIZE = (70, 45)  # several tiles, none of them whole at the right and below
COUNT = 400


def gaussians(seed=0):
    random = torch.Generator().manual_seed(seed)

    def uniform(*shape):
        return torch.rand(*shape, generator=random)

    means = torch.cat([2.4 * uniform(COUNT, 2) - 1.2, -1.0 - 2.0 * uniform(COUNT, 1)], dim=1)
    quaternions = torch.randn(COUNT, 4, generator=random)
    scales = 0.01 + 0.15 * uniform(COUNT, 3) ** 2
    opacities = uniform(COUNT)
    opacities[:20] = 1.0  # alpha is held at its most
    return means, quaternions, scales, opacities


def camera():
    return Camera.from_field_of_view(np.eye(4), *SIZE, 1.0)


def dense(found):
    matrix = np.zeros((found.starts.size - 1, COUNT))
    rows = np.repeat(np.arange(found.starts.size - 1), np.diff(found.starts))
    np.add.at(matrix, (rows, found.gaussians), found.weights)
    return matrix


def test_the_blend_is_the_picture():
    shape = gaussians()
    colours = torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(1)).double()
    picture = rasterize(*(each.double() for each in shape), colours, camera(), None).image.numpy()
    found = blend_weights(*shape, camera(), np.arange(SIZE[0] * SIZE[1]))
    blended = (dense(found) @ colours.numpy()).T.reshape(3, SIZE[1], SIZE[0])
    assert picture.max() > 0.5
    np.testing.assert_allclose(blended, picture, atol=3e-6)


def test_some_pixels_are_rows_of_all():
    shape = gaussians()
    everything = dense(blend_weights(*shape, camera(), np.arange(SIZE[0] * SIZE[1])))
    some = np.array([0, 69, 70, 1000, 2222, 3149])
    np.testing.assert_array_equal(dense(blend_weights(*shape, camera(), some)), everything[some])


@pytest.mark.parametrize("pixel", [35 + 70 * 22, 12 + 70 * 40, 69 + 70 * 3])
def test_a_weight_is_the_gradient_of_a_pixel(pixel):
    shape = gaussians(seed=2)
    colours = torch.zeros(COUNT, 1, dtype=torch.float64, requires_grad=True)
    image = rasterize(*(each.double() for each in shape), colours, camera(), None).image
    image.reshape(-1)[pixel].backward()
    found = dense(blend_weights(*shape, camera(), np.array([pixel])))[0]
    assert np.count_nonzero(found) > 3
    np.testing.assert_allclose(found, colours.grad.numpy()[:, 0], atol=1e-6)


def test_the_nearest_stands_first():
    means = torch.tensor([[0.0, 0.0, -3.0], [0.0, 0.0, -1.0], [0.0, 0.0, -2.0]])
    quaternions, scales = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(3, 4), torch.full((3, 3), 0.2)
    opacities = torch.tensor([0.5, 0.25, 0.5])
    middle = np.array([35 + 70 * 22])
    found = blend_weights(means, quaternions.contiguous(), scales, opacities, camera(), middle)
    assert found.gaussians.tolist() == [1, 2, 0]
    expected = [0.25, 0.75 * 0.5, 0.75 * 0.5 * 0.5]
    np.testing.assert_allclose(found.weights, expected, rtol=0.02)  # half a pixel from the middle


def test_nothing_in_sight():
    means = torch.tensor([[0.0, 0.0, 5.0]])
    found = blend_weights(
        means, torch.tensor([[1.0, 0, 0, 0]]), torch.ones(1, 3), torch.ones(1), camera(), np.arange(10)
    )
    assert found.starts.tolist() == [0] * 11 and found.gaussians.size == found.weights.size == 0
