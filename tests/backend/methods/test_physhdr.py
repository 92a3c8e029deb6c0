# SPDX-License-Identifier: GPL-3.0-or-later
"""The forward pass and the losses, from their equations, on a handful of random Gaussians."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from physhdr.backend.methods.base import Facts
from physhdr.backend.methods.losses import LossConfig, consistency_loss
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.methods.physhdr_common import PhysHDRConfig, PhysHDRMethod
from physhdr.backend.methods.registry import METHODS, new_method
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.model.tone_mapper import ToneMapperConfig
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.errors import BadValueError

ANCHOR = (1.0, 0.73)
#: The presets of this method on 3DGS's backbone.
OURS = [
    name
    for name, config in PRESETS.items()
    if isinstance(config.method, PhysHDRConfig) and config.anchors is None
]


@pytest.fixture
def camera():
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_field_of_view(pose, 24, 20, 0.8)


def make(preset: str, trained: bool = True, lights: tuple[str, ...] = ("ambient",)) -> PhysHDRMethod:
    """A method with the preset's parts; ``trained``: nothing is where it started."""
    config = PRESETS[preset].method
    rng = np.random.default_rng(5)
    gaussians = initial_gaussians(
        rng.uniform(-0.6, 0.6, (30, 3)),
        rng.uniform(-1.5, 0.5, (30, 3)),
        sh_degree=config.sh_degree,
        opacity=0.6,
        ambient_share=0.3 if config.has_light_share else None,
        context_size=4 if config.tone_mapper.local else 0,
        seed=0,
        lights=len(lights),
    )
    torch.manual_seed(2)
    method = METHODS["physhdr"].make(config, gaussians, Facts(ANCHOR, "reference", lights))
    if trained:
        generator = torch.Generator().manual_seed(4)
        with torch.no_grad():
            for name, tensor in [*method.named_parameters(), *gaussians.parameters.items()]:
                if name not in ("means", "log_scales"):
                    tensor += 0.1 * torch.randn(tensor.shape, generator=generator)
    return method


def render(method, camera, exposure, level=1.0):
    return method.develop(method.draw(camera, (level,), exposure), exposure)


def raster64(method, colours, camera):
    g = method.gaussians
    arrays = (g.means, g.quaternions, g.scales, g.opacities, colours)
    return rasterize(*(a.detach().double() for a in arrays), camera).image.float()


def test_the_paper_fuses_crosswise(camera):
    """Eq. 8–14 step by step: two renders, four tone-mapped images, two fused ones, their mean."""
    method, t = make("paper"), 2.0
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
    method, t = make("paper"), 2.0
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
    method = make("paper", trained=False)
    rendering = render(method, camera, 8.0)
    assert torch.allclose(rendering.exposed, rendering.relit, rtol=1e-4)
    assert method.losses(rendering, torch.rand(3, 20, 24))["cons"] < 1e-5


def test_losses_are_the_equations_with_the_presets_weights(camera):
    """Eq. 15, 16 and 19 in float64 by NumPy and SciPy, with the numbers that the paper gives."""
    method, exposure = make("paper"), 2.0
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
    config = LossConfig(consistency_domain="linear")
    flat = torch.full((3, 40, 40), 2.0)
    assert math.isclose(consistency_loss(flat, flat + 0.5, config).item(), 0.5, rel_tol=1e-5)
    checker = flat + 0.5 * (-1.0) ** (torch.arange(40)[:, None] + torch.arange(40)[None])
    assert consistency_loss(flat, checker, config) < 0.01  # |difference| is 0.5 everywhere
    logarithmic = LossConfig(consistency_domain="log")
    expected = math.log1p(2.5) - math.log1p(2.0)
    assert math.isclose(consistency_loss(flat, flat + 0.5, logarithmic).item(), expected, rel_tol=1e-4)


def test_relighting_of_the_default_is_exactly_linear(camera):
    method = make("default")
    at = {level: method.hdr(camera, level) for level in (0.25, 1.0, 3.0)}
    fixed = (at[0.25] - 0.25 * at[1.0]) / 0.75
    assert torch.allclose(at[3.0], fixed + 3.0 * (at[1.0] - fixed), atol=1e-4)
    assert (at[3.0] - 3.0 * at[1.0]).abs().max() > 0.05  # not a mere scaling
    # and its picture is the response at radiance × exposure
    ldr = method.ldr(camera, 2.0, 3.0)
    expected, _ = method.tone_mapper.tone_map(at[3.0] * 2.0, None)
    assert torch.allclose(ldr, expected, atol=1e-5)


