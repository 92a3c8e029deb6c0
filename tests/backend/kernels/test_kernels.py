# SPDX-License-Identifier: GPL-3.0-or-later
"""Every fused kernel against float64 autograd of its plain-torch twin, and twins against other programs."""

import numpy as np
import pytest
import torch

from physhdr.backend import kernels
from physhdr.backend.kernels import curve_table
from physhdr.bridge.errors import BadValueError
from physhdr.tests.backend.threads import assert_same_bits


def random(*shape, seed=0, scale=1.0):
    return scale * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def assert_same(fused, twin, tensors, value=2e-6, gradient=1e-5):
    """Values and gradients of float32 ``fused`` and of float64 ``twin``, relative to their norm."""
    results = []
    for function, dtype in ((fused, torch.float32), (twin, torch.float64)):
        inputs = [t.to(dtype).requires_grad_() for t in tensors]
        output = function(*inputs)
        weights = random(*output.shape, seed=99).to(dtype)
        gradients = torch.autograd.grad((output * weights).sum(), inputs, allow_unused=True)
        results.append((output.detach(), *gradients))
    for i, (a, b) in enumerate(zip(*results, strict=True)):
        if a is None and b is None:
            continue
        error = (a - b).norm() / b.norm().clamp_min(1e-9)
        assert error <= (gradient if i else value), (
            f"{'value' if i == 0 else f'gradient {i}'} off by {error:.1e}"
        )
    return results[0]


# ---- SSIM ----------------------------------------------------------------------------------------


def pictures(*shape):
    generator = torch.Generator().manual_seed(3)
    target = torch.rand(*shape, generator=generator)
    return (target + 0.2 * torch.rand(*shape, generator=generator)).clamp(0, 1), target


@pytest.mark.parametrize("shape", [(3, 40, 61), (1, 5, 7), (9, 64, 32), (3, 1, 1), (2, 30, 8)])
@pytest.mark.parametrize("cached", [False, True])
def test_ssim(shape, cached):
    prediction, target = pictures(*shape)
    known = kernels.SsimTarget(target) if cached else target
    assert_same(
        lambda x: kernels.ssim(x, known), lambda x: kernels.ssim_reference(x, target.double()), [prediction]
    )


@pytest.mark.parametrize("shape", [(3, 40, 61), (1, 5, 7), (2, 30, 8)])
@pytest.mark.parametrize("cached", [False, True])
def test_ssim_map(shape, cached):
    """Every pixel's S, each with its own weight in the gradient; its mean is ``ssim``."""
    prediction, target = pictures(*shape)
    known = kernels.SsimTarget(target) if cached else target
    whole, _ = assert_same(
        lambda x: kernels.ssim_map(x, known),
        lambda x: kernels.ssim_map_reference(x, target.double()),
        [prediction],
    )
    assert whole.shape == shape
    assert whole.mean().item() == pytest.approx(kernels.ssim(prediction, target).item(), abs=1e-6)


def test_ssim_of_an_image_with_itself():
    _, target = pictures(3, 20, 20)
    assert kernels.ssim(target, target).item() == pytest.approx(1.0, abs=1e-6)


def test_ssim_flat_dark_images():
    """Where variances vanish, σ = 𝒢x² − μ² is all rounding."""
    dark = torch.full((3, 33, 33), 0.9)
    assert_same(
        lambda x: kernels.ssim(x, dark - 0.01),
        lambda x: kernels.ssim_reference(x, (dark - 0.01).double()),
        [dark + 1e-3 * random(3, 33, 33)],
        value=1e-4,
        gradient=2e-3,
    )


def test_ssim_against_pytorch_msssim():
    """Inside, where no window meets the border: an independent program that leaves the border out."""
    library = pytest.importorskip("pytorch_msssim")
    prediction, target = (t.double() for t in pictures(3, 40, 50))
    inside = library.ssim(prediction[None], target[None], data_range=1.0, win_size=11, win_sigma=1.5)
    # Zeros around the picture are what our border means; the library then has the whole picture inside.
    pad = torch.nn.ZeroPad2d(5)
    whole = library.ssim(pad(prediction)[None], pad(target)[None], data_range=1.0, win_size=11, win_sigma=1.5)
    ours = kernels.ssim_reference(prediction, target)
    assert ours.item() == pytest.approx(whole.item(), rel=1e-6)
    assert abs(ours - inside) < 0.05


