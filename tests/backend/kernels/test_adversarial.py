# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused kernels where inputs are few, extreme or not numbers, against float64 autograd of their twins."""

import math

import pytest
import torch

from physhdr.backend import kernels
from physhdr.backend.kernels.activations import LOG_RADIANCE_RANGE
from physhdr.backend.model.tone_mapper import LOG_EPSILON, ToneMapper, ToneMapperConfig
from physhdr.tests.backend.threads import assert_same_bits

#: ln(exposure × radiance) from nothing at all to the brightest radiance for 10,000 seconds.
DARKEST, BRIGHTEST = math.log(LOG_EPSILON), LOG_RADIANCE_RANGE[1] + math.log(1e4)


def random(*shape, seed=0, scale=1.0):
    return scale * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def compare(function, tensors, value=2e-6, gradient=1e-5):
    """Fused values and gradients of float32 ``tensors`` against the twin's in float64, by relative norm."""

    def evaluate(dtype):
        inputs = [t.to(dtype).requires_grad_() for t in tensors]
        output = function(*inputs)
        weights = random(*output.shape, seed=99).to(dtype)
        gradients = torch.autograd.grad((output * weights).sum(), inputs, allow_unused=True)
        return [output.detach(), *(torch.zeros(()) if g is None else g for g in gradients)]

    ours = evaluate(torch.float32)
    with kernels.plain_torch():
        truth = evaluate(torch.float64)
    for i, (a, b) in enumerate(zip(ours, truth, strict=True)):
        assert a.isfinite().all(), f"result {i} is not finite"
        if b.numel():
            error = (a - b).norm() / b.norm().clamp_min(1e-9)
            assert error <= (gradient if i else value), f"result {i} is off by {error:.1e}"
    return ours


def with_gradients(function, *tensors):
    """Values and gradients, of fresh leaves."""
    inputs = [t.clone().requires_grad_() for t in tensors]
    output = function(*inputs)
    return [output.detach(), *torch.autograd.grad((output * output.detach()).sum(), inputs)]


def curve_weights(hidden=64):
    return [*(random(3, hidden, seed=i) for i in (1, 2, 3)), random(3, seed=4)]


def network_weights(inputs, outputs, hidden=64):
    return [
        *(random(hidden, inputs, seed=1), random(hidden, seed=2)),
        *(random(outputs, hidden, seed=3), random(outputs, seed=4)),
    ]


# ---- response curves -----------------------------------------------------------------------------


@pytest.mark.parametrize("activation", ["relu", "softplus", "silu"])
@pytest.mark.parametrize("points", [1, 30, 20_000])  # 20,000 smooth ones go by the table
def test_curves_of_extreme_exposures(activation, points):
    x = torch.linspace(DARKEST, BRIGHTEST, 3 * points).reshape(points, 3).T.contiguous()
    compare(lambda *t: kernels.curve_mlp(*t, activation), [x, *curve_weights()])


