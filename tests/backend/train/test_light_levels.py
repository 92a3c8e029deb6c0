# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels that nobody measured: their gradient, what is found, resuming, and groups under wrong words."""

import dataclasses

import numpy as np
import pytest
import torch

from physhdr.backend.kernels.activations import lit_colours, lit_colours_reference
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.light_levels import LightLevels, level_gradient, with_levels
from physhdr.backend.train.nuisances import Nuisances
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step


def of_group(views, name, levels):
    return [dataclasses.replace(view, group=name, lighting_levels=levels) for view in views]


@pytest.fixture
def one_unknown(tiny_data):
    """The tiny scene whose two lit views, at ¼ and 4, are groups; the level of the first is unknown."""
    scene = read_scene(tiny_data)
    dark, bright = scene.lit
    assert (dark.lighting_levels, bright.lighting_levels) == ((0.25,), (4.0,))
    lit = of_group([dark], "evening", (None,)) + of_group([bright], "noon", (4.0,))
    return dataclasses.replace(scene, lit=lit)


def short(iterations, **changes):
    return dataclasses.replace(PRESETS["default"], iterations=iterations, **changes)


def test_the_gradient_of_a_level_is_that_of_the_modulated_light():
    """Against autograd of the plain twin, float64; by the fused kernel's own gradient, float32."""
    rng = np.random.default_rng(0)
    logits, target = rng.normal(size=(40, 3, 3)), torch.tensor(rng.uniform(size=(40, 3)))
    share = torch.tensor(np.exp(logits) / (1.0 + np.exp(logits).sum(1, keepdims=True)))
    reflectance, illumination = torch.tensor(rng.normal(size=(40, 3))), torch.tensor(rng.normal(size=(40, 1)))
    at = (0.3, 1.0, 2.5)
    levels = [torch.tensor(level, dtype=torch.float64, requires_grad=True) for level in at]
    (lit_colours_reference(reflectance, illumination, share, levels)[0] - target).square().sum().backward()
    wanted = [float(level.grad) for level in levels if level.grad is not None]
    reflectance = reflectance.float().requires_grad_()
    colours, _ = lit_colours(reflectance, illumination.float(), share.float(), at)
    (colours - target.float()).square().sum().backward()
    assert level_gradient(reflectance.grad, share.float(), at).tolist() == pytest.approx(wanted, rel=1e-4)


def test_a_level_is_found_where_another_group_tells_the_shares(one_unknown):
    state = begin(one_unknown, short(300, sh_degree_every=1000))
    part = state.part(LightLevels)
    assert part.levels.keys() == {("evening", 0)}
    assert 0.1 < part.levels["evening", 0] < 0.5  # where points put it
    for _ in range(300):
        step(state)
    assert part.levels["evening", 0] == pytest.approx(0.25, rel=0.1)
    assert part.summary.startswith("ambient in 'evening' is at 0.2") and "(measured)" in part.summary
    (seen,) = with_levels(one_unknown.lit[:1], part.levels)
    assert seen.known_levels == (part.levels["evening", 0],)


def test_resuming_goes_on_with_the_level(one_unknown, whole_and_in_parts):
    whole, parts = whole_and_in_parts(one_unknown, short(24), (5, 13))
    assert whole.keys() == parts.keys() and "light_levels.log_level" in whole
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    assert whole["light_levels.step"].item() > 0


def test_trainings_without_groups_have_no_such_part(tiny_data):
    assert begin(read_scene(tiny_data), short(4)).part(LightLevels) is None


@pytest.mark.parametrize(
    ("levels", "which", "note"),
    [
        ((0.0,), "lit", ""),
        ((0.0,), "train", "as bright as elsewhere: nobody saw this light change"),
        ((2.0,), "lit", "darker than elsewhere"),
    ],
)
def test_a_group_under_wrong_words_is_noticed(tiny_data, levels, which, note):
    """The view at ¼ is said to be off, which it may be, or turned up; a usual one is said to be off."""
    scene = read_scene(tiny_data)
    views = {"lit": scene.lit[:1], "train": scene.train[:1]}[which]
    scene = dataclasses.replace(scene, lit=of_group(views, "pendant off", levels), train=scene.train[1:])
    state = begin(scene, short(4, initial_points="auto"))
    part = state.part(LightLevels)
    assert part is not None and (note in "".join(part.notes) if note else not part.notes)
    assert not note or (note in state.start_message and note in part.summary)


def test_wrong_words_are_noticed_at_the_end_of_a_resumed_training(tiny_data, tmp_path):
    """By the trained points and the learned response: the message of the beginning is long gone."""
    scene = read_scene(tiny_data)
    lit = of_group(scene.lit[:1], "pendant on", (2.0,))  # it is at ¼
    scene = dataclasses.replace(scene, lit=lit)
    config = short(4, initial_points="auto")
    state = begin(scene, config)
    step(state)
    save(state, tmp_path)
    resumed = resume(tmp_path, scene, config)
    part = resumed.part(LightLevels)
    assert not part.notes
    while resumed.iteration < 4:
        step(resumed)
    assert "darker than elsewhere" in part.summary


def test_gains_of_a_group_are_not_its_light(tiny_data):
    scene = read_scene(tiny_data)
    views = scene.train + of_group(scene.lit, "evening", (0.5,))
    nuisances = Nuisances(views, [(0, 2, 4)] * len(views), torch.device("cpu"))
    with torch.no_grad():
        nuisances.values["log_gain"].copy_(torch.arange(float(3 * len(views))))
        nuisances.values["log_balance"].copy_(torch.arange(2.0 * len(views)).reshape(-1, 2))
        nuisances.telling.fill_(0.5)
    nuisances.project()
    mine = 3 * len(scene.lit)
    for rows in (slice(None, -mine), slice(-mine, None)):
        assert nuisances.values["log_gain"][rows].mean().item() == pytest.approx(0.0, abs=1e-5)
    for rows in (slice(None, -len(scene.lit)), slice(-len(scene.lit), None)):
        assert nuisances.values["log_balance"][rows].mean().item() == pytest.approx(0.0, abs=1e-5)
