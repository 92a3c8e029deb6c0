# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures whose response is known, masks, and what one picture's camera did: how methods compare them."""

import dataclasses

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate.pictures import pairs
from physhdr.backend.evaluate.response import learned_response
from physhdr.backend.kernels.ssim import ssim_map_reference
from physhdr.backend.methods.base import Batch, Exposed, MethodSetup, Recording
from physhdr.backend.methods.losses import compared
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.model.tone_mapper import KnownResponse, ToneMapper
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import CAMERA, SRGB, LogEncoding
from physhdr.backend.scene.scene import PictureCache, Points, Scene, View
from physhdr.backend.scene.source import Decoded, PictureSource
from physhdr.backend.train.backbones import new_method
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.half_size import halved
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import load_method, save
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError, DataMismatchError

LOG = LogEncoding(4.0)
SIZE = (24, 20)


@pytest.fixture
def camera():
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_field_of_view(pose, *SIZE, 0.8)


def make(preset="default", responses="known", double=False, **loss):
    config = PRESETS[preset].method
    if loss:
        config = dataclasses.replace(config, loss=dataclasses.replace(config.loss, **loss))
    rng = np.random.default_rng(5)
    gaussians = initial_gaussians(
        rng.uniform(-0.6, 0.6, (30, 3)),
        rng.uniform(-1.5, 1.5, (30, 3)),
        sh_degree=config.sh_degree,
        opacity=0.6,
        ambient_share=0.3 if getattr(config, "has_light_share", False) else None,
        context_size=config.attributes(("ambient",)).context_size,
        seed=0,
    )
    torch.manual_seed(2)
    anchor = None if responses == "known" else (1.0, 0.73)
    method = METHODS["physhdr"].make(config, gaussians, MethodSetup(anchor, "reference", responses=responses))
    if double:
        method.double()
        gaussians.parameters = {
            name: tensor.detach().double().requires_grad_() for name, tensor in gaussians.parameters.items()
        }
    return method


def picture_of(seed=3, peak=1.0):
    return peak * torch.rand(3, SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(seed))


def mask_of(seed=0):
    mask = torch.rand(SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(seed)) > 0.3
    mask[4:12, 5:15] = False
    return mask


def outcome_of(method, camera, *recordings):
    return method.training_outcome(Batch(camera, recordings, (1.0,), 0, pool=None))


# ---- known responses -------------------------------------------------------------------------------------


def test_a_known_response_has_nothing_to_learn_and_shows_srgb(camera):
    method = make()
    assert isinstance(method.tone_mapper, KnownResponse)
    assert "tone_mapper" not in method.parameter_groups() and not method.learns_response
    assert not [name for name in method.state_dict() if "tone_mapper" in name]
    radiance = method.hdr(camera)
    shown = SRGB.encode((radiance * 0.7).double().numpy())
    assert np.abs(method.ldr(camera, 0.7).numpy() - shown).max() < 1e-5
    drawn = method.preview(camera)
    assert np.abs(method.preview_ldr(drawn, camera, 0.7)[0].numpy() - shown).max() < 1e-5
    log_exposure, curve = (part.numpy() for part in method.response_curve())
    assert np.abs(curve - SRGB.encode(np.exp(log_exposure))[:, None]).max() < 1e-6
    assert learned_response(method) is None, "nothing for an evaluation to check"
    codes = torch.linspace(0.01, 0.99, 50).expand(3, -1)
    back = SRGB.encode(np.exp(method.first_response.inverse(codes).numpy()))
    assert np.abs(back - codes.numpy()).max() < 1e-6


@pytest.mark.parametrize("encoding", [LOG, SRGB], ids=str)
def test_radiance_is_compared_through_its_encoding(camera, encoding):
    """The loss by hand, in float64; its gradient by finite differences, of a Gaussian's radiance."""
    method = make(double=True)
    picture = picture_of().double()
    recording = Recording(exposure=0.5, picture=picture, encoding=encoding)
    terms = outcome_of(method, camera, recording).terms
    exposed = (method.hdr(camera) * 0.5).numpy()
    predicted = encoding.encode(exposed)
    if encoding.clips:  # no pixel of the picture does, so what is drawn above white is compared as it is
        assert picture.max() < 1.0
        predicted = np.where(exposed > 1.0, 1.055 * exposed.clip(1.0) ** (1 / 2.4) - 0.055, predicted)
    predicted = torch.from_numpy(predicted)
    by_hand = 0.7 * (predicted - picture).abs().mean()
    by_hand += 0.3 * (1.0 - ssim_map_reference(predicted, picture).mean())
    assert terms["rec"].item() == pytest.approx(by_hand.item(), rel=1e-9)
    terms["rec"].backward()
    parameter = method.backbone.parameters["reflectance_dc"]
    where, step = (7, 0, 1), 1e-6
    ends = []
    for sign in (1, -1):
        with torch.no_grad():
            parameter[where] += sign * step
            ends.append(outcome_of(method, camera, recording).terms["rec"].item())
            parameter[where] -= sign * step
    assert parameter.grad[where].item() == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)
    assert parameter.grad[where].abs() > 1e-7


