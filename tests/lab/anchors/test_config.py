# SPDX-License-Identifier: GPL-3.0-or-later
"""What anchors mean for a training's schedule and size."""

import dataclasses

from physhdr.backend.train.config import in_iterations
from physhdr.backend.train.forecast.size import Extent, found_sizes
from physhdr.backend.train.presets import PRESETS
from physhdr.lab.anchors.config import AnchorsConfig


def test_of_a_stretched_schedule_only_the_interval_of_growth_is_a_number_of_iterations():
    scaffold = dataclasses.replace(PRESETS["paper-scaffold"], iterations=1000, schedule_for=30_000)
    there = in_iterations(scaffold)
    assert there.backbone == dataclasses.replace(scaffold.backbone, every=3)
    assert in_iterations(dataclasses.replace(scaffold, iterations=10)).backbone.every == 1


def test_growth_begins_and_ends_at_scaffold_gs_s_shares_of_its_30_000_iterations():
    assert AnchorsConfig().growing(30_000) == (1500, 15_000)
    assert AnchorsConfig().growing(600) == (30, 300)


def test_larger_pictures_get_a_larger_budget_and_more_points_do_not():
    preset = PRESETS["default-scaffold"]
    small = Extent(pixels=200 * 200, views=18, points=20_000, exposures=())
    large = dataclasses.replace(small, pixels=1600 * 1600)
    many = dataclasses.replace(small, points=1_000_000)
    assert found_sizes(large, preset).backbone.budget > preset.backbone.budget
    assert found_sizes(many, preset) == found_sizes(small, preset) == preset