@pytest.mark.parametrize("activation", ["relu", "softplus"])
def test_curves_where_all_pixels_are_the_same(activation):
    """A black frame, and a white one: every point in one interval of the table, all sums in one bin."""
    for exposure in (DARKEST, BRIGHTEST):
        x = torch.full((3, 20_000), exposure)
        compare(lambda *t: kernels.curve_mlp(*t, activation), [x, *curve_weights()], gradient=3e-5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("activation", ["softplus", "silu"])
def test_a_point_that_is_not_finite_harms_no_other(activation, value):
    """The table is not read at a place that is none."""
    x = random(3, 20_000)
    x[1, 777] = value
    weights = curve_weights()
    ours = kernels.curve_mlp(x, *weights, activation)
    there = torch.zeros_like(x, dtype=torch.bool)
    there[1, 777] = True
    truth = kernels.curve_mlp(
        x.nan_to_num(0.0, 0.0, 0.0).double(), *(w.double() for w in weights), activation
    )
    assert not ours[there].isfinite().any()
    torch.testing.assert_close(ours[~there].double(), truth[~there], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("which", range(5))
@pytest.mark.parametrize("activation", ["relu", "softplus", "silu"])
def test_nan_is_not_swallowed(activation, which):
    """It must reach the loss, where training refuses it; max(NaN, 0) could make a 0 of it."""
    curves, network = [random(3, 20_000), *curve_weights()], [random(6, 50), *network_weights(6, 3)]
    curves[which].view(-1)[1] = network[which].view(-1)[1] = math.nan
    assert kernels.curve_mlp(*curves, activation).isnan().any()
    assert kernels.small_mlp(*network, activation).isnan().any()


@pytest.mark.parametrize("exposure", [1e-4, 1.0, 1e4])
def test_tone_mapper_at_extreme_exposures(exposure):
    """f_tm of a picture with black, deep shadows and a lamp, as the presets call it: no overflow anywhere."""
    torch.manual_seed(0)
    radiance = torch.exp(torch.linspace(*LOG_RADIANCE_RANGE, 3 * 32 * 32)).reshape(3, 32, 32)
    radiance[:, :4] = 0.0
    for config in (ToneMapperConfig(), ToneMapperConfig(anchored=False, initial_slope=None, local=True)):
        mapper = ToneMapper(config, (1.0, 0.73))
        context = random(4, 32, 32) if config.local else None
        exposed = (radiance * exposure).requires_grad_()
        pictures = [p for p in mapper.tone_map(exposed, context) if p is not None]
        gradients = torch.autograd.grad(sum(p.sum() for p in pictures), [exposed, mapper.w1, mapper.b2])
        mapper.double()
        inputs = [exposed.detach().double(), None if context is None else context.double()]
        for ours, truth in zip(pictures, mapper.tone_map(*inputs), strict=False):
            assert ours.min() >= 0.0 and ours.max() <= 1.0
            assert (ours - truth).abs().max() <= 1e-5
        assert all(g.isfinite().all() for g in gradients)


# ---- networks ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("inputs", "outputs"), [(4, 3), (2, 1), (6, 3), (5, 1)])
@pytest.mark.parametrize("points", [0, 1, 9])
def test_networks_of_few_points(inputs, outputs, points):
    compare(
        lambda *t: kernels.small_mlp(*t, "relu"), [random(inputs, points), *network_weights(inputs, outputs)]
    )


def test_network_of_extreme_inputs():
    x = random(4, 5000)
    x[0] = torch.linspace(*LOG_RADIANCE_RANGE, 5000)
    x[1:] *= 30.0
    compare(lambda *t: kernels.small_mlp(*t, "relu"), [x, *network_weights(4, 3)])


def test_network_whose_units_are_all_dead():
    """Every z below 0: the output is b₂, and only b₂ learns."""
    w1, b1, w2, b2 = network_weights(6, 3)
    output, *gradients = compare(
        lambda *t: kernels.small_mlp(*t, "relu"), [torch.rand(6, 3000), -w1.abs(), -b1.abs() - 0.1, w2, b2]
    )
    torch.testing.assert_close(output, b2[:, None].expand(3, 3000), rtol=0, atol=0)
    assert not any(g.any() for g in gradients[:4]) and gradients[4].any()


@pytest.mark.parametrize("points", [1, 4095, 4097])  # around a chunk
def test_networks_have_the_same_bits_for_any_number_of_threads(points):
    weights = network_weights(5, 1)
    assert_same_bits(
        lambda: with_gradients(lambda *t: kernels.small_mlp(*t, "relu"), random(5, points), *weights)
    )


@pytest.mark.parametrize("activation", ["relu", "softplus"])
def test_curves_have_the_same_bits_for_any_number_of_threads(activation):
    weights = curve_weights()
    assert_same_bits(
        lambda: with_gradients(lambda *t: kernels.curve_mlp(*t, activation), random(3, 40_000), *weights)
    )


# ---- spherical harmonics -------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 2, 1025])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_spherical_harmonics_of_few_gaussians(count, degree):
    means, viewpoint = random(count, 3), torch.tensor([0.3, -2.0, 1.0])
    compare(
        lambda dc, rest: kernels.evaluate_sh(dc, rest, means.to(dc), viewpoint.to(dc), degree),
        [random(count, 3, seed=1), random(count, 15, 3, seed=2)],
    )


def test_spherical_harmonics_in_odd_places():
    """A Gaussian at the viewpoint has no direction, only its constant; others are near, far, on an axis."""
    viewpoint = torch.tensor([1.0, 2.0, 3.0])
    directions = torch.cat([torch.zeros(1, 3), torch.eye(3), -torch.eye(3), random(50, 3)])
    for distance in (1e-5, 1.0, 1e6):
        means = (viewpoint.double() + distance * directions.double()).float()
        output, *_ = compare(
            lambda dc, rest, m=means: kernels.evaluate_sh(dc, rest, m.to(dc), viewpoint.to(dc), 3),
            [random(57, 3, seed=1), random(57, 15, 3, seed=2)],
        )
        torch.testing.assert_close(output[0], 0.28209479 * random(57, 3, seed=1)[0], rtol=1e-6, atol=0)


def test_the_direction_has_a_finite_gradient_in_odd_places():
    """At the viewpoint there is no direction, and so no gradient."""
    viewpoint = torch.tensor([1.0, 2.0, 3.0])
    directions = torch.cat([torch.eye(3), -torch.eye(3), random(50, 3)])
    tensors = random(56, 3, seed=1), random(56, 15, 3, seed=2)
    for distance in (1e-3, 1.0, 1e6):
        means = (viewpoint.double() + distance * directions.double()).float()
        compare(
            lambda dc, rest, m: kernels.evaluate_sh(dc, rest, m, viewpoint.to(dc), 3, True), [*tensors, means]
        )
    means = viewpoint.repeat(56, 1).requires_grad_()
    kernels.evaluate_sh(*tensors, means, viewpoint, 3, True).sum().backward()
    assert means.grad is not None and not means.grad.any()


def test_unused_coefficients_get_no_gradient():
    means = random(40, 3)
    leaf = random(40, 15, 3, seed=2).requires_grad_()
    kernels.evaluate_sh(random(40, 3, seed=1), leaf, means, torch.zeros(3), 1).sum().backward()
    assert leaf.grad is not None and leaf.grad[:, :3].all() and not leaf.grad[:, 3:].any()


@pytest.mark.parametrize("count", [1, 17, 5001])
def test_spherical_harmonics_have_the_same_bits_for_any_number_of_threads(count):
    means, viewpoint = random(count, 3), torch.tensor([0.3, -2.0, 1.0])
    tensors = [random(count, 3, seed=1), random(count, 15, 3, seed=2)]
    assert_same_bits(
        lambda: with_gradients(lambda *t: kernels.evaluate_sh(*t, means, viewpoint, 3), *tensors)
    )
    assert_same_bits(
        lambda: with_gradients(lambda *t: kernels.evaluate_sh(*t, viewpoint, 3, True), *tensors, means)
    )


# ---- pictures ------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(3, 1, 1), (3, 1, 40), (3, 40, 1), (3, 3, 3), (3, 17, 16), (1, 8, 129)])
def test_ssim_of_odd_sizes(shape):
    target = torch.rand(shape, generator=torch.Generator().manual_seed(1))
    prediction = torch.rand(shape, generator=torch.Generator().manual_seed(2))
    compare(lambda x: kernels.ssim(x, target.to(x)), [prediction])


@pytest.mark.parametrize("codes", [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)])
def test_ssim_of_black_and_white_frames(codes):
    """Under- and overexposed whole: no variance anywhere, in the one, the other, or both."""
    prediction, target = (torch.full((3, 30, 37), code) for code in codes)
    value = kernels.ssim(prediction.clone().requires_grad_(), target)
    truth = kernels.ssim_reference(prediction.double(), target.double())
    assert value.item() == pytest.approx(truth.item(), abs=1e-6)
    # A dot of the other colour: most variances are nothing but rounding, the gradient still points home.
    prediction[:, 15, 18] = 1.0 - codes[0]
    compare(lambda x: kernels.ssim(x, target.to(x)), [prediction], value=1e-5, gradient=5e-3)


def test_ssim_of_hard_edges():
    """Pixels that are either black or white, at random."""
    prediction, target = (random(3, 50, 43, seed=i).sign().clamp_min(0.0) for i in (1, 2))
    compare(lambda x: kernels.ssim(x, target.to(x)), [prediction])


def test_ssim_gives_nan_for_nan():
    """What is not a number must reach the loss, where training refuses it."""
    picture = torch.rand(3, 20, 20)
    picture[1, 3, 4] = math.nan
    assert kernels.ssim(picture, torch.rand(3, 20, 20)).isnan()
    assert kernels.ssim(torch.rand(3, 20, 20), picture).isnan()


@pytest.mark.parametrize("shape", [(6, 6, 6), (6, 6, 129), (6, 129, 6), (1, 17, 16), (3, 8, 8)])
def test_blur_of_odd_sizes(shape):
    compare(lambda x: kernels.gaussian_blur(x, 11, 3.0), [random(*shape)])


@pytest.mark.parametrize("size", [1, 3, 11])
def test_blur_of_other_windows(size):
    compare(lambda x: kernels.gaussian_blur(x, size, 1.0), [random(2, 12, 19)])


def test_blur_of_extreme_radiance():
    """A lamp of 8,000 in the corner of a picture of 1e-5; compared pixel by pixel, not by the norm."""
    picture = torch.full((6, 40, 40), 1e-5)
    picture[:, 0, 0] = math.exp(LOG_RADIANCE_RANGE[1])
    blurred = kernels.gaussian_blur(picture, 11, 3.0)
    torch.testing.assert_close(
        blurred.double(), kernels.gaussian_blur_reference(picture.double(), 11, 3.0), rtol=3e-6, atol=0
    )


@pytest.mark.parametrize("shape", [(6, 67, 45), (3, 6, 6), (1, 33, 8)])
def test_blur_and_ssim_have_the_same_bits_for_any_number_of_threads(shape):
    picture, target = random(*shape), torch.rand(shape, generator=torch.Generator().manual_seed(1))
    assert_same_bits(lambda: with_gradients(lambda x: kernels.gaussian_blur(x, 11, 3.0), picture))
    assert_same_bits(lambda: with_gradients(lambda x: kernels.ssim(x, target), picture))


@pytest.mark.parametrize("order", ["channels last", "reversed", "every other"])
def test_tensors_need_not_be_contiguous(order):
    def view(t):
        if order == "channels last":
            return t.permute(1, 2, 0).contiguous().permute(2, 0, 1)
        return t.flip(2) if order == "reversed" else t.repeat_interleave(2, dim=2)[:, :, ::2]

    picture, target = random(3, 24, 20), torch.rand(3, 24, 20)
    compare(lambda x: kernels.gaussian_blur(view(x), 11, 3.0), [picture])
    compare(lambda x: kernels.ssim(view(x), view(target).to(x)), [picture])
    flat = random(3, 400)
    compare(lambda *t: kernels.curve_mlp(view(t[0][None])[0], *t[1:], "relu"), [flat, *curve_weights()])