def test_a_bracket_may_mix_a_camera_and_radiance(camera):
    """Each is developed as if it were alone; only the camera's teaches the curve."""
    method = make(responses="mixed")
    taken = [Exposed(exposure=2.0), Exposed(exposure=0.5, encoding=LOG), Exposed(exposure=1.0)]
    drawn = method.draw(camera, (1.0,))
    together = method.develop_bracket(drawn, taken)
    for one, each in zip(together, taken, strict=True):
        assert torch.allclose(one.ldr, method.develop_bracket(drawn, [each])[0].ldr, atol=1e-6)
    assert torch.allclose(together[1].ldr, LOG.developed(drawn.radiance * 0.5))
    together[1].ldr.sum().backward()
    assert all(p.grad is None for p in method.tone_mapper.parameters())
    assert isinstance(method.tone_mapper, ToneMapper) and method.tone_mapper.anchor is not None


@pytest.mark.parametrize("preset", ["paper", "gausshdr", "hdr-gs", "hdr-nerf"])
def test_methods_that_learn_every_response_say_so(preset):
    config = PRESETS[preset]
    for responses in ("known", "mixed"):
        with pytest.raises(BadValueError, match="known one") as error:
            new_method(config.method, config.backbone, MethodSetup(responses=responses))
        assert "default" in error.value.hint


# ---- masks and effects -----------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["default", "baseline", "paper"])
def test_masked_pixels_have_no_gradient_and_no_say(camera, preset):
    """Float64: ∂loss/∂prediction is exactly 0 there, whatever the picture shows; the rest is by hand."""
    method = make(preset, responses="learned")
    mask, picture = mask_of(), picture_of().double()
    developed = method.develop(method.draw(camera, (1.0,), 1.0), 1.0)
    images = [image.detach().double().requires_grad_() for image in developed.supervised]
    other = torch.where(mask, picture, 7.0)
    values = []
    for target in (picture, other):
        made = dataclasses.replace(developed, supervised=images)
        values.append(method.losses(made, target, mask)["rec"])
    assert values[0].item() == values[1].item()
    gradients = torch.autograd.grad(values[0], images)
    for gradient, image in zip(gradients, images, strict=True):
        assert (gradient[:, ~mask] == 0.0).all() and (gradient[:, mask].abs() > 0.0).all()
        del image
    loss = method.config.loss
    by_hand = 0.0
    for image in images:
        x, y = image.detach() * mask, picture * mask
        error = (x - y).square() if loss.pixel == "mse" else (x - y).abs()
        by_hand += loss.pixel_weight * error.sum() / error.numel()
        by_hand += loss.dssim_weight * (1.0 - ssim_map_reference(x, y).mean())
    assert values[0].item() == pytest.approx(by_hand.item(), rel=1e-12)


@pytest.mark.parametrize("preset", ["default", "paper", "gausshdr"])
def test_a_mask_that_hides_nothing_changes_nothing(tiny_data, preset):
    """The fused kernels see the same numbers: not one bit differs. So for a mask of all of a picture."""
    from physhdr.backend.scene import read_scene

    state = begin(read_scene(tiny_data), dataclasses.replace(PRESETS[preset], iterations=9))
    batch = state.batch(0)
    whole = state.method.training_outcome(batch).terms
    shape = batch.recordings[0].picture.shape[1:]
    masked = [dataclasses.replace(r, mask=torch.ones(shape, dtype=torch.bool)) for r in batch.recordings]
    same = state.method.training_outcome(dataclasses.replace(batch, recordings=tuple(masked))).terms
    assert {k: v.item() for k, v in whole.items()} == {k: v.item() for k, v in same.items()}
    hidden = [dataclasses.replace(r, mask=torch.zeros(shape, dtype=torch.bool)) for r in batch.recordings]
    none = state.method.training_outcome(dataclasses.replace(batch, recordings=tuple(hidden))).terms
    assert none["rec"].item() == pytest.approx(0.0, abs=1e-6)


def test_an_effect_multiplies_what_is_exposed(camera):
    method = make(responses="learned")
    drawn = method.draw(camera, (1.0,))
    gain = torch.tensor([0.5, 1.0, 2.0]).view(3, 1, 1)
    (one,) = method.develop_bracket(drawn, [Exposed(exposure=2.0, effect=gain)])
    expected = method.tone_mapper.tone_map(drawn.radiance * 2.0 * gain, None)[0]
    assert torch.equal(one.ldr, expected)
    falloff = torch.linspace(0.5, 1.0, SIZE[0]).expand(3, SIZE[1], SIZE[0])
    (one,) = method.develop_bracket(drawn, [Exposed(exposure=2.0, effect=falloff, encoding=LOG)])
    assert torch.equal(one.ldr, LOG.developed(drawn.radiance * 2.0 * falloff))


