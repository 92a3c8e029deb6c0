# SPDX-License-Identifier: GPL-3.0-or-later
"""HDR-GS: its forward pass in NumPy, what growth sees, its first radiance, and HDR supervision's fences."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.report import to_markdown
from physhdr.backend.kernels import ssim_map_reference
from physhdr.backend.methods.base import Batch, MethodSetup, Recording
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.model.tone_mapper import ToneMapperConfig
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.pictures import write_exr
from physhdr.backend.train.begin import begin
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.config import read_config, write_config
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import run, step
from physhdr.bridge.data_set import truth_file
from physhdr.bridge.errors import BadValueError, FileMissingError
from physhdr.bridge.run_folder import CHECKPOINT_FILE
from physhdr.lab.peers.hdr_gs import HDRGS, HDRGSConfig, compressed, compressed_truth

EXPOSURE = 2.0


@pytest.fixture
def camera():
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_field_of_view(pose, 24, 20, 0.8)


def make(implementation="cpu", **changes) -> HDRGS:
    """A method of 30 Gaussians of which nothing is where it started."""
    config = dataclasses.replace(PRESETS["hdr-gs"].method, **changes)
    rng = np.random.default_rng(5)
    gaussians = initial_gaussians(
        rng.uniform(-0.6, 0.6, (30, 3)),
        rng.uniform(-1.5, 0.5, (30, 3)),
        sh_degree=3,
        opacity=0.6,
        ambient_share=None,
        context_size=0,
        seed=0,
    )
    torch.manual_seed(2)
    method = HDRGS(config, gaussians, MethodSetup(implementation=implementation))
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for name, tensor in [*method.named_parameters(), *gaussians.parameters.items()]:
            if name not in ("means", "log_illumination"):
                tensor += 0.3 * torch.randn(tensor.shape, generator=generator)
    return method


def batch_of(camera, exposures=(EXPOSURE,), index=0):
    pictures = tuple(torch.rand(3, 20, 24, generator=torch.Generator().manual_seed(1)) for _ in exposures)
    recordings = tuple(
        Recording(exposure=exposure, picture=picture)
        for exposure, picture in zip(exposures, pictures, strict=True)
    )
    return Batch(camera, recordings, (1.0,), 0, pool=None, index=index)


def by_hand(method, camera):
    """LDR and HDR pictures by the description, in NumPy and by the reference rasteriser in float64."""
    splats, mapper = method.backbone.splats(camera, 3), method.tone_mapper
    log_radiance = splats.log_reflectance.detach().double().numpy()
    colours = []
    for c in range(3):
        w1, b1, w2 = (getattr(mapper, name)[c].detach().double().numpy() for name in ("w1", "b1", "w2"))
        hidden = np.maximum(np.outer(w1, log_radiance[:, c] + math.log(EXPOSURE)) + b1[:, None], 0.0)
        colours.append(1.0 / (1.0 + np.exp(-(w2 @ hidden + mapper.b2[c].item()))))
    geometry = (splats.means, splats.quaternions, splats.scales, splats.opacities)
    geometry = [g.detach().double() for g in geometry]
    ldr = rasterize(*geometry, torch.tensor(np.array(colours).T), camera).image
    return ldr, rasterize(*geometry, torch.tensor(np.exp(log_radiance)), camera).image


def test_the_forward_pass_is_as_described(camera):
    """A response per splat, 1 → 128 → 1 with ReLU for each channel; then drawn."""
    method = make()
    assert method.tone_mapper.w1.shape == (3, 128)
    ldr, hdr = by_hand(method, camera)
    assert (method.ldr(camera, EXPOSURE) - ldr).abs().max() < 1e-4
    assert (method.hdr(camera) - hdr).abs().max() < 1e-4 * hdr.max()
    outcome = method.training_outcome(batch_of(camera))
    assert torch.allclose(outcome.drawn.rasterization.image.double(), ldr, atol=1e-4)
    picture = batch_of(camera).recordings[0].picture.double()
    expected = 0.8 * (ldr - picture).abs().mean() + 0.2 * (1.0 - ssim_map_reference(ldr, picture).mean())
    assert outcome.terms["rec"].item() == pytest.approx(expected.item(), rel=1e-4)
    assert set(outcome.terms) == {"rec"}  # no unit exposure: their code has it switched off


def test_a_level_scales_as_an_exposure(camera):
    method = make()
    assert torch.allclose(method.ldr(camera, 2.0, 3.0), method.ldr(camera, 6.0), atol=1e-6)
    assert torch.allclose(method.hdr(camera, 3.0), 3.0 * method.hdr(camera), rtol=1e-5)
    shown, black = method.preview_ldr(method.preview(camera, 3.0), camera, 2.0, 3.0)
    assert torch.equal(shown, method.ldr(camera, 2.0, 3.0)) and not black.any()


def test_a_bracket_is_the_mean_of_its_pictures(camera):
    method = make()
    each = [method.training_outcome(batch_of(camera, (t,))).terms["rec"] for t in (0.5, 2.0, 8.0)]
    whole = method.training_outcome(batch_of(camera, (0.5, 2.0, 8.0))).terms["rec"]
    assert whole.item() == pytest.approx(torch.stack(each).mean().item(), rel=1e-6)


def test_the_tone_mapper_learns_at_a_constant_rate():
    rate = make().rates()["tone_mapper"]
    assert rate.at(0.0, 7.0) == rate.at(1.0, 7.0) == 5e-4


# ---- where it starts ---------------------------------------------------------------------------------------


def begun(scene, **changes):
    preset = PRESETS["hdr-gs"]
    method = dataclasses.replace(preset.method, **{k: v for k, v in changes.items() if k != "initial_points"})
    source = changes.get("initial_points", "auto")
    return begin(scene, dataclasses.replace(preset, method=method, initial_points=source)).method


def first_radiance(method):
    """ln e of each Gaussian at the start, ``[P, 3]``, and where it is."""
    return (method.gaussians.reflectance_dc[:, 0] * 0.28209479177387814).detach(), method.gaussians.means


def test_points_start_with_their_colour_as_their_logarithm(tiny_data):
    scene = read_scene(tiny_data)
    log_radiance, means = first_radiance(begun(scene))
    nearest = torch.cdist(means.detach(), torch.from_numpy(scene.points.positions)).argmin(1)
    assert torch.allclose(log_radiance, torch.from_numpy(scene.points.colours)[nearest], atol=1e-5)


def test_merged_radiance_does_not_come_of_the_random_response(tiny_data):
    """Radiance merged from the brackets is right in its order of brightness, whatever f says at random."""
    scene = read_scene(tiny_data)
    log_radiance, means = first_radiance(begun(scene, initial_radiance="merged"))
    nearest = torch.cdist(means.detach(), torch.from_numpy(scene.points.positions)).argmin(1)
    code = torch.from_numpy(scene.points.colours)[nearest].double().clamp(0.01, 0.99) ** 2.2
    truth = (code / (1.0 - code) / 2.0).log()  # the inverse of the data's response at 2 s
    correlation = np.corrcoef(log_radiance.reshape(-1).numpy(), truth.reshape(-1).numpy())[0, 1]
    assert correlation > 0.5
    # Random points have no colours, so theirs is merged, too.
    random, _ = first_radiance(begun(scene, initial_points="random"))
    assert random.std() > 0.1 and (random < 0).any()


# ---- HDR supervision ---------------------------------------------------------------------------------------


def test_hdr_supervision_must_be_asked_for_twice(tmp_path):
    for half in ({"hdr_supervision": True}, {"hdr_truth": str(tmp_path)}):
        with pytest.raises(BadValueError, match="asked for twice"):
            HDRGSConfig(**half)
    assert not any(getattr(preset.method, "hdr_supervision", False) for preset in PRESETS.values())
    method = HDRGSConfig(hdr_supervision=True, hdr_truth=str(tmp_path))
    with pytest.raises(BadValueError, match=r"half their size[\s\S]*--set half_size_until=0"):
        dataclasses.replace(PRESETS["hdr-gs-short"], method=method)  # of which no truth is known
    with pytest.raises(BadValueError, match="global curve"):
        HDRGSConfig(tone_mapper=ToneMapperConfig(local=True))


def test_the_compression_of_the_hdr_loss():
    picture = torch.tensor([[[0.0, 0.5, 4.0]]]).expand(3, 1, 3)
    expected = [0.0, math.log(1 + 5000 * 0.125) / math.log(5001), 1.0]
    assert torch.allclose(compressed(picture)[0, 0], torch.tensor(expected), atol=1e-6)


def test_growth_sees_the_ldr_pass_alone(camera, tmp_path):
    rng = np.random.default_rng(0)
    write_exr(tmp_path / "hdr_003.exr", rng.uniform(0, 5, (40, 48, 3)).astype(np.float32))
    plain, supervised = make(), make(hdr_supervision=True, hdr_truth=str(tmp_path))
    gradients = []
    for method in (plain, supervised):
        outcome = method.training_outcome(batch_of(camera, index=3))
        torch.stack(list(outcome.terms.values())).sum().backward()
        gradients.append((outcome.drawn.screen_offsets.grad, method.gaussians.means.grad))
    assert torch.equal(gradients[0][0], gradients[1][0]) and gradients[0][0].any()
    assert not torch.allclose(gradients[0][1], gradients[1][1], rtol=0.01)  # though the Gaussians do learn it
    truth = compressed_truth(tmp_path, 3, 20, 24)
    hdr = by_hand(supervised, camera)[1]
    prediction = torch.log1p(5000 * hdr / hdr.max()) / math.log(5001)
    expected = 0.8 * (prediction - truth).abs().mean()
    expected += 0.2 * (1.0 - ssim_map_reference(prediction, truth.double()).mean())
    assert outcome.terms["hdr"].item() == pytest.approx(0.6 * expected.item(), rel=1e-3)
    with pytest.raises(FileMissingError, match=r"hdr_004\.exr"):
        supervised.training_outcome(batch_of(camera, index=4))


def test_hdr_supervision_is_said_aloud_and_written_down(tiny_data, tmp_path):
    """At every start, in the configuration and in every report; and it changes what is learned."""
    scene, preset = read_scene(tiny_data), PRESETS["hdr-gs"]
    plain = dataclasses.replace(preset, iterations=10)
    method = dataclasses.replace(preset.method, hdr_supervision=True, hdr_truth=str(tiny_data / "train_hdr"))
    supervised = dataclasses.replace(plain, method=method)
    weights = []
    for name, config in (("plain", plain), ("supervised", supervised)):
        (tmp_path / name).mkdir()
        if config is plain:
            state = begin(scene, config)
        else:
            with pytest.warns(UserWarning, match="Trained with HDR ground truth"):
                state = begin(scene, config)
        for _ in run(state, tmp_path / name):
            pass
        weights.append(load_checkpoint(tmp_path / name / CHECKPOINT_FILE)[0]["gaussians.means"])
        said = "Trained with HDR ground truth" in to_markdown(evaluate(state.method, scene))
        assert said == (config is supervised)
    assert not torch.equal(*weights)
    write_config(tmp_path / "config.json", supervised, tiny_data, "hdr-gs")
    assert read_config(tmp_path / "config.json")[0] == supervised


def test_a_view_whose_pose_is_learned_keeps_its_true_picture(tiny_data, tmp_path):
    """The true picture is that of the view, though its camera is a moved one."""
    scene, preset = read_scene(tiny_data), PRESETS["hdr-gs"]
    view = scene.train[-1]
    (tmp_path / truth_file(view.index)).write_bytes(
        (tiny_data / "train_hdr" / truth_file(view.index)).read_bytes()
    )
    method = dataclasses.replace(preset.method, hdr_supervision=True, hdr_truth=str(tmp_path))
    config = dataclasses.replace(preset, method=method, poses="on", iterations=4)
    with pytest.warns(UserWarning, match="Trained with HDR ground truth"):
        state = begin(dataclasses.replace(scene, train=[view]), config)
    assert all(math.isfinite(step(state)["hdr"].item()) for _ in range(2))


@pytest.mark.long
def test_it_learns_the_tiny_scene(tiny_data, tmp_path):
    scene = read_scene(tiny_data)
    config = PRESETS["hdr-gs-short"]
    config = dataclasses.replace(
        config,
        iterations=400,
        sh_degree_every=1000,
        backbone=dataclasses.replace(config.backbone, stop=0.0),
        # The literal start; at their published rate the networks would learn little of the response in so few
        # iterations.
        method=PRESETS["hdr-gs"].method,
        optimiser=dataclasses.replace(config.optimiser, networks_times=10.0),
    )
    state = begin(scene, config)
    before = evaluate(state.method, scene)
    for _ in run(state, tmp_path):
        pass
    after = evaluate(state.method, scene)
    assert after.ldr_oe.psnr > max(24.0, before.ldr_oe.psnr + 3.0), before.ldr_oe
    assert after.hdr_aligned_mean.psnr > after.hdr_mean.psnr - 0.5
