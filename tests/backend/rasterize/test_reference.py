# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracle itself, against closed forms, another formulation, and finite differences."""

import math

import numpy as np
import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.rasterize.reference import project
from physhdr.backend.scene.camera import Camera

VIEW = Camera(np.eye(4), 12, 10, 15.0, 14.0, 6.5, 4.5)


def gaussians(count=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    depth = 1.0 + torch.rand(count, generator=generator, dtype=torch.float64)
    x, y = (torch.rand(2, count, generator=generator, dtype=torch.float64) - 0.5) * 0.6 * depth
    return [
        torch.stack([x, y, -depth], dim=1),
        torch.randn(count, 4, generator=generator, dtype=torch.float64),
        0.05 + 0.2 * torch.rand(count, 3, generator=generator, dtype=torch.float64),
        0.1 + 0.5 * torch.rand(count, generator=generator, dtype=torch.float64),
        torch.rand(count, 3, generator=generator, dtype=torch.float64),
    ]


def test_gradcheck():
    tensors = [t.requires_grad_() for t in (*gaussians(), torch.zeros(5, 2, dtype=torch.float64))]

    def picture(*tensors):
        result = rasterize(*tensors[:5], VIEW, screen_offsets=tensors[5], implementation="reference")
        return result.image, result.alpha

    assert torch.autograd.gradcheck(picture, tensors, eps=1e-7, atol=1e-5)


def test_covariance_is_that_of_projected_samples():
    """A small Gaussian, sampled and projected point by point, has the covariance that EWA says."""
    means, quaternions, scales = (t[:1] for t in gaussians(seed=3)[:3])
    scales = scales * 0.01
    _, covariance, _ = project(means, quaternions, scales, VIEW)
    w, x, y, z = (quaternions / quaternions.norm()).squeeze().tolist()
    # Rotate by quaternion algebra, v + 2 w (u × v) + 2 u × (u × v): no rotation matrix involved.
    points = torch.randn(400_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * scales
    axis = torch.tensor([[x, y, z]], dtype=torch.float64).expand_as(points)
    cross = torch.linalg.cross(axis, points)
    points = points + 2 * w * cross + 2 * torch.linalg.cross(axis, cross) + means
    screen = torch.stack(
        [VIEW.fx * points[:, 0] / -points[:, 2], VIEW.fy * -points[:, 1] / -points[:, 2]], dim=1
    )
    sampled = torch.cov(screen.T)
    torch.testing.assert_close(
        covariance[0] - 0.3 * torch.eye(2, dtype=torch.float64), sampled, rtol=0.02, atol=1e-5
    )


def test_pixel_of_two_gaussians_in_closed_form():
    """Two isotropic Gaussians on the axis, the nearer one given last: over-compositing, by hand."""
    view = Camera(np.eye(4), 5, 5, 10.0, 10.0, 2.5, 2.5)
    means = torch.tensor([[0.0, 0.0, -4.0], [0.0, 0.0, -2.0]], dtype=torch.float64)
    result = rasterize(
        means,
        torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 2, dtype=torch.float64),
        torch.full((2, 3), 0.2, dtype=torch.float64),
        torch.tensor([0.8, 0.25], dtype=torch.float64),
        torch.tensor([[10.0], [1.0]], dtype=torch.float64),
        view,
        implementation="reference",
    )
    near = 0.25 * math.exp(-0.5 * 1.0 / ((10 * 0.2 / 2) ** 2 + 0.3))
    far = 0.8 * math.exp(-0.5 * 1.0 / ((10 * 0.2 / 4) ** 2 + 0.3))
    pixel = result.image[0, 2, 3].item()
    assert math.isclose(pixel, near * 1.0 + (1 - near) * far * 10.0, rel_tol=1e-12)
    assert math.isclose(result.alpha[2, 3].item(), 1 - (1 - near) * (1 - far), rel_tol=1e-12)