def test_ssim_threads():
    prediction, target = pictures(3, 100, 70)

    def run():
        x = prediction.clone().requires_grad_()
        value = kernels.ssim(x, target)
        value.backward()
        return value.detach(), x.grad

    assert_same_bits(run)


# ---- networks ------------------------------------------------------------------------------------


@pytest.mark.parametrize("activation", ["relu", "softplus", "silu"])
@pytest.mark.parametrize("points", [1, 17, 1000, 5003])
def test_curve_mlp(activation, points):
    tensors = [random(3, points, scale=3.0), *(random(3, 64, seed=i) for i in (1, 2, 3)), random(3, seed=4)]
    assert_same(
        lambda *t: kernels.curve_mlp(*t, activation),
        lambda *t: kernels.curve_mlp_reference(*t, activation),
        tensors,
    )


@pytest.mark.parametrize("activation", ["softplus", "silu"])
def test_curve_mlp_by_table(activation):
    """Many points in a narrow range: values by interpolation, as exact as the direct way."""
    tensors = [
        *(
            3.0 * torch.rand(3, 20_001, generator=torch.Generator().manual_seed(0)) - 2.0,
            random(3, 64, seed=1),
        ),
        *(random(3, 64, seed=2), random(3, 64, seed=3), random(3, seed=4)),
    ]
    assert curve_table.knots_for(tensors[0]) is not None
    assert_same(
        lambda *t: kernels.curve_mlp(*t, activation),
        lambda *t: kernels.curve_mlp_reference(*t, activation),
        tensors,
    )


def test_curve_mlp_steep():
    """Weights too large for the table go the direct way; just below its limit it still holds."""
    for weight in (11.9, 40.0):
        x = 3.0 * torch.rand(3, 20_000, generator=torch.Generator().manual_seed(0)) - 2.0
        w1 = weight * torch.linspace(-1.0, 1.0, 64).expand(3, 64)
        tensors = [x, w1, w1 * 0.5, random(3, 64, seed=3), random(3, seed=4)]
        assert_same(
            lambda *t: kernels.curve_mlp(*t, "softplus"),
            lambda *t: kernels.curve_mlp_reference(*t, "softplus"),
            tensors,
            value=5e-6,
            gradient=3e-5,
        )


@pytest.mark.parametrize(
    ("inputs", "outputs", "activation"), [(6, 3, "relu"), (5, 1, "relu"), (2, 1, "softplus")]
)
def test_small_mlp(inputs, outputs, activation):
    tensors = [
        *(random(inputs, 4500), random(64, inputs, seed=1), random(64, seed=2)),
        *(random(outputs, 64, seed=3), random(outputs, seed=4)),
    ]
    assert_same(
        lambda *t: kernels.small_mlp(*t, activation),
        lambda *t: kernels.small_mlp_reference(*t, activation),
        tensors,
    )


def test_softplus_far_from_zero():
    """Neither overflow nor a lost tail, where exp(z) is 1e-30 or 1e30."""
    x = torch.linspace(-90.0, 90.0, 3003).reshape(3, -1)
    one, zero = torch.ones(3, 1), torch.zeros(3, 1)
    ours = kernels.curve_mlp(x, one, zero, one, zero[:, 0], "softplus")
    truth = torch.nn.functional.softplus(x.double(), threshold=1000)
    torch.testing.assert_close(ours.double(), truth, rtol=1e-5, atol=1e-37)


def test_no_points():
    x = torch.zeros(3, 0, requires_grad=True)
    w = [torch.ones(3, 8, requires_grad=True) for _ in range(3)]
    y = kernels.curve_mlp(x, *w, torch.zeros(3), "relu")
    y.sum().backward()
    assert y.shape == (3, 0) and not w[0].grad.any()


def test_networks_threads():
    curve = [random(3, 64), random(3, 64), random(3)]
    tensors = [random(6, 20_000), random(64, 6, seed=1), random(64, seed=2), random(3, 64, seed=3), random(3)]

    def run():
        inputs = [t.clone().requires_grad_() for t in tensors]
        output = kernels.small_mlp(*inputs, "relu")
        x, w1, b1, w2, b2 = [inputs[0][:3] * 0.2, *(t[:, :3].T for t in inputs[1:2]), *curve]
        response = kernels.curve_mlp(x, w1, b1, w2, b2, "softplus")
        gradients = torch.autograd.grad(output.square().sum() + response.square().sum(), inputs)
        return output.detach(), response.detach(), *gradients

    assert_same_bits(run)


