# SPDX-License-Identifier: GPL-3.0-or-later
"""``views.json``: what a run keeps of its data set, and what is made of a file that is damaged."""

import json

import numpy as np
import pytest

from physhdr.backend.runs.views import read_views, require_same_views, write_views
from physhdr.backend.scene import read_scene
from physhdr.bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.run_folder import VIEWS_FILE, may_be_of, picture_names


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
    require_same_views(run, scene)
    content = json.loads((run / VIEWS_FILE).read_text())
    content["splits"]["train"][0]["pose"][3] += 0.1
    (run / VIEWS_FILE).write_text(json.dumps(content))
    with pytest.raises(DataMismatchError, match="is not the data set"):
        require_same_views(run, scene)


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
