# SPDX-License-Identifier: GPL-3.0-or-later
"""Float32 rasterisers where Gaussians are degenerate and pictures odd, against the reference in float64."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.splatting import NEAR_PLANE

#: Three axes of different lengths: a sphere's rotation has no gradient to compare.
ELLIPSOID = torch.tensor([1.0, 0.6, 0.3])

NAMES = ("means", "quaternions", "scales", "opacities", "colours", "screen_offsets")


def camera(width=40, height=33, **changes) -> Camera:
    """At the origin, looking down −Z, so that depths are exact in any precision."""
    values = {"fx": 40.0, "fy": 44.0, "cx": 0.5 * width, "cy": 0.5 * height} | changes
    return Camera(np.eye(4), width, height, **values)


def gaussians(count, channels=3, seed=0):
    """Gaussians within the view of ``camera()``: float32 tensors, some of which a test then spoils."""
    generator = torch.Generator().manual_seed(seed)
    depth = 1.0 + 2.0 * torch.rand(count, generator=generator)
    x, y = (torch.rand(2, count, generator=generator) - 0.5) * depth
    return [
        torch.stack([x, 0.7 * y, -depth], dim=1),
        torch.randn(count, 4, generator=generator),
        0.02 + 0.1 * torch.rand(count, 3, generator=generator),
        0.1 + 0.8 * torch.rand(count, generator=generator),
        torch.rand(count, channels, generator=generator),
    ]


def evaluate(implementation, tensors, view, dtype):
    leaves = [t.to(dtype).clone().requires_grad_() for t in (*tensors, torch.zeros(len(tensors[0]), 2))]
    drawn = rasterize(*leaves[:5], view, screen_offsets=leaves[5], implementation=implementation)
    generator = torch.Generator().manual_seed(1)
    weights = torch.randn(drawn.image.shape, generator=generator).to(dtype)
    alpha_weights = torch.randn(drawn.alpha.shape, generator=generator).to(dtype)
    ((drawn.image * weights).sum() + (drawn.alpha * alpha_weights).sum()).backward()
    return drawn, [t.grad for t in leaves]


def compare(implementation, tensors, view, value=2e-6, gradient=1e-4):
    """Values and gradients, relative to the norm; every one of them finite."""
    ours, our_gradients = evaluate(implementation, tensors, view, torch.float32)
    truth, true_gradients = evaluate("reference", tensors, view, torch.float64)
    for name in ("image", "alpha"):
        a, b = getattr(ours, name), getattr(truth, name)
        assert a.isfinite().all(), name
        error = (a - b).norm() / b.norm().clamp_min(1e-9)
        assert error <= value, f"{name} is off by {error:.1e}"
    for name, a, b in zip(NAMES, our_gradients, true_gradients, strict=True):
        assert a.isfinite().all(), f"gradient of {name}"
        error = (a - b).norm() / b.norm().clamp_min(1e-6)
        assert error <= gradient, f"gradient of {name} is off by {error:.1e}"
    return ours


# ---- shapes of Gaussians ---------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-8, 1e-20, 0.0])
@pytest.mark.parametrize("axes", [[0], [0, 1], [0, 1, 2]], ids=["discs", "needles", "points"])
def test_vanishing_scales(implementation, axes, scale):
    """The low-pass filter keeps what has no extent visible; 0 is the exp() of a very small logarithm."""
    tensors = gaussians(200)
    tensors[2][:, axes] = scale
    assert compare(implementation, tensors, camera()).image.any()


def test_discs_and_needles_seen_from_every_side(implementation):
    """Edge-on, end-on and everything between, 1 : 10⁶."""
    tensors = gaussians(180)
    angle = torch.linspace(0.0, math.pi, 180)
    zero = torch.zeros_like(angle)
    tensors[1] = torch.stack([(angle / 2).cos(), zero, (angle / 2).sin(), zero], dim=1)
    tensors[2] = torch.tensor([0.2, 0.2, 2e-7]).repeat(180, 1)
    tensors[2][::2] = torch.tensor([2e-7, 2e-7, 0.3])
    compare(implementation, tensors, camera())


@pytest.mark.parametrize("length", [0.2, 0.5], ids=["100 px", "250 px"])
def test_gradients_of_each_long_needle(implementation, length):
    """σ of 100 and 250 pixels by half a pixel, as cables and rims are.

    By norm over all Gaussians an error in the long scale would not be seen: its gradient is the smallest.
    """
    generator = torch.Generator().manual_seed(0)
    count, view = 40, Camera(np.eye(4), 256, 64, 1000.0, 1000.0, 128.0, 32.0)

    def uniform(low, high, *shape):
        return low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)

    means = torch.stack(
        [uniform(-0.1, 0.1, count), uniform(-0.02, 0.02, count), uniform(-2.2, -1.8, count)], 1
    )
    angle, zero = uniform(0.0, math.pi, count), torch.zeros(count, dtype=torch.float64)
    quaternions = torch.stack([(angle / 2).cos(), zero, zero, (angle / 2).sin()], 1)
    quaternions += 0.05 * torch.randn(count, 4, generator=generator, dtype=torch.float64)
    scales = torch.tensor([length, 1e-3, 1e-3], dtype=torch.float64).repeat(count, 1)
    tensors = [means, quaternions, scales, uniform(0.1, 0.9, count), uniform(0.0, 1.0, count, 3)]
    x, y = torch.arange(256.0), torch.arange(64.0)[:, None]
    target = torch.stack(
        [0.5 + 0.4 * (x / 30 + 0 * y).sin(), 0.5 + 0.4 * (y / 9 + 0 * x).cos(), 0 * x + 0 * y]
    )

    def gradients(which, dtype):
        inputs = [tensor.to(dtype, copy=True).requires_grad_() for tensor in tensors]
        image = rasterize(*inputs, view, implementation=which).image
        (image - target.to(dtype)).square().mean().backward()
        return [tensor.grad.double().reshape(count, -1) for tensor in inputs]

    ours, truth = gradients(implementation, torch.float32), gradients("reference", torch.float64)
    for name, a, b in zip(NAMES[:5], ours, truth, strict=True):
        error = (a - b).norm(dim=1) / b.norm(dim=1)
        assert error.median() < 1e-3 and error.max() < 0.1, name
    along, along_truth = ours[2][:, 0], truth[2][:, 0]
    assert ((along - along_truth).abs() / along_truth.abs()).median() < 1e-5


@pytest.mark.parametrize("length", [1e-6, 1e6])
def test_quaternions_of_any_length(implementation, length):
    tensors = gaussians(200)
    tensors[1] *= length
    compare(implementation, tensors, camera())


def test_far_larger_than_the_picture(implementation):
    """Footprints of thousands of pixels that cover every tile."""
    tensors = gaussians(30)
    tensors[2] *= 1e3
    tensors[3] *= 0.1
    compare(implementation, tensors, camera(), value=1e-5, gradient=1e-3)


@pytest.mark.parametrize("scale", [1e8, 1e15, 1e19, 3e38])
def test_covariances_that_overflow(implementation, scale):
    """Nothing can be right here; but no NaN may come of it, and the others are drawn as if alone."""
    tensors = gaussians(100)
    rest = [t[:50].clone() for t in tensors]
    tensors[2][50:] = scale
    tensors[3][50:] = 0.003  # below 1/255: nothing to be seen, whatever their size
    drawn, gradients = evaluate(implementation, tensors, camera(), torch.float32)
    alone, _ = evaluate(implementation, rest, camera(), torch.float32)
    assert torch.equal(drawn.image, alone.image) and all(g.isfinite().all() for g in gradients)
    tensors[3][50:] = 0.5
    drawn, gradients = evaluate(implementation, tensors, camera(), torch.float32)
    assert drawn.image.isfinite().all() and all(g.isfinite().all() for g in gradients)


# ---- where Gaussians are ---------------------------------------------------------------------------


def test_equal_depths_are_drawn_by_index(implementation):
    """A wall of 300 Gaussians, all in one plane, in the order of their numbers."""
    tensors = gaussians(300)
    tensors[0][:, 2] = -2.0
    tensors[3][:] = 0.9
    compare(implementation, tensors, camera(), value=1e-5, gradient=1e-3)
    backwards = [t.flip(0) for t in tensors]
    first = rasterize(*tensors, camera(), implementation=implementation).image
    assert not torch.allclose(
        first, rasterize(*backwards, camera(), implementation=implementation).image, atol=0.05
    )


@pytest.mark.parametrize("opacity", [0.005, 0.3, 1.0])
def test_thousands_on_one_pixel(implementation, opacity):
    """Hardly visible, so that all of them count; or opaque, so that the first few hide the rest."""
    tensors = gaussians(5000, seed=2)
    tensors[0][:, :2] = 0.01
    tensors[2] = 1e-3 * ELLIPSOID.repeat(5000, 1)
    tensors[3][:] = opacity
    compare(implementation, tensors, camera(9, 9, cx=4.3, cy=4.3), value=1e-4, gradient=2e-3)


def test_on_the_borders_of_pixels_tiles_and_the_picture(implementation):
    """Centres at whole and half pixels on a grid that has every border on it, outside ones included."""
    view = camera(64, 48, fx=64.0, fy=64.0)
    x, y = torch.meshgrid(torch.arange(-4.0, 69.0, 4.0), torch.arange(-4.0, 53.0, 4.0), indexing="ij")
    count = x.numel()
    tensors = gaussians(count)
    # Depth 1 and the centre at (32, 24): a metre is 64 pixels.
    tensors[0] = torch.stack(
        [(x.flatten() - 32.0) / 64.0, (24.0 - y.flatten()) / 64.0, -torch.ones(count)], 1
    )
    tensors[2][:] = 0.02 * ELLIPSOID
    compare(implementation, tensors, view)


def test_around_the_near_plane(implementation):
    """Just before it, on it, just behind it, and behind the camera."""
    tensors = gaussians(120)
    depths = torch.tensor([0.5, 0.999, 1.0, 1.001, 1.5, -1.0]).repeat(20) * NEAR_PLANE
    tensors[0] = torch.stack([0.4 * depths.abs(), -0.2 * depths.abs(), -depths], dim=1)
    tensors[0][:, :2] *= torch.linspace(-1.0, 1.0, 120)[:, None]
    tensors[2][:] = 4e-4 * ELLIPSOID
    # float32 and float64 may disagree about "on it".
    tensors[0][2::6, 2] = -1.0001 * NEAR_PLANE
    drawn = compare(implementation, tensors, camera(), value=1e-5, gradient=1e-3)
    shown = (drawn.radii > 0).view(20, 6)
    assert not shown[:, [0, 1, 5]].any() and shown[:, [2, 3, 4]].any()


def test_only_the_tails_reach_the_picture(implementation):
    """All centres outside, on all sides."""
    tensors = gaussians(200)
    angle = torch.linspace(0.0, 2.0 * math.pi, 200)
    tensors[0] = torch.stack([0.8 * angle.cos(), 0.7 * angle.sin(), -torch.ones(200)], dim=1)
    tensors[2][:] = 0.2 * ELLIPSOID
    # Most pixels have an alpha near 1/255, and rounding decides for a few whether they are drawn at all.
    assert compare(implementation, tensors, camera(), value=1e-3, gradient=2e-3).image.any()


# ---- colours and pictures --------------------------------------------------------------------------


def test_extreme_radiance(implementation):
    """From 6e-6 to 8e3 in one picture, and negative: nothing is clamped."""
    tensors = gaussians(300, 6)
    tensors[4] = torch.exp(torch.linspace(-12.0, 9.0, 300))[:, None] * torch.tensor([1.0, 1, 1, -1, 1e-6, 1])
    compare(implementation, tensors, camera())


@pytest.mark.parametrize("size", [(1, 1), (1, 90), (90, 1), (16, 16), (32, 32), (31, 33), (65, 15)])
@pytest.mark.parametrize("channels", [3, 6])
def test_picture_sizes(implementation, size, channels):
    compare(implementation, gaussians(150, channels), camera(*size))


@pytest.mark.parametrize("count", [0, 1, 2, 7, 8, 9])
def test_few_gaussians(implementation, count):
    """Around the width of a vector."""
    compare(implementation, gaussians(count), camera())


def test_principal_point_outside_the_picture(implementation):
    view = camera(cx=-25.0, cy=70.0)
    tensors = gaussians(300)
    tensors[0][:, 0] += 1.0
    tensors[0][:, 1] += 1.0
    assert compare(implementation, tensors, view).image.any()


def test_every_pixel_is_covered_many_times(implementation):
    """The colour of an opaque stack is the front's: 300 Gaussians of alpha 0.999, as large as the view."""
    tensors = gaussians(300)
    tensors[0][:, :2] = 0.0
    tensors[2][:] = 50.0
    tensors[3][:] = 1.0
    drawn = rasterize(*tensors, camera(), implementation=implementation)
    front = int(tensors[0][:, 2].argmax())
    assert (drawn.alpha > 0.998).all()
    assert (drawn.image - tensors[4][front][:, None, None]).abs().max() < 2e-3
