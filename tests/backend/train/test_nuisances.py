# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned of each photo: where it applies, its gauge, and that it stays out of renders' trainings."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.methods.base import Recording
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.half_size import half_sized
from physhdr.backend.train.nuisances import Nuisances, telling_share
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError, FileDamagedError


def short(preset="default", mode="on", iterations=24):
    config = PRESETS[preset]
    density = dataclasses.replace(config.backbone, start=5, every=10, stop=0.8, threshold=1e-5)
    return dataclasses.replace(config, iterations=iterations, backbone=density, nuisances=mode)


def fresh(scene, exposures=(0, 2, 4)):
    return Nuisances(scene.train, [exposures] * len(scene.train), torch.device("cpu"))


def grey(camera, value=0.5):
    return Recording(exposure=1.0, picture=torch.full((3, camera.height, camera.width), value))


def test_an_effect_is_gain_balance_and_the_lens_at_each_pixel(tiny_data):
    scene = read_scene(tiny_data)
    nuisances, view = fresh(scene), scene.train[1]
    photo, place = 3 + 2, 1  # of three photos a view
    with torch.no_grad():
        nuisances.values["log_gain"][photo] = 0.3
        nuisances.values["log_balance"][place] = torch.tensor([0.1, -0.2])
        nuisances.values["vignetting"][0] = torch.tensor([0.2, 0.3, 0.1])
    camera = view.camera
    (recording,) = nuisances.applied(view, (4,), camera, [grey(camera)])
    corner = math.hypot(camera.width, camera.height) / 2
    for row, column in ((0, 0), (camera.height // 2, camera.width // 2), (3, camera.width - 1)):
        x, y = column + 0.5 - camera.width / 2, row + 0.5 - camera.height / 2
        rho = (x * x + y * y) / corner**2
        lens = math.exp(-(0.2 * math.log1p(rho) + 0.3 * rho + 0.1 * rho**3))
        wanted = [lens * math.exp(0.3 + balance) for balance in (0.1, 0.0, -0.2)]
        assert recording.effect[:, row, column].tolist() == pytest.approx(wanted, rel=1e-5)


def test_a_smaller_view_and_a_crop_have_the_effect_of_the_same_rays(tiny_data):
    scene = read_scene(tiny_data)
    nuisances, view = fresh(scene), scene.train[0]
    with torch.no_grad():
        nuisances.values["vignetting"][0] = torch.tensor([0.4, 0.2, 0.3])
    whole = view.camera.resized(128)
    (full,) = nuisances.applied(view, (0,), whole, [grey(whole)])
    half = half_sized(whole)
    (small,) = nuisances.applied(view, (0,), half, [grey(half)])
    mean = torch.nn.functional.avg_pool2d(full.effect[None], 2)[0]
    assert (small.effect - mean).abs().max() < 2e-4
    crop = Camera(whole.camera_to_world, 60, 50, whole.fx, whole.fy, whole.cx - 30, whole.cy - 7)
    (cut,) = nuisances.applied(view, (0,), crop, [grey(crop)])
    assert torch.allclose(cut.effect, full.effect[:, 7:57, 30:90], rtol=1e-6)


def test_what_is_stated_is_right_on_the_whole(tiny_data):
    """After every step: no mean and no slope of the gains, no mean of the balances, a lens that falls."""
    scene = read_scene(tiny_data)
    nuisances = fresh(scene)
    generator = torch.Generator().manual_seed(0)
    for iteration, view in enumerate([*scene.train, *scene.train]):
        recordings = [grey(view.camera, value) for value in (0.2, 0.5, 0.999)]
        effects = [r.effect for r in nuisances.applied(view, (0, 2, 4), view.camera, recordings)]
        weight = torch.rand(3, generator=generator) * 9 - 2
        colours = torch.stack([effect.mean(dim=(1, 2)) for effect in effects]) @ torch.tensor(
            [2.0, 1.0, -1.0]
        )
        (weight @ colours).backward()
        nuisances.learn(0.5 + iteration / 100)
    gain = nuisances.values["log_gain"].detach().double()
    time = torch.tensor([math.log(view.exposures[k]) for view in scene.train for k in (0, 2, 4)]).double()
    tells = torch.tensor([1.0, 1.0, 0.0] * len(scene.train)).double()  # the third photos are all but white
    assert gain.abs().max() > 1e-3
    assert abs(tells @ gain) < 1e-6 and abs((tells * gain) @ (time - tells @ time / tells.sum())) < 1e-6
    assert nuisances.values["log_balance"].mean(dim=0).abs().max() < 1e-7
    assert nuisances.values["vignetting"].min() >= 0.0


def test_balances_do_not_follow_the_exposure_where_places_differ(tiny_data):
    """Else red's and blue's response could be as steep as it likes. What else they are stays."""
    views = read_scene(tiny_data).train
    nuisances = Nuisances(views, [(0,), (2,), (4,)], torch.device("cpu"))
    time = torch.tensor([math.log(view.exposures[k]) for view, k in zip(views, (0, 2, 4), strict=True)])
    basis = torch.stack([torch.ones(3), time], dim=1)
    before = torch.tensor([[0.3, -0.1], [-0.2, 0.1], [0.5, 0.2]])
    with torch.no_grad():
        nuisances.telling.fill_(0.5)
        nuisances.values["log_balance"].copy_(before)
    nuisances.project()
    after = nuisances.values["log_balance"].detach()
    assert (basis.T @ after).abs().max() < 1e-5
    removed = before - after
    assert (removed - basis @ torch.linalg.lstsq(basis, removed).solution).abs().max() < 1e-5
    assert after.abs().max() > 0.01


def test_gains_that_points_told_stay_while_few_photos_were_seen(tiny_data):
    """They are in the gauge. Of the two photos seen first, 4 stops apart, they have a slope."""
    scene = read_scene(tiny_data)
    nuisances = fresh(scene)
    time = nuisances.log_exposure
    told = torch.randn(len(time), generator=torch.Generator().manual_seed(0)).double() * 0.2
    basis = torch.stack([torch.ones_like(time), time], dim=1)
    told -= basis @ torch.linalg.lstsq(basis, told[:, None]).solution[:, 0]
    with torch.no_grad():
        nuisances.values["log_gain"].copy_(told)
    for view, k in ((scene.train[0], 0), (scene.train[1], 2)):
        nuisances.applied(view, (k,), view.camera, [grey(view.camera)])
        nuisances.learn(0.0)
        assert torch.allclose(nuisances.values["log_gain"].detach().double(), told, atol=1e-6)
    assert told.abs().max() > 0.1


def test_only_values_that_are_compared_and_neither_black_nor_white_tell_of_the_light():
    picture = torch.tensor([0.0, 0.5, 0.5, 1.0]).expand(3, 1, 4)
    assert telling_share(Recording(exposure=1.0, picture=picture)) == 0.5
    mask = torch.tensor([[False, True, True, True]])
    assert telling_share(Recording(exposure=1.0, picture=picture, mask=mask)) == pytest.approx(2 / 3)


def test_a_resumed_training_is_bit_identical(tiny_data, whole_and_in_parts):
    whole, parts = whole_and_in_parts(read_scene(tiny_data), short(), (7,))
    assert whole.keys() == parts.keys() and any(name.startswith("nuisances.") for name in whole)
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def test_renders_are_trained_without_and_photographs_with(tiny_data):
    scene = read_scene(tiny_data)
    auto = short(mode="auto")
    assert not scene.photographs and begin(scene, auto).part(Nuisances) is None
    photographs = dataclasses.replace(scene, info={}, response_anchor=None)
    assert photographs.photographs and begin(photographs, auto).part(Nuisances) is not None
    assert begin(photographs, short(mode="off")).part(Nuisances) is None


def test_a_checkpoint_that_lacks_a_part_is_refused(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short()
    state = begin(scene, config)
    step(state)
    state.part(Nuisances).values.pop("log_balance")
    save(state, tmp_path)
    with pytest.raises(FileDamagedError, match=r"it has no nuisances\.log_balance"):
        resume(tmp_path, scene, config)


def test_methods_that_know_no_effects_refuse_it(tiny_data):
    with pytest.raises(BadValueError, match="gausshdr does not model a photo's gain"):
        begin(read_scene(tiny_data), short("gausshdr"))


def test_what_was_learned_is_left_out_when_drawing(tiny_data):
    scene = read_scene(tiny_data)
    state = begin(scene, short())
    step(state)
    before = state.method.ldr(scene.test[0].camera, 1.0)
    with torch.no_grad():
        for value in state.part(Nuisances).values.values():
            value += 0.5
    assert torch.equal(state.method.ldr(scene.test[0].camera, 1.0), before)
    assert np.isfinite(before.numpy()).all()
