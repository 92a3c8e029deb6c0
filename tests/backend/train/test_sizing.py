# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes follow from the data by the rule in docs/performance.md; what is typed wins; renders stay."""

import dataclasses
import re
from pathlib import Path

import pytest

from physhdr.backend.scene import read_scene
from physhdr.backend.train.forecast.size import Extent, extent_of, found_sizes, sizes_in_words
from physhdr.backend.train.presets import PRESETS
from physhdr.bridge.data_set import CAPTURE_FILE
from physhdr.tests.backend.scene import layouts

DOCS = Path(__file__).parents[3] / "docs" / "performance.md"
RENDERS = Extent(pixels=200 * 200, views=30, points=17_599, exposures=())
LARGE = dataclasses.replace(RENDERS, pixels=1600 * 1067, views=50, points=0)


def documented() -> list[tuple[str, ...]]:
    """The rows of docs/performance.md's table: width, height, views, points, and what ``default`` gets."""
    row = re.compile(r"\| (\d+)×(\d+) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \| (\d+) % \|")
    return [tuple(cell.replace(",", "") for cell in row.groups()) for row in row.finditer(DOCS.read_text())]


def test_the_table_of_the_documentation_spans_what_is_promised():
    widths, views = {int(row[0]) for row in documented()}, {int(row[2]) for row in documented()}
    assert {min(widths), max(widths)} == {200, 1600} and {min(views), max(views)} == {18, 200}


@pytest.mark.parametrize("row", documented(), ids="-".join)
def test_the_rule_is_the_table_of_the_documentation(row):
    width, height, views, points, budget, iterations, half = map(int, row)
    extent = dataclasses.replace(RENDERS, pixels=width * height, views=views, points=points)
    found = found_sizes(extent, PRESETS["default"])
    assert (found.backbone.budget, found.iterations) == (budget, iterations)
    assert round(100 * found.half_size_until) == half


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("pixels", "views"), [(200 * 200, 18), (200 * 200, 62), (32 * 24, 3)])
def test_of_our_renders_at_200_pixels_every_preset_stays_what_it_is(preset, pixels, views):
    extent = dataclasses.replace(RENDERS, pixels=pixels, views=views)
    assert found_sizes(extent, PRESETS[preset]) == PRESETS[preset]
    assert sizes_in_words(extent, PRESETS[preset], PRESETS[preset]) == ""


def test_what_is_typed_stays_also_where_it_is_the_preset_s_own():
    preset = PRESETS["default"]
    found = found_sizes(LARGE, preset, ("iterations", "backbone.budget"))
    assert (found.iterations, found.backbone.budget) == (2500, 60_000)
    assert found.sh_degree_every == preset.sh_degree_every  # of as many iterations
    assert found.half_size_until > preset.half_size_until  # nobody has said anything of it


@pytest.mark.parametrize("preset", ["default", "high"])
def test_rates_are_for_the_length_that_the_data_call_for(preset):
    """They fall in a training that is longer than that: by as much on large pictures as on small ones."""
    own = PRESETS[preset]
    found = found_sizes(LARGE, own)
    assert found.iterations > own.iterations
    assert found.optimiser.rates_for == found_sizes(LARGE, PRESETS["default"]).iterations
    for iterations in (1, 90_000):
        typed = found_sizes(LARGE, dataclasses.replace(own, iterations=iterations), ["iterations"])
        assert (typed.iterations, typed.optimiser) == (iterations, found.optimiser)


@pytest.mark.parametrize("preset", ["paper", "gausshdr", "gausshdr-scaffold", "hdr-gs", "hdr-nerf"])
def test_published_schedules_stay_as_published(preset):
    assert found_sizes(LARGE, PRESETS[preset]) == PRESETS[preset]


def test_of_photographs_training_sees_every_exposure():
    photographs = dataclasses.replace(RENDERS, exposures=(0, 1, 2))
    assert found_sizes(photographs, PRESETS["paper"]).training_exposures == (0, 1, 2)
    typed = found_sizes(photographs, PRESETS["default"], ("training_exposures",))
    assert typed.training_exposures == (0, 2, 4)
    assert "all 3 exposures" in sizes_in_words(
        photographs, PRESETS["default"], found_sizes(photographs, typed)
    )


