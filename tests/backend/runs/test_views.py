# SPDX-License-Identifier: GPL-3.0-or-later
"""``views.json``: what a run keeps of its data set, and what is made of a file that is damaged."""

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.runs.run import Run
from physhdr.backend.runs.views import as_trained, read_views, write_views
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.encoding import LogEncoding
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.views import log_radiance_range
from physhdr.bridge.data_set import CAPTURE_FILE, CAPTURE_FORMAT
from physhdr.bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.run_folder import VIEWS_FILE, may_be_of, picture_names
from physhdr.tests.backend.scene import layouts


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
    assert may_be_of(run, tmp_path)  # killed before it said anything
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


def test_photographs_that_are_added_do_not_change_what_a_run_is_tested_on(tmp_path):
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
    assert "divides them differently" in line and "4 more" in line and line in found.messages
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
        ({"exposures": (0.1, 0.5, 2.0, 8.0, 32.0)}, "the exposures have changed"),
        ({"lighting_levels": (2.0,)}, "the light has changed"),
        ({"name": "train/another"}, "it is missing"),
        ({"camera": {"fx": 30.0}}, "focal length"),
        ({"camera": {"width": 64}}, "the pictures were 32×32, and are now 64×32"),
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


def nerf_of_renders(root):
    """Renders in NeRF's layout, whose exposures are stated and the camera's response is not."""
    for split in ("train", "test"):
        frames = []
        for i in range(3):
            (root / split).mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (8, 6), (90, 60, 30)).save(root / split / f"r_{i}.png")
            pose = np.eye(4)
            pose[0, 3] = i
            frame = {"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()}
            frames.append(frame | {"exposure_time": 0.125})
        content = {"camera_angle_x": 0.9, "frames": frames}
        (root / f"transforms_{split}.json").write_text(json.dumps(content))
    return root


@pytest.mark.parametrize("of_renders", [True, False])
def test_renders_stay_renders_without_their_data_set(of_renders, tmp_path):
    """Else an eighth of a second would be photographs of three stops: log2(1/8)."""
    run = tmp_path / "run"
    run.mkdir()
    scene = read_scene(nerf_of_renders(tmp_path / "data"))
    scene = scene if of_renders else replace(scene, of_renders=False)
    assert scene.response_anchor is None and scene.photographs is not of_renders
    write_views(run, scene)
    kept = read_views(run, tmp_path / "gone")
    (tmp_path / "other").mkdir()  # where the data set was a prepared one lies now
    (tmp_path / "other" / CAPTURE_FILE).write_text(json.dumps({"format": CAPTURE_FORMAT}))
    for opened in (kept, replace(kept, root=tmp_path / "other")):
        assert opened.photographs is not of_renders
        ev = Run(run, "default", TrainConfig(), opened, None, 0).photographed_ev
        assert ev == (0.0 if of_renders else -3.0)


def nerfstudio_of_radiance(root, radiance):
    """One OpenEXR of each value of ``radiance``, on a line; the layout has no lists of splits."""
    frames = []
    for k, value in enumerate(radiance):
        (root / "images").mkdir(parents=True, exist_ok=True)
        pixels = np.full((6, 8, 3), value, np.float32)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": pixels}) as file:
            file.write(str(root / "images" / f"r_{k:02}.exr"))
        pose = np.eye(4)
        pose[0, 3] = k
        frames.append({"file_path": f"images/r_{k:02}.exr", "transform_matrix": pose.tolist()})
    lens = {"fl_x": 9.0, "fl_y": 9.0, "cx": 4.0, "cy": 3.0, "w": 8, "h": 6}
    (root / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    return root


@pytest.mark.parametrize("where", ["train", "test"])
def test_brighter_pictures_that_are_added_leave_the_scale_of_radiance(where, tmp_path):
    """Of 16 pictures the added four are of radiance 300: in training, or beside the same training views."""
    run, told = tmp_path / "run", []
    run.mkdir()
    write_views(run, before := read_scene(nerfstudio_of_radiance(tmp_path / "data", [1.0] * 12)))
    now = read_scene(nerfstudio_of_radiance(tmp_path / "data", [1.0] * 12 + [300.0] * 4))
    if where == "test":  # the training views are those of the run, and only the test views are more
        added = [view for views in now.splits.values() for view in views if view.index >= 12]
        every = sorted([*now.train, *now.test], key=lambda view: view.index)
        same, test = ([v for v in every if v.name in names(some)] for some in (before.train, before.test))
        now = replace(now, train=same, test=[*test, *added])
    assert json.loads((run / VIEWS_FILE).read_text())["radiance_scale"] == 1.0
    found = as_trained(run, now, told.append)
    assert names(found.train) == names(before.train)
    assert {encoding for view in now.train for encoding in view.encodings} == {LogEncoding(300.0)}
    every = [view for views in found.splits.values() for view in views]
    assert {encoding for view in every for encoding in view.encodings} == {LogEncoding(1.0)}
    positions = [(0,)] * len(found.train)
    assert log_radiance_range(found.train, positions) == log_radiance_range(before.train, positions)
    assert found.train[0].values(0) == pytest.approx(1.0, abs=1e-4)  # and so are its codes
    assert "comparing radiance at the run's scale, 1: " in told[0] and told[0] in found.messages
    assert len(told) == (1 if where == "test" else 2)


VALUES = (None, "x", [], {}, -1, 0, 1.5, True, [1e999], "1" * 5000)


def test_any_value_in_it_is_taken_or_refused_with_a_reason(scene, tmp_path):
    write_views(tmp_path, scene)
    whole = json.loads((tmp_path / VIEWS_FILE).read_text())
    view = whole["splits"]["train"][0]
    whole |= {"splits": {"train": [view]}, "radiance_scale": 2.0}
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
