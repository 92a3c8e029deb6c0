# SPDX-License-Identifier: GPL-3.0-or-later
"""Changed settings that a training does not read are named; those that it reads are not, and act."""

import dataclasses

import pytest
import torch

from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.backend.train.without_effect import changed_without_effect


def with_tone_mapper(config, **changes):
    tone_mapper = dataclasses.replace(config.method.tone_mapper, **changes)
    return dataclasses.replace(config, method=dataclasses.replace(config.method, tone_mapper=tone_mapper))


CHANGES = {
    "--set initial_opacity": lambda c: dataclasses.replace(c, initial_opacity=0.17),
    "--set initial_thickness": lambda c: dataclasses.replace(c, initial_thickness=0.71),
    "--set initial_size_limit": lambda c: dataclasses.replace(c, initial_size_limit=0.001),
    "--set backbone.threshold": lambda c: dataclasses.replace(
        c, backbone=dataclasses.replace(c.backbone, threshold=1.0)
    ),
    "--set backbone.budget": lambda c: dataclasses.replace(
        c, backbone=dataclasses.replace(c.backbone, budget=1)
    ),
    "--set optimiser.tone_mapper": lambda c: dataclasses.replace(
        c, optimiser=dataclasses.replace(c.optimiser, tone_mapper=1e-3)
    ),
    "--set optimiser.means_final": lambda c: dataclasses.replace(
        c, optimiser=dataclasses.replace(c.optimiser, means_final=1e-3)
    ),
    "--set optimiser.rates_for": lambda c: dataclasses.replace(
        c, optimiser=dataclasses.replace(c.optimiser, rates_for=2)
    ),
    "--set method.tone_mapper.initial_slope": lambda c: with_tone_mapper(c, initial_slope=0.9),
    "--set method.tone_mapper.initial_curve": lambda c: with_tone_mapper(c, initial_curve="line"),
    "--set supervision": lambda c: dataclasses.replace(
        c, supervision="one" if c.supervision == "bracket" else "bracket"
    ),
    "--set far_shell": lambda c: dataclasses.replace(c, far_shell="on"),
    "--set clear_cameras": lambda c: dataclasses.replace(c, clear_cameras="on"),
    "--set merged_brackets": lambda c: dataclasses.replace(c, merged_brackets="on"),
}
#: Brackets tell more than a slope; its points do not say what kind they are.
NOT_HERE = ("--set method.tone_mapper.initial_slope", "--set initial_size_limit", "--set initial_thickness")
#: What each preset reads and what it does not.
CASES = {
    # Nothing of this scene comes before a camera so soon: clear_cameras is read, and finds nothing.
    "default": (tuple(set(CHANGES) - {*NOT_HERE, "--set clear_cameras"}), NOT_HERE),
    "default-scaffold": (
        # In so few iterations no anchor is added: offsets are 0 at first, in cells that have one.
        ("--set optimiser.tone_mapper", "--set supervision", "--set far_shell", "--set merged_brackets"),
        (
            *("--set initial_opacity", "--set initial_thickness", "--set optimiser.means_final"),
            *("--set optimiser.rates_for", "--set clear_cameras"),
        ),
    ),
    "gausshdr-short": (
        ("--set backbone.budget",),
        ("--set optimiser.tone_mapper", "--set method.tone_mapper.initial_curve"),
    ),
    "hdr-gs": (("--set initial_opacity",), ("--set far_shell",)),
    "hdr-nerf-small": ((), ("--set supervision",)),
}


def trained(scene, config):
    """The trainer, and all parameters after a short training in one vector."""
    state = begin(scene, config, "cpu")
    for _ in range(config.iterations):
        step(state)
    groups = state.method.parameter_groups()
    return state, torch.cat([p.detach().flatten() for group in groups.values() for p in group])


@pytest.mark.parametrize(
    "preset",
    [pytest.param(name, marks=[pytest.mark.long] * (name == "default-scaffold")) for name in CASES],
)
def test_what_is_not_read_is_named_and_changes_nothing(preset, tiny_data):
    scene = read_scene(tiny_data)
    whole = PRESETS[preset]
    start = {"start": 1} if whole.backbone.name == "gaussians" else {}
    growth = dataclasses.replace(whole.backbone, every=2, stop=0.9, **start)
    base = dataclasses.replace(whole, iterations=4, initial_points="file", backbone=growth)
    _, expected = trained(scene, base)
    read, unread = CASES[preset]
    for option in (*read, *unread):
        state, parameters = trained(scene, CHANGES[option](base))
        assert changed_without_effect(state, base) == ([option] if option in unread else [])
        same = parameters.shape == expected.shape and torch.equal(parameters, expected)
        assert same == (option in unread), option


def test_merged_brackets_are_named_where_training_sees_one_exposure_of_each_view(tiny_data):
    scene = read_scene(tiny_data)
    preset = dataclasses.replace(PRESETS["default"], initial_points="file")
    for mode, unread in (("exp3", []), ("exp1", ["--set merged_brackets"])):
        base = dataclasses.replace(preset, exposure_mode=mode)
        state = begin(scene, dataclasses.replace(base, merged_brackets="on"))
        assert changed_without_effect(state, base) == unread
        assert ("brackets merged" in state.start_message) == (not unread)


def test_networks_read_none_of_what_starts_splats_and_make_no_tables_of_brackets(tiny_data):
    scene = read_scene(tiny_data)
    whole = PRESETS["hdr-nerf-small"]
    method = dataclasses.replace(whole.method, warm_start_steps=1)
    base = dataclasses.replace(whole, iterations=2, initial_points="file", method=method)
    _, expected = trained(scene, base)
    changed = dataclasses.replace(base, far_shell="on", clear_cameras="on", merged_brackets="on")
    state, parameters = trained(scene, changed)
    unread = ["--set far_shell", "--set merged_brackets", "--set clear_cameras"]
    assert changed_without_effect(state, base) == unread and torch.equal(parameters, expected)
    assert state.data.merged is None
