# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's forward pass and losses, from its equations, on a handful of random Gaussians."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.errors import BadValueError
from physhdr.lab.peers.paper import PaperConfig, PaperImageExposure, PaperPhysHDR, new_paper
from physhdr.lab.peers.paper_losses import PaperLossConfig, consistency_loss
from physhdr.lab.peers.paper_networks import (
    FusingToneMapper,
    LearnedComposer,
    LearnedModulator,
    PaperToneMapperConfig,
)

ANCHOR = (1.0, 0.73)
PAPER = PRESETS["paper"].method
UNMIXED = PaperToneMapperConfig(mix=False)


@pytest.fixture
def camera():
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_field_of_view(pose, 24, 20, 0.8)


def make(config: PaperConfig = PAPER, trained: bool = True) -> PaperPhysHDR:
    """The method on 30 Gaussians; ``trained``: nothing is where it started."""
    rng = np.random.default_rng(5)
    positions, radiance = rng.uniform(-0.6, 0.6, (30, 3)), rng.uniform(-1.5, 0.5, (30, 3))
    start = {"opacity": 0.6, "ambient_share": None, "seed": 0}
    gaussians = initial_gaussians(positions, radiance, sh_degree=3, context_size=4, **start)
    torch.manual_seed(2)
    method = new_paper(config, gaussians, MethodSetup(ANCHOR, "reference"))
    if trained:
        generator = torch.Generator().manual_seed(4)
        with torch.no_grad():
            for name, tensor in [*method.named_parameters(), *gaussians.parameters.items()]:
                if name not in ("means", "log_scales"):
                    tensor += 0.1 * torch.randn(tensor.shape, generator=generator)
    return method


def render(method, camera, exposure):
    return method.develop(method.draw(camera, (1.0,), exposure), exposure)


def raster64(method, colours, camera):
    g = method.gaussians
    arrays = (g.means, g.quaternions, g.scales, g.opacities, colours)
    return rasterize(*(a.detach().double() for a in arrays), camera).image.float()


def test_learned_networks_start_as_the_physical_law():
    log_a, log_h = torch.randn(50, 1), torch.randn(50, 3)
    assert torch.allclose(LearnedComposer(64)(log_a, log_h), (log_a + log_h).exp())
    assert torch.allclose(LearnedModulator(64)(log_a, 8.0), log_a + math.log(8.0))


def test_mixing_starts_as_the_mean_and_stays_between():
    torch.manual_seed(0)
    mapper, generator = FusingToneMapper(PaperToneMapperConfig(), ANCHOR), torch.Generator().manual_seed(1)
    glo, loc = torch.rand(2, 3, 9, 7, generator=generator)
    assert torch.allclose(mapper.mix(glo, loc), 0.5 * (glo + loc), atol=1e-6)
    with torch.no_grad():
        mapper.fusion.w2.normal_(generator=generator)
    mixed = mapper.mix(glo, loc)
    assert (mixed >= torch.minimum(glo, loc) - 1e-6).all() and (mixed <= torch.maximum(glo, loc) + 1e-6).all()
    assert not torch.allclose(mixed, 0.5 * (glo + loc), atol=1e-2)


def test_the_paper_fuses_crosswise(camera):
    """Eq. 8–14 step by step: two renders, four tone-mapped images, two fused ones, their mean."""
    method, t = make(), 2.0
    mapper = method.tone_mapper
    with torch.no_grad():
        splats = method.gaussians.splats(camera, method.active_sh_degree)
        hdr = raster64(method, method.radiance_of(splats, None), camera)
        relit = raster64(method, method.radiance_of(splats, (t,)), camera)
        context = raster64(method, method.gaussians.context, camera)
        glo, loc = mapper.tone_map(hdr * t, context)
        relit_glo, relit_loc = mapper.tone_map(relit, context)  # not multiplied by t: l = t does that
        ldr_ig, ldr_gi = mapper.mix(glo, relit_loc), mapper.mix(relit_glo, loc)
        rendering = render(method, camera, t)
    assert torch.allclose(rendering.exposed, hdr * t, atol=1e-4)
    assert torch.allclose(rendering.relit, relit, atol=1e-4)
    for got, expected in zip(rendering.supervised, (0.5 * (ldr_ig + ldr_gi), ldr_ig, ldr_gi), strict=True):
        assert torch.allclose(got, expected, atol=1e-4)
    assert not torch.allclose(ldr_ig, ldr_gi, atol=1e-3)


def test_the_printed_equation_13_fuses_the_exposed_branch_with_itself(camera):
    method, t = make(), 2.0
    method.config = dataclasses.replace(method.config, illumination_fusion="literal")
    with torch.no_grad():
        drawn = method.draw(camera, (1.0,), t)
        exposed = drawn.image_exposure * t
        glo, loc = method.tone_mapper.tone_map(exposed, drawn.context)
        _, relit_loc = method.tone_mapper.tone_map(drawn.illumination, drawn.context)
        _, ldr_ig, ldr_gi = method.develop(drawn, t).supervised
    assert torch.allclose(ldr_gi, method.tone_mapper.mix(glo, loc), atol=1e-6)
    assert torch.allclose(ldr_ig, method.tone_mapper.mix(glo, relit_loc), atol=1e-6)


