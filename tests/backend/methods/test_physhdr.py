# SPDX-License-Identifier: GPL-3.0-or-later
"""The forward pass and the losses, from their equations, on a handful of random Gaussians."""

import numpy as np
import pytest
import torch

from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.methods.physhdr_common import PhysHDRConfig, PhysHDRMethod
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.errors import BadValueError

ANCHOR = (1.0, 0.73)
#: The presets of this method, in the paper's form as well, on 3DGS's backbone.
OURS = [
    name
    for name, config in PRESETS.items()
    if isinstance(config.method, PhysHDRConfig) and config.backbone.name == "gaussians"
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
    method = METHODS[config.name].make(config, gaussians, MethodSetup(ANCHOR, "reference", lights))
    if trained:
        generator = torch.Generator().manual_seed(4)
        with torch.no_grad():
            for name, tensor in [*method.named_parameters(), *gaussians.parameters.items()]:
                if name not in ("means", "log_scales"):
                    tensor += 0.1 * torch.randn(tensor.shape, generator=generator)
    return method


def render(method, camera, exposure, level=1.0):
    return method.develop(method.draw(camera, (level,), exposure), exposure)


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
        if method.config.has_light_share:  # a share shows only under other light
            lit = method.losses(render(method, camera, 2.0, 4.0), torch.rand(3, 20, 24))
            terms["lit"] = lit["rec"]
        torch.stack(list(terms.values())).sum().backward()
        for name, tensor in [*method.named_parameters(), *method.gaussians.parameters.items()]:
            if method.config.tone_mapper.anchored and name == "tone_mapper.b2":
                continue  # the anchor takes the place of a constant
            assert tensor.grad is not None and tensor.grad.abs().sum() > 0, (preset, name)


def test_settings_that_contradict_each_other_are_refused():
    with pytest.raises(BadValueError, match=r"method\.sh_degree"):
        PhysHDRConfig(sh_degree=4)
    with pytest.raises(BadValueError, match=r"knows one light, the data have ambient, pendant"):
        PRESETS["baseline"].method.attributes(("ambient", "pendant"))
