# SPDX-License-Identifier: GPL-3.0-or-later
"""Composer, modulator and tone mapper against closed forms."""

import copy
import math

import numpy as np
import pytest
import torch

from physhdr.backend.model import tone_mapper
from physhdr.backend.model.gaussians import Gaussians, initial_gaussians
from physhdr.backend.model.radiance import AdditiveModulator, ProductComposer
from physhdr.backend.model.tone_mapper import ToneMapper, ToneMapperConfig
from physhdr.backend.rasterize.reference import rotation_matrices
from physhdr.bridge.ply_model import light_shares

ANCHOR = (1.0, 0.5 ** (1.0 / 2.2))


def randomised(module: torch.nn.Module) -> torch.nn.Module:
    """As after training: no weight is where it started."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.3 * torch.randn(parameter.shape, generator=generator)
    return module


def test_the_product_is_the_product():
    log_a, log_h = torch.randn(50, 1), torch.randn(50, 3)
    assert torch.allclose(ProductComposer()(log_a, log_h), log_a.exp() * log_h.exp())


def test_the_additive_modulator_is_linear_in_light():
    log_a, share = torch.randn(50, 1), torch.rand(50, 3)
    modulate = AdditiveModulator()
    at = {level: modulate(log_a, (level,), share[:, None]).exp() for level in (0.0, 0.25, 1.0, 4.0)}
    assert torch.allclose(at[1.0], log_a.exp().expand(-1, 3))
    for level, value in at.items():
        assert torch.allclose(value, at[0.0] + level * (at[1.0] - at[0.0]), atol=1e-5)
    assert torch.allclose(at[0.0], log_a.exp() * (1.0 - share), atol=1e-5)
    assert modulate(log_a, (0.0,), torch.ones(50, 1, 3)).isfinite().all()


def lit_gaussians(lights: int, count: int = 20) -> Gaussians:
    """Random shares of each light, in float64."""
    generator = torch.Generator().manual_seed(lights)
    logits = torch.randn(count, lights, 3, generator=generator, dtype=torch.float64)
    return Gaussians({"light_share_logits": (2.0 * logits).requires_grad_()})


def test_shares_of_several_lights_are_a_softmax_with_a_fixed_part():
    gaussians = lit_gaussians(3)
    weights = gaussians.light_share_logits.detach().exp()
    expected = weights / (1.0 + weights.sum(dim=1, keepdim=True))
    assert torch.allclose(gaussians.light_share, expected, rtol=1e-12)
    alone = lit_gaussians(1)
    assert torch.equal(alone.light_share, alone.light_share_logits.sigmoid())
    # What numpy makes of the same parameters when Blender reads the lossless PLY.
    for each in (gaussians, alone):
        logits = each.light_share_logits.detach().numpy()
        np.testing.assert_allclose(light_shares(logits), each.light_share.detach().numpy(), rtol=1e-6)


@pytest.mark.parametrize("levels", [(0.25, 4.0, 1.0), (0.0, 0.0, 0.0), (30.0, 0.0, 2.0), (1.0, 1.0, 1.0)])
def test_the_additive_modulator_of_three_lights(levels):
    """Against the closed form: ln L̂ = ln L + ln(1 + Σ s_k (l_k − 1)), and its derivatives."""
    gaussians = lit_gaussians(3)
    log_a = torch.randn(20, 1, dtype=torch.float64, requires_grad=True)
    relit = AdditiveModulator()(log_a, levels, gaussians.light_share)
    share = gaussians.light_share.detach()
    offset = torch.tensor(levels, dtype=torch.float64)[:, None] - 1.0
    change = (share * offset).sum(dim=1)
    assert torch.allclose(relit, log_a + (1.0 + change).log(), rtol=1e-12)
    relit.sum().backward()
    # ∂s_k/∂z_j = s_k (δ_kj − s_j), so ∂ ln L̂/∂z_j = s_j (l_j − 1 − Σ s_k (l_k − 1)) / (1 + Σ s_k (l_k − 1)).
    expected = share * (offset - change[:, None]) / (1.0 + change[:, None])
    assert torch.allclose(gaussians.light_share_logits.grad, expected, rtol=1e-9, atol=1e-12)
    assert torch.allclose(log_a.grad, torch.full_like(log_a, 3.0))

    def modulated(logits):
        return AdditiveModulator()(
            log_a.detach(), levels, Gaussians({"light_share_logits": logits}).light_share
        )

    assert torch.autograd.gradcheck(modulated, (gaussians.light_share_logits.detach().requires_grad_(),))


def test_lights_switched_off_leave_something_to_take_the_logarithm_of():
    logits = torch.tensor([30.0, 30.0])[None, :, None].expand(4, 2, 3).clone().requires_grad_()
    share = Gaussians({"light_share_logits": logits}).light_share
    relit = AdditiveModulator()(torch.zeros(4, 1), (0.0, 0.0), share)
    relit.sum().backward()
    assert relit.isfinite().all() and logits.grad.isfinite().all()


def test_several_lights_start_with_equal_parts():
    points, log_radiance = np.random.default_rng(0).normal(size=(2, 5, 3))
    options = {"sh_degree": 0, "opacity": 0.5, "context_size": 0, "seed": 0}
    for lights, expected in ((1, 0.3), (2, 1 / 3), (4, 0.2)):
        gaussians = initial_gaussians(points, log_radiance, ambient_share=0.3, lights=lights, **options)
        assert gaussians.light_share.shape == (5, lights, 3)
        assert torch.allclose(gaussians.light_share, torch.tensor(expected))


START = {"sh_degree": 0, "opacity": 0.5, "ambient_share": None, "context_size": 0, "seed": 0}


def test_first_gaussians_lie_along_the_surface_that_their_neighbours_make():
    """On a tilted plane and on a ball, where the normal is known; as wide as 3DGS's rule has it."""
    rng = np.random.default_rng(0)
    normal = np.array([0.36, -0.48, 0.8])
    across = np.linalg.svd(normal[None])[2][1:]
    plane = rng.uniform(-1.0, 1.0, (400, 2)) @ across + 1e-3 * rng.normal(size=(400, 3)) + 5.0
    ball = rng.normal(size=(2000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for points, normals in ((plane, np.tile(normal, (400, 1))), (ball, ball)):
        flat = initial_gaussians(points, np.zeros_like(points), thickness=0.25, **START)
        thin = rotation_matrices(flat.quaternions.detach())[:, :, 2].numpy()
        cosines = np.abs((thin * normals).sum(axis=1))
        assert np.quantile(cosines, 0.05) > 0.98 and np.median(cosines) > 0.998
        nearest = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)[:, 1:4]
        width = np.sqrt((nearest**2).mean(axis=1))
        wanted = width[:, None] * np.array([1.0, 1.0, 0.25])
        assert flat.scales.detach().numpy() == pytest.approx(wanted, rel=1e-5)


def test_first_gaussians_of_3dgs_are_spheres_whatever_lies_around():
    points = np.random.default_rng(0).normal(size=(5, 3))
    round_ones = initial_gaussians(points, points, **START)
    assert torch.equal(round_ones.quaternions, torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(5, 1))
    assert torch.equal(round_ones.log_scales, round_ones.log_scales[:, :1].repeat(1, 3))
    flat = initial_gaussians(points[[0, 0, 1, 1]], points[:4], thickness=0.3, **START)
    assert all(tensor.isfinite().all() for tensor in flat.parameters.values())  # points that coincide


@pytest.mark.parametrize("slope", [None, 0.6])
def test_an_anchored_response_meets_its_anchor_whatever_it_learns(slope):
    mapper = randomised(ToneMapper(ToneMapperConfig(initial_slope=slope), ANCHOR))
    x = torch.full((3, 1), math.log(ANCHOR[0]))
    assert torch.allclose(mapper.curve_logits(x).sigmoid(), torch.tensor(ANCHOR[1]), atol=1e-6)
    assert mapper.unit_exposure_error() < 1e-10
    free = randomised(ToneMapper(ToneMapperConfig(initial_slope=slope, anchored=False), ANCHOR))
    error = free.unit_exposure_error()
    assert torch.allclose(error, (free.curve_logits(x).sigmoid() - ANCHOR[1]).square().mean())
    assert error > 1e-4


def test_the_warm_start_fits_the_curve_of_hdr_nerf():
    torch.manual_seed(0)
    config = ToneMapperConfig(anchored=False, initial_slope=None, warm_start_steps=1000)
    mapper = ToneMapper(config, None)
    mapper.warm_start(0)
    x = torch.linspace(-3.0, 3.0, 61).expand(3, -1).contiguous()
    error = (mapper.curve_logits(x).sigmoid() - torch.log1p(x.exp()).clamp(0.0, 1.0)).abs()
    assert error.mean() < 0.03


def test_the_warm_start_leaves_no_gradient_behind():
    mapper = ToneMapper(ToneMapperConfig(initial_slope=0.6, warm_start_steps=3), ANCHOR)
    mapper.warm_start(0)
    assert all(parameter.grad is None for parameter in mapper.parameters())


def test_the_inverse_undoes_the_response():
    mapper = ToneMapper(ToneMapperConfig(), ANCHOR)
    x = torch.linspace(-6.0, 4.0, 50).expand(3, -1).contiguous()
    assert torch.allclose(mapper.inverse(mapper.curve_logits(x).sigmoid()), x, atol=0.02)


def test_local_curves_correct_the_global_one():
    torch.manual_seed(1)
    mapper = randomised(ToneMapper(ToneMapperConfig(local=True), ANCHOR))
    exposed, context = torch.rand(3, 5, 7) * 4.0, torch.randn(4, 5, 7)
    glo, loc = mapper.tone_map(exposed, context)
    assert loc.shape == glo.shape == (3, 5, 7)
    assert loc.min() >= 0.0 and loc.max() <= 1.0
    # The correction of one pixel and channel, from its definition.
    x = (exposed[1, 2, 3] + 1e-5).log()
    delta = mapper.local_curves[1](torch.cat([x[None], context[:, 2, 3]])[:, None]).sigmoid()
    assert torch.allclose(loc[1, 2, 3], (glo[1, 2, 3] + delta[0, 0] - 0.5).clamp(0, 1), atol=1e-6)


def test_response_by_table_is_the_response():
    """20,000 points are read from a table, few are not: the same values and gradients to float32."""
    torch.manual_seed(0)
    mapper = ToneMapper(ToneMapperConfig(), ANCHOR)
    with torch.no_grad():
        mapper.w2.uniform_(-0.5, 0.5)
    many = (4.0 * torch.randn(3, 20_000)).clamp(-8.0, 8.0).requires_grad_()
    exact = copy.deepcopy(mapper).double()
    same = many.detach().double().requires_grad_()
    values, truth = mapper.response(many), exact.curve_logits(same).sigmoid()
    weights = torch.randn(values.shape)
    (values * weights).sum().backward()
    (truth * weights).sum().backward()
    assert (values - truth).abs().max() < 2e-6
    assert (many.grad - same.grad).norm() < 1e-5 * same.grad.norm()
    for name, tensor in mapper.named_parameters():
        if name != "b2":  # the anchor takes the place of a constant
            expected = exact.get_parameter(name).grad
            assert (tensor.grad - expected).norm() < 1e-4 * expected.norm(), name


def test_a_response_too_steep_for_the_table_goes_the_direct_way():
    mapper = ToneMapper(ToneMapperConfig(initial_slope=50.0), ANCHOR)
    x = torch.randn(3, 20_000)
    assert torch.equal(mapper.response(x), mapper.curve_logits(x).sigmoid())


def measured(slope=1.0):
    """A tone mapper that begins with sRGB's curve through its anchor, and the curve."""
    x = np.linspace(-5.0, -0.02, 200)
    linear = np.exp(x)
    values = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    logits = slope * np.log(values / (1.0 - values))
    mapper = ToneMapper(ToneMapperConfig(), (float(linear[100]), float(1.0 / (1.0 + np.exp(-logits[100])))))
    mapper.begin_with(np.tile(x, (3, 1)), np.tile(logits, (3, 1)))
    return mapper, torch.from_numpy(x), torch.from_numpy(logits)


def test_a_measured_response_is_what_training_begins_with():
    mapper, x, logits = measured()
    found = mapper.curve_logits(x.expand(3, -1).float())
    assert (found.sigmoid() - logits.sigmoid()).abs().max() < 2e-3  # half a code
    # Beyond what was measured it goes straight on, also beyond its table's ends.
    last = (logits[-1] - logits[-2]) / (x[-1] - x[-2])
    far = mapper.curve_logits(torch.full((3, 1), 2.0)) - mapper.curve_logits(torch.full((3, 1), 1.0))
    assert torch.allclose(far.double(), last, rtol=1e-4)
    first = (logits[1] - logits[0]) / (x[1] - x[0])
    far = mapper.curve_logits(torch.full((3, 1), -14.0)) - mapper.curve_logits(torch.full((3, 1), -15.0))
    assert torch.allclose(far.double(), first, rtol=1e-4)
    # What is learned is added to it.
    assert mapper.slope.abs().max() == 0.0 and mapper.measured not in set(mapper.parameters())


def test_a_measured_response_has_the_slope_that_it_is_drawn_with():
    mapper = randomised(measured()[0]).double()
    x = torch.linspace(-13.0, 9.0, 40, dtype=torch.float64).expand(3, -1).contiguous() + 1e-4
    assert torch.autograd.gradcheck(mapper.curve_logits, x.clone().requires_grad_())
    values, step = mapper.get_buffer(tone_mapper.MEASURED), 1e-6
    _, slopes = tone_mapper._measured_logits(x, values)
    ahead, behind = (tone_mapper._measured_logits(x + each, values)[0] for each in (step, -step))
    assert torch.allclose(slopes, (ahead - behind) / (2.0 * step), atol=1e-5)
    at_anchor = torch.full((3, 1), math.log(mapper.anchor[0]), dtype=torch.float64)
    assert torch.allclose(mapper.curve_logits(at_anchor).sigmoid(), torch.tensor(mapper.anchor[1]).double())


@pytest.mark.parametrize("steepness", [1.0, 8.0])
def test_a_measured_response_by_table_is_the_response(steepness):
    """As for one that begins as a line, but for what a bend where it was measured costs: 1/40 of a code."""
    mapper = measured(steepness)[0]
    torch.manual_seed(0)
    with torch.no_grad():
        mapper.w2.uniform_(-0.2, 0.2)
    many = (2.0 * torch.randn(3, 20_000) - 2.0).clamp(-8.0, 6.0).requires_grad_()
    exact = copy.deepcopy(mapper).double()
    same = many.detach().double().requires_grad_()
    values, truth = mapper.response(many), exact.curve_logits(same).sigmoid()
    weights = torch.randn(values.shape)
    (values * weights).sum().backward()
    (truth * weights).sum().backward()
    assert (values - truth).abs().max() < 1e-4
    assert (many.grad - same.grad).norm() < 2e-3 * same.grad.norm()
    assert (mapper.slope.grad - exact.slope.grad).norm() < 1e-3 * exact.slope.grad.norm()