def test_of_four_masked_pixels_one_is_enough():
    camera = Camera.from_field_of_view(np.eye(4), 160, 140, 0.8)
    mask = torch.ones(140, 160, dtype=torch.bool)
    mask[11, 20], mask[100:102, 50:52] = False, False
    recording = Recording(exposure=1.0, picture=torch.zeros(3, 140, 160), mask=mask)
    _, (small,) = halved(camera, [recording])
    expected = np.ones((70, 80), bool)
    expected[5, 10] = expected[50, 25] = False
    assert np.array_equal(small.mask.numpy(), expected)


def test_compared_is_the_same_object_without_a_mask():
    image = torch.rand(3, 4, 5)
    assert compared(image, None) is image


# ---- a training on radiance ------------------------------------------------------------------------------


class Made(PictureCache):
    """Pictures by name, from memory."""

    def __init__(self, pictures):
        super().__init__()
        self.pictures = pictures

    def get(self, source):
        return self.pictures[source.key]


def radiance_scene(tiny_data, encoding=LOG):
    """The tiny scene's truth as training pictures, the view of index 0 with a mask."""
    from physhdr.backend.evaluate.truth import hdr_truth
    from physhdr.backend.scene import read_scene

    scene, pictures = read_scene(tiny_data), {}
    cache = Made(pictures)

    def made(view, split):
        radiance = hdr_truth(tiny_data, split, view.index).permute(1, 2, 0).double().numpy()
        source = PictureSource(view.image_paths[2], encoding=encoding)
        mask = np.ones(radiance.shape[:2], bool)
        mask[:5] = False
        codes = encoding.codes(radiance)
        pictures[source.key] = Decoded(codes, mask if view.index == 0 else None)
        return View(view.name, view.camera, (1.0,), (source,), view.index, cache=cache)

    train = [made(view, "train") for view in scene.train]
    test = [made(view, "test") for view in scene.test]
    points = Points(scene.points.positions, scene.points.colours)
    return Scene(tiny_data, "radiance", train, test, [], points)


def config_of(iterations):
    return dataclasses.replace(PRESETS["default"], iterations=iterations, training_exposures=(0,))


@pytest.mark.parametrize("encoding", [LOG, SRGB], ids=str)
def test_training_on_radiance_finds_it(tiny_data, tmp_path, encoding):
    """First points start at the merged radiance; loss falls; test views are compared in their own domain."""
    scene = radiance_scene(tiny_data, encoding)
    state = begin(scene, config_of(120))
    assert state.plan.seen.responses == "known"
    (before,) = pairs(state.method, scene.test[0])
    losses = [float(sum(step(state).values())) for _ in range(120)]
    (after,) = pairs(state.method, scene.test[0])
    assert np.mean(losses[-20:]) < 0.7 * np.mean(losses[:20])
    assert after.psnr() > before.psnr() + 2.0
    # Through a checkpoint and back, without the data.
    save(state, tmp_path)
    method, iteration = load_method(tmp_path, state.config, None)
    assert iteration == 120 and not method.learns_response
    camera = scene.test[0].camera
    assert torch.equal(method.ldr(camera, 1.0), state.method.ldr(camera, 1.0))
    resumed = resume(tmp_path, scene, config_of(120))
    assert resumed.method.size == state.method.size
    pictures = [PictureSource(v.image_paths[0], encoding=CAMERA) for v in scene.train]
    cameras = [dataclasses.replace(v, sources=(s,)) for v, s in zip(scene.train, pictures, strict=True)]
    with pytest.raises(DataMismatchError, match="other pictures"):
        resume(tmp_path, dataclasses.replace(scene, train=cameras), config_of(120))


@pytest.mark.parametrize("preset", ["baseline", "fast", "default-scaffold"])
def test_other_presets_train_on_radiance_too(tiny_data, preset):
    """On both backbones; what a preset says of anchors and warm starts has nothing to act on."""
    config = dataclasses.replace(PRESETS[preset], iterations=9, training_exposures=(0,))
    state = begin(radiance_scene(tiny_data), config)
    before = {name: tensor.clone() for name, tensor in state.method.backbone.parameters.items()}
    terms = [step(state) for _ in range(3)]
    assert "unit" not in terms[0] and all(np.isfinite(float(value)) for value in terms[-1].values())
    after = state.method.backbone.parameters
    assert any(not torch.equal(after[name], tensor) for name, tensor in before.items())
