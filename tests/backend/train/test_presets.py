# SPDX-License-Identifier: GPL-3.0-or-later
"""The presets that people are offered are those that can be trained."""

from physhdr.backend.train.presets import PRESETS
from physhdr.bridge import presets


def test_every_preset_that_is_offered_can_be_trained_and_the_other_way_round():
    assert presets.PRESETS.keys() == PRESETS.keys()


def test_a_preset_is_said_to_make_splats_if_its_method_does():
    makes = {name: config.method.traits.splats for name, config in PRESETS.items()}
    assert {name: preset.splats for name, preset in presets.PRESETS.items()} == makes
    assert not all(makes.values()) and all(preset.splats for preset in presets.IN_PANEL)


def test_each_is_listed_once_and_described_in_a_line():
    listed = [*presets.IN_PANEL, *presets.FOR_COMPARISONS]
    assert len(listed) == len(presets.PRESETS) == len({preset.label for preset in listed})
    assert all(preset.description and not preset.description.endswith(".") for preset in listed)


def test_the_usual_ones_come_first_by_the_effort_that_they_are():
    usual = [PRESETS[preset.name].iterations for preset in presets.USUAL]
    assert usual == sorted(usual) and presets.IN_PANEL[: len(usual)] == presets.USUAL
