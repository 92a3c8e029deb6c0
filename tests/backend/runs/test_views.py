# SPDX-License-Identifier: GPL-3.0-or-later
"""``views.json``: what a run keeps of its data set, and what is made of a file that is damaged."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.runs.views import as_trained, read_views, write_views
from physhdr.backend.scene import read_scene
from physhdr.bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.run_folder import VIEWS_FILE, may_be_of, picture_names


@pytest.fixture
def layouts():
    place = Path(__file__).parents[1] / "scene" / "layouts.py"
    spec = importlib.util.spec_from_file_location("layouts", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def scene(tiny_data):
    return read_scene(tiny_data)


def test_what_is_kept_is_the_scene_without_its_pictures(scene, tmp_path):
    write_views(tmp_path, scene)
    kept = read_views(tmp_path, tmp_path / "gone")
    assert (kept.name, kept.lights, kept.response_anchor) == (scene.name, scene.lights, scene.response_anchor)
    assert {name: len(views) for name, views in kept.splits.items()} == {
        name: len(views) for name, views in scene.splits.items()
    }
    for name, views in scene.splits.items():
        for before, after in zip(views, kept.splits[name], strict=True):
            assert np.array_equal(before.camera.camera_to_world, after.camera.camera_to_world)
            for field in ("width", "height", "fx", "fy", "cx", "cy"):
                assert getattr(before.camera, field) == getattr(after.camera, field)
            for field in ("name", "index", "exposures", "bracket", "lighting_levels"):
                assert getattr(before, field) == getattr(after, field)
    with pytest.raises(FileMissingError, match="gone"):
        kept.train[0].image(0)


def test_a_data_set_is_known_by_its_pictures_names_and_its_cameras(scene, tiny_data, tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    assert may_be_of(run, tmp_path)  # an earlier version's says nothing
    write_views(run, scene)
    assert len(picture_names(run)) == sum(len(view.exposures) for view in scene.train)
    assert may_be_of(run, tiny_data) and not may_be_of(run, tmp_path)
    assert as_trained(run, scene) is scene
    content = json.loads((run / VIEWS_FILE).read_text())
    content["splits"]["train"][0]["pose"][3] += 0.1
    (run / VIEWS_FILE).write_text(json.dumps(content))
    with pytest.raises(DataMismatchError, match="is not the data set"):
        as_trained(run, scene)


def names(views):
    return [view.name for view in views]


def test_photographs_that_are_added_do_not_change_what_a_run_is_tested_on(layouts, tmp_path):
    """By the rule that chooses test views, some that were trained on would be tested from then on."""
    run, told = tmp_path / "run", []
    run.mkdir()
    before = read_scene(layouts.write_colmap(tmp_path / "data", poses=10))
    # Of the same capture fewer, as if the first four poses had been added.
    fewer = [view for view in (*before.train, *before.test) if view.index >= 4]
    test = [view for view in fewer if view.index == 7]
    first = replace(before, train=[view for view in fewer if view not in test], test=test)
    write_views(run, first)
    leaking = names(first.train) and set(names(first.train)) & set(names(before.test))
    assert leaking  # or this would show nothing
    found = as_trained(run, before, told.append)
    assert (names(found.train), names(found.test)) == (names(first.train), names(first.test))
    (line,) = told
    assert "divides them otherwise" in line and "4 more" in line and line in found.messages
    assert found.test[0].image(0).shape == (72, 96, 3)  # with its pictures


def test_a_view_keeps_its_places_in_the_bracket(scene, tmp_path):
    """Photographs with shorter exposures were added: what was exposure 0 is 1 by now."""
    write_views(tmp_path, scene)
    now = replace(
        scene, train=[replace(view, bracket=tuple(k + 1 for k in view.bracket)) for view in scene.train]
    )
    assert [view.bracket for view in as_trained(tmp_path, now).train] == [(0, 1, 2, 3, 4)] * len(scene.train)


def test_of_a_run_without_test_views_those_that_the_data_have_are_tested(scene, tmp_path):
    """A plan that tunes is shown none; and some may have been made later."""
    write_views(tmp_path, replace(scene, test=[]))
    assert as_trained(tmp_path, scene).test == scene.test
    moved = replace(scene, train=scene.train[:-1], test=[*scene.test, scene.train[-1]])
    assert names(as_trained(tmp_path, moved).test) == names(scene.test)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"exposures": (0.1, 0.5, 2.0, 8.0, 32.0)}, "the exposures are others"),
        ({"lighting_levels": (2.0,)}, "the light is another"),
        ({"name": "train/another"}, "it has nothing"),
        ({"camera": {"fx": 30.0}}, "focal length"),
        ({"camera": {"width": 64}}, "the pictures were 32×32, and are 64×32"),
    ],
)
def test_a_view_that_is_not_what_was_trained_on_is_named(scene, tmp_path, changed, said):
    write_views(tmp_path, scene)
    first, *rest = scene.train
    if "camera" in changed:
        changed = {"camera": replace(first.camera, **changed["camera"])}
    with pytest.raises(DataMismatchError, match=said) as error:
        as_trained(tmp_path, replace(scene, train=[replace(first, **changed), *rest]))
    assert first.name in error.value.message


@pytest.mark.parametrize("another", [(1.0, 0.4), (2.0, 0.73), None])
def test_another_known_point_of_the_response_is_another_data_set(another, scene, tmp_path):
    """With it the curves that were learned would be shifted, and all pictures be darker or brighter."""
    stated = replace(scene, response_anchor=(1.0, 0.73))
    moved = replace(scene, response_anchor=another)
    for before, now in ((stated, moved), (moved, stated)):
        write_views(tmp_path, before)
        assert as_trained(tmp_path, before) is before
        with pytest.raises(DataMismatchError, match=r"known point of the response was .*, and is "):
            as_trained(tmp_path, now)


VALUES = (None, "x", [], {}, -1, 0, 1.5, True, [1e999], "1" * 5000)


def test_any_value_in_it_is_taken_or_refused_with_a_reason(scene, tmp_path):
    write_views(tmp_path, scene)
    whole = json.loads((tmp_path / VIEWS_FILE).read_text())
    view = whole["splits"]["train"][0]
    whole["splits"] = {"train": [view]}
    refused = 0
    for key in (*whole, *(f"view {name}" for name in view)):
        for value in VALUES:
            content = json.loads(json.dumps(whole))
            target = content["splits"]["train"][0] if key.startswith("view ") else content
            target[key.removeprefix("view ")] = value
            (tmp_path / VIEWS_FILE).write_text(json.dumps(content))
            try:
                read_views(tmp_path, tmp_path)
            except PhysHDRError as error:
                assert VIEWS_FILE in error.message, error
                refused += 1
            picture_names(tmp_path)  # as Blender asks: it never raises
    assert refused > 100
    for content in ("", "{", "[]", '{"format": "physhdr-views", "version": 2}'):
        (tmp_path / VIEWS_FILE).write_text(content)
        with pytest.raises((FileDamagedError, DataMismatchError)):
            read_views(tmp_path, tmp_path)
        assert picture_names(tmp_path) == []