def test_points_of_the_data_set_have_room():
    found = found_sizes(dataclasses.replace(RENDERS, points=100_000), PRESETS["default"])
    assert found.backbone.budget == 150_000 and found.iterations == PRESETS["default"].iterations


def test_larger_data_never_get_less():
    """Twice the pixels, views or points, in any order."""
    sizes = [
        dataclasses.replace(RENDERS, pixels=20_000 * 2**i, views=18 * 2**j, points=20_000 * 2**k)
        for i in range(8)
        for j in range(5)
        for k in range(4)
    ]
    found = {extent: found_sizes(extent, PRESETS["default"]) for extent in sizes}
    for less in sizes:
        for more in sizes:
            if less.pixels <= more.pixels and less.views <= more.views and less.points <= more.points:
                assert found[less].backbone.budget <= found[more].backbone.budget
                assert found[less].iterations <= found[more].iterations
                assert found[less].half_size_until <= found[more].half_size_until


def test_an_extent_is_what_training_sees(tiny_data):
    scene = read_scene(tiny_data)
    every, reduced = (extent_of(each, PRESETS["default"]) for each in (scene, read_scene(tiny_data, 2.0)))
    camera = scene.train[0].camera
    assert every.pixels == camera.width * camera.height and reduced.pixels == every.pixels // 4
    assert every.views == len(scene.train) + len(scene.lit)
    assert extent_of(scene, PRESETS["baseline"]).views == len(scene.train)  # it cannot use the lit ones
    assert every.exposures == ()


def test_exposures_that_a_published_benchmark_measures_are_not_trained_on(tmp_path):
    """HDR-NeRF's and GaussHDR's photographs: training sees t1, t3 and t5 of five."""
    real = read_scene(layouts.write_real(tmp_path / "flower"))
    packed = read_scene(layouts.write_gausshdr(tmp_path / "coffee", suffix="jpg"))
    own = read_scene(layouts.write_colmap(tmp_path / "garden"))
    assert all(scene.photographs for scene in (real, packed, own))
    for preset in ("default", "gausshdr", "paper"):
        for scene in (real, packed):
            found = found_sizes(extent_of(scene, PRESETS[preset]), PRESETS[preset])
            assert found.training_exposures == (0, 2, 4)
        assert extent_of(own, PRESETS[preset]).exposures == (0, 1, 2)
    # Nothing is kept for testing of what physhdr prepare laid out so, or of a view that has nothing else.
    (tmp_path / "coffee" / CAPTURE_FILE).write_text('{"format": "physhdr-capture", "version": 1}')
    prepared = read_scene(tmp_path / "coffee")
    assert extent_of(prepared, PRESETS["default"]).exposures == (0, 1, 2, 3, 4)
    first, *rest = real.train
    odd = dataclasses.replace(first, bracket=(1,), exposures=first.exposures[:1], sources=first.sources[:1])
    assert extent_of(dataclasses.replace(real, train=[odd, *rest]), PRESETS["default"]).exposures == (0, 1, 2)


def test_of_longer_brackets_every_second_exposure_is_trained_on(tiny_data):
    scene = read_scene(tiny_data)

    def longer(views):
        return [
            dataclasses.replace(
                view,
                exposures=(*view.exposures, 64.0, 128.0),
                sources=(*view.sources, *view.sources[-2:]),
                bracket=(),
            )
            for view in views
        ]

    seven = dataclasses.replace(scene, train=longer(scene.train), lit=[])
    extent = extent_of(seven, PRESETS["default"])
    found = found_sizes(extent, PRESETS["default"])
    assert found.training_exposures == (0, 2, 4, 6)
    assert "exposures 0, 2, 4, 6" in sizes_in_words(extent, PRESETS["default"], found)
    typed = found_sizes(extent, PRESETS["default"], ("training_exposures",))
    assert typed.training_exposures == (0, 2, 4)