def test_untrained_branches_of_the_paper_agree(camera):
    """g starts as the product and φ as a scaling by l = t, so that L_cons starts at zero."""
    method = make(trained=False)
    rendering = render(method, camera, 8.0)
    assert torch.allclose(rendering.exposed, rendering.relit, rtol=1e-4)
    assert method.losses(rendering, torch.rand(3, 20, 24))["cons"] < 1e-5


def test_losses_are_the_equations_with_the_presets_weights(camera):
    """Eq. 15, 16 and 19 in float64 by NumPy and SciPy, with the numbers that the paper gives."""
    method, exposure = make(), 2.0
    picture = torch.rand(3, 20, 24, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        rendering = render(method, camera, exposure)
        terms = {name: float(term) for name, term in method.losses(rendering, picture).items()}
    target = picture.double().numpy()

    def window(image, sigma, mode):
        across = {"sigma": sigma, "truncate": 5.0 / sigma, "axes": (1, 2), "mode": mode}
        return gaussian_filter(image, **across)

    def ssim(x, y):  # 11 × 11, σ = 1.5, zeros around the picture, as 3DGS has it
        blurred = [window(each, 1.5, "constant") for each in (x, y, x * x, y * y, x * y)]
        mx, my, xx, yy, xy = blurred
        above = (2 * mx * my + 0.01**2) * (2 * (xy - mx * my) + 0.03**2)
        return (above / ((mx**2 + my**2 + 0.01**2) * (xx - mx**2 + yy - my**2 + 0.03**2))).mean()

    shown = [image.double().numpy() for image in rendering.supervised]
    rec = sum(0.2 * np.mean((x - target) ** 2) + 1.0 - ssim(x, target) for x in shown)
    assert terms["rec"] == pytest.approx(rec, rel=1e-4)
    radiances = (rendering.exposed.double().numpy(), rendering.relit.double().numpy())
    exposed, relit = (window(each, 3.0, "mirror") for each in radiances)
    assert terms["cons"] == pytest.approx(0.5 * np.abs(exposed - relit).mean(), rel=1e-4)
    m = {name: p.detach().double().numpy() for name, p in method.tone_mapper.named_parameters()}
    hidden = np.log1p(np.exp(m["w1"] * math.log(ANCHOR[0]) + m["b1"]))  # softplus
    at_anchor = 1.0 / (1.0 + np.exp(-((m["w2"] * hidden).sum(axis=1) + m["b2"])))
    assert terms["unit"] == pytest.approx(0.5 * np.mean((at_anchor - ANCHOR[1]) ** 2), rel=1e-4)
    assert terms.keys() == {"rec", "cons", "unit"} and min(terms.values()) > 1e-3


def test_consistency_is_blurred_and_blind_to_fine_detail():
    config = PaperLossConfig()
    flat = torch.full((3, 40, 40), 2.0)
    assert math.isclose(consistency_loss(flat, flat + 0.5, config).item(), 0.5, rel_tol=1e-5)
    checker = flat + 0.5 * (-1.0) ** (torch.arange(40)[:, None] + torch.arange(40)[None])
    assert consistency_loss(flat, checker, config) < 0.01  # |difference| is 0.5 everywhere
    logarithmic = PaperLossConfig(consistency_domain="log")
    expected = math.log1p(2.5) - math.log1p(2.0)
    assert math.isclose(consistency_loss(flat, flat + 0.5, logarithmic).item(), expected, rel_tol=1e-4)


def test_the_image_exposure_branch_alone_is_its_global_and_local_curves(camera):
    config = dataclasses.replace(PAPER, illumination_branch=False, tone_mapper=UNMIXED)
    method = make(config)
    assert type(method) is PaperImageExposure and config.traits.brackets_at_once
    with torch.no_grad():
        splats = method.gaussians.splats(camera, method.active_sh_degree)
        radiance = raster64(method, method.radiance_of(splats, None), camera)
        _, loc = method.tone_mapper.tone_map(radiance * 2.0, raster64(method, splats.context, camera))
    assert torch.allclose(method.ldr(camera, 2.0), loc, atol=1e-4)
    assert torch.allclose(method.hdr(camera, 3.0), 3.0 * method.hdr(camera), rtol=1e-4)


def test_settings_that_contradict_each_other_are_refused():
    for changes in ({"illumination_branch": False}, {"tone_mapper": PaperToneMapperConfig(local=False)}):
        with pytest.raises(BadValueError, match=r"f_mix[\s\S]*mix=false"):
            PaperConfig(**changes)
    with pytest.raises(BadValueError, match="odd number"):
        PaperLossConfig(blur_size=4)
    with pytest.raises(BadValueError, match=r"bracket[\s\S]*--set supervision=one"):
        dataclasses.replace(PRESETS["paper"], supervision="bracket")