def test_relighting_by_several_lights_is_superposition(camera):
    """Radiance at levels (a, b) is fixed + a · A + b · B, and so in every picture that is blended of it."""
    method = make("default", lights=("ambient", "pendant"))
    fixed, ambient, pendant = (method.hdr(camera, level) for level in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    ambient, pendant = ambient - fixed, pendant - fixed
    for a, b in [(1.0, 1.0), (4.0, 0.25), (0.0, 8.0)]:
        expected = fixed + a * ambient + b * pendant
        assert torch.allclose(method.hdr(camera, (a, b)), expected, rtol=1e-4, atol=2e-5)
    assert min(light.abs().max() for light in (fixed, ambient, pendant)) > 0.05
    # A plain number is the first light's, the other stays as it was.
    assert torch.equal(method.hdr(camera, 4.0), method.hdr(camera, (4.0, 1.0)))
    assert torch.equal(method.hdr(camera), method.hdr(camera, (1.0, 1.0)))
    drawn = method.preview(camera, (4.0, 0.25))
    assert torch.allclose(drawn.image, method.hdr(camera, (4.0, 0.25)), atol=1e-5)
    ldr = method.ldr(camera, 2.0, (4.0, 0.25))
    shown, _ = method.tone_mapper.tone_map(method.hdr(camera, (4.0, 0.25)) * 2.0, None)
    assert torch.allclose(ldr, shown, atol=1e-5)
    assert torch.allclose(method.preview_ldr(drawn, camera, 2.0, (4.0, 0.25))[0], shown, atol=1e-5)


def test_levels_that_do_not_fit_the_lights(camera):
    method = make("default", lights=("ambient", "pendant"))
    for levels, message in [
        ((1.0,), "ambient, pendant"),
        ((1.0, -1.0), "pendant"),
        (float("nan"), "ambient"),
    ]:
        with pytest.raises(BadValueError, match=message):
            method.hdr(camera, levels)
        with pytest.raises(BadValueError, match=message):
            method.ldr(camera, 1.0, levels)
        with pytest.raises(BadValueError, match=message):
            method.ldr_bracket(camera, [1.0, 2.0], levels)
        with pytest.raises(BadValueError, match=message):
            method.preview(camera, levels)


def test_a_learned_modulator_knows_one_light():
    config = PhysHDRConfig(modulator="learned")
    with pytest.raises(BadValueError, match=r"learned modulator knows one light[\s\S]*additive"):
        new_method(config, None, Facts(ANCHOR, lights=("ambient", "pendant")))


def test_what_the_illumination_branch_alone_develops_is_its_radiance(camera):
    config = dataclasses.replace(PRESETS["default"].method, modulator="learned")
    method = PhysHDR(config, make("default").backbone, Facts(ANCHOR))
    with torch.no_grad():
        for parameter in method.modulator.parameters():
            parameter.add_(0.3)  # no longer the identity at level 1
    assert torch.allclose(method.hdr(camera), method.hdr(camera, 1.0 + 1e-6), rtol=1e-4)
    developed = method.tone_mapper.tone_map(method.hdr(camera) * 2.0, None)[0]
    assert torch.allclose(method.ldr(camera, 2.0), developed, atol=1e-5)
    with pytest.raises(BadValueError, match=r"illumination branch alone[\s\S]*lighting-level view"):
        dataclasses.replace(config, lighting_level="exposure")


@pytest.mark.parametrize("preset", OURS)
def test_level_0_is_finite(preset, camera):
    method = make(preset)
    assert method.hdr(camera, 0.0).isfinite().all() and method.ldr(camera, 2.0, 0.0).isfinite().all()


def test_without_an_illumination_branch_a_level_only_scales(camera):
    method = make("baseline")
    assert torch.allclose(method.hdr(camera, 3.0), 3.0 * method.hdr(camera), rtol=1e-4)
    assert torch.allclose(method.ldr(camera, 2.0, 3.0), method.ldr(camera, 6.0), atol=1e-5)


@pytest.mark.parametrize("level", [1.0, 4.0])
@pytest.mark.parametrize("preset", OURS)
def test_a_photo_under_other_light_is_the_picture_with_the_cameras_effect_on_it(preset, level, camera):
    method, exposures = make(preset), [0.5, 2.0]
    nothing, half_of_it = torch.ones(3, 1, 1), torch.ones(1, 20, 24)
    half_of_it[..., 12:] = 0.0
    for exposure, photo in zip(
        exposures, method.photographed(camera, exposures, [nothing, nothing], level), strict=True
    ):
        torch.testing.assert_close(photo, method.ldr(camera, exposure, level), rtol=0.0, atol=1e-6)
    (vignetted,) = method.photographed(camera, [0.5], [half_of_it], level)
    left, right = method.ldr(camera, 0.5, level).split(12, dim=2)
    torch.testing.assert_close(vignetted[..., :12], left, rtol=0.0, atol=1e-6)
    assert not torch.allclose(vignetted[..., 12:], right, atol=1e-2)


def test_every_parameter_of_every_preset_receives_a_gradient(camera):
    for preset in OURS:
        method = make(preset)
        terms = method.losses(render(method, camera, 2.0, 1.0), torch.rand(3, 20, 24))
        if method.config.lighting_level == "view":  # a share shows only under other light
            lit = method.losses(render(method, camera, 2.0, 4.0), torch.rand(3, 20, 24))
            terms["lit"] = lit["rec"]
        torch.stack(list(terms.values())).sum().backward()
        for name, tensor in [*method.named_parameters(), *method.gaussians.parameters.items()]:
            if method.config.tone_mapper.anchored and name == "tone_mapper.b2":
                continue  # the anchor takes the place of a constant
            assert tensor.grad is not None and tensor.grad.abs().sum() > 0, (preset, name)


def test_settings_that_contradict_each_other_are_refused():
    with pytest.raises(BadValueError, match="f_mix"):
        PhysHDRConfig(tone_mapper=ToneMapperConfig(mix=True))
    with pytest.raises(BadValueError, match="image-exposure"):
        PhysHDRConfig(branches="image-exposure")
    with pytest.raises(BadValueError, match="SH degree"):
        PhysHDRConfig(sh_degree=4)
    with pytest.raises(BadValueError, match=r"learned composer[\s\S]*--method.modulator learned"):
        PhysHDRConfig(composer="learned")
    with pytest.raises(BadValueError, match=r"bracket[\s\S]*--supervision one"):
        dataclasses.replace(PRESETS["paper"], supervision="bracket")