# ---- spherical harmonics -------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spherical_harmonics(degree):
    means, viewpoint = random(500, 3), torch.tensor([0.3, -2.0, 1.0])
    assert_same(
        lambda dc, rest: kernels.evaluate_sh(dc, rest, means, viewpoint, degree),
        lambda dc, rest: (
            kernels.evaluate_sh_reference(dc, rest, means.double(), viewpoint.double(), degree)
            if degree
            else kernels.evaluate_sh(dc, rest, means, viewpoint, 0)
        ),
        [random(500, 3, seed=1), random(500, 15, 3, seed=2)],
    )


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("count", [1, 500, 5001])
def test_the_direction_of_spherical_harmonics_has_a_gradient(degree, count):
    """By hand in the kernel, by autograd through the polynomials in float64."""
    viewpoint = torch.tensor([0.3, -2.0, 1.0])
    tensors = [random(count, 3, seed=1), random(count, 15, 3, seed=2), random(count, 3)]
    assert_same(
        lambda dc, rest, means: kernels.evaluate_sh(dc, rest, means, viewpoint, degree, True),
        lambda dc, rest, means: kernels.evaluate_sh_reference(
            dc, rest, means, viewpoint.double(), degree, True
        ),
        tensors,
    )
    dc, rest, means = (t.detach().clone().requires_grad_() for t in tensors)
    kernels.evaluate_sh(dc, rest, means, viewpoint, degree, True).square().sum().backward()
    # Along the ray nothing changes; a clear part is across it.
    ray = torch.nn.functional.normalize(means.detach() - viewpoint, dim=1)
    assert (means.grad * ray).sum(1).abs().max() < 1e-4 * means.grad.norm(dim=1).max()
    # Without being asked, the direction is a constant.
    means.grad = None
    kernels.evaluate_sh(dc, rest, means, viewpoint, degree).sum().backward()
    assert means.grad is None


def test_spherical_harmonics_are_orthonormal():
    """∫ Y_a Y_b over the sphere is δ_ab: by quadrature, Gauss-Legendre in z and even in azimuth."""
    z, weight = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * (2 * np.pi / 16)
    zz, aa = np.meshgrid(z, azimuth, indexing="ij")
    ring = np.sqrt(1 - zz**2)
    directions = torch.from_numpy(np.stack([ring * np.cos(aa), ring * np.sin(aa), zz], -1).reshape(-1, 3))
    weights = torch.from_numpy(np.repeat(weight, 16) * (2 * np.pi / 16))
    count = directions.shape[0]
    basis = []
    for b in range(16):
        coefficients = torch.zeros(count, 16, 3, dtype=torch.float64)
        coefficients[:, b] = 1.0
        zero = torch.zeros(3, dtype=torch.float64)
        dc, rest = coefficients[:, 0], coefficients[:, 1:]
        basis.append(kernels.evaluate_sh_reference(dc, rest, directions, zero, 3)[:, 0])
    stacked = torch.stack(basis)
    torch.testing.assert_close(
        (stacked * weights) @ stacked.T, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-12
    )


# ---- blur ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(6, 40, 61), (1, 6, 7), (3, 64, 33)])
def test_blur(shape):
    assert_same(
        lambda x: kernels.gaussian_blur(x, 11, 3.0),
        lambda x: kernels.gaussian_blur_reference(x, 11, 3.0),
        [random(*shape)],
    )


def test_blur_against_scipy():
    ndimage = pytest.importorskip("scipy.ndimage")
    image = random(1, 30, 40).double()
    expected = ndimage.gaussian_filter(image[0].numpy(), 3.0, mode="mirror", radius=5)
    np.testing.assert_allclose(kernels.gaussian_blur(image, 11, 3.0)[0].numpy(), expected, atol=1e-12)


def test_blur_refuses_small_images():
    with pytest.raises(BadValueError, match="window of 11"):
        kernels.gaussian_blur(torch.zeros(3, 5, 40), 11, 3.0)
