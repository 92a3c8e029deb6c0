# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs under other light: who is trained from, at which levels, in every layout that may say so."""

import dataclasses
import json

import numpy as np
import pytest

from physhdr.backend.runs.views import as_trained, read_views, write_views
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError, DataMismatchError
from physhdr.bridge.light_groups import LightGroup, LightGroups, write_light_groups

from . import layouts

LIGHTS = ("pendant", "flash")
#: Of GaussHDR's packaging, whose even poses are for training.
GROUPS = LightGroups(
    LIGHTS,
    (
        LightGroup("pendant off", {"pendant": 0.0}, ("*_r_5", "*_r_6")),
        LightGroup("flash on", {"flash": 1.0}, ("*_r_7", "*_r_8_*")),
    ),
    {"flash": 0.0},
)


@pytest.fixture
def capture(tmp_path):
    layouts.write_gausshdr(tmp_path / "room", poses=9, suffix="jpg")
    write_light_groups(tmp_path / "room", GROUPS)
    return tmp_path / "room"


def names(views):
    return [view.name for view in views]


def test_groups_are_trained_at_their_levels_and_some_are_held_out(capture):
    scene = read_scene(capture)
    assert scene.lights == LIGHTS and scene.standard_levels == (1.0, 0.0)
    assert names(scene.train) == ["train_r_0", "train_r_2", "train_r_4"]
    assert names(scene.test) == ["test_r_1", "test_r_3"]
    assert names(scene.lit) == ["train_r_6", "train_r_8"]
    assert names(scene.lit_test) == ["test_r_5", "test_r_7"]
    levels = {
        view.name: (view.group, view.lighting_levels) for views in scene.splits.values() for view in views
    }
    assert levels["train_r_6"] == levels["test_r_5"] == ("pendant off", (0.0, 0.0))
    assert levels["train_r_8"] == levels["test_r_7"] == ("flash on", (1.0, 1.0))
    assert levels["train_r_0"] == levels["test_r_3"] == ("", (1.0, 0.0))
    for views, is_standard in ((scene.train + scene.test, True), (scene.lit + scene.lit_test, False)):
        assert all(view.is_standard == is_standard for view in views)


def test_a_run_keeps_groups_and_levels(capture, tmp_path):
    scene = read_scene(capture)
    write_views(tmp_path, scene)
    kept = read_views(tmp_path, capture)
    assert kept.standard_levels == scene.standard_levels and kept.lights == scene.lights
    for name, views in scene.splits.items():
        assert [(v.name, v.group, v.lighting_levels) for v in views] == [
            (v.name, v.group, v.lighting_levels) for v in kept.splits[name]
        ]
    assert as_trained(tmp_path, scene) is scene
    (capture / "lights.json").unlink()
    with pytest.raises(DataMismatchError, match="is not the data set"):
        as_trained(tmp_path, read_scene(capture))


@pytest.mark.parametrize("preset", ["default", "baseline"])
def test_what_is_held_out_of_a_group_is_not_trained_from(capture, preset):
    """Law 6: with noise for their pictures, training gives the same tensors."""
    config = dataclasses.replace(PRESETS[preset], iterations=6, initial_points="random", random_points=200)

    def trained():
        state = begin(read_scene(capture), config)
        for _ in range(6):
            step(state)
        return {name: tensor.detach().numpy() for name, tensor in state.method.backbone.parameters.items()}

    before = trained()
    held_out = [*capture.glob("images/test_r_5_*"), *capture.glob("images/test_r_7_*")]
    assert len(held_out) == 10
    for path in held_out:
        noise = np.random.default_rng(1).integers(0, 256, (layouts.HEIGHT, layouts.WIDTH, 3))
        layouts.save(path, noise.astype(np.uint8))
    after = trained()
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_colmap_holds_out_of_large_groups_alone(tmp_path):
    layouts.write_colmap(tmp_path, poses=20)
    evening = tuple(f"shot_{index:02d}_*" for index in range(10, 20))
    few = LightGroup("lamp off", {"lamp": 0.0}, ("shot_00_1.jpg", "shot_01_1"))
    groups = (LightGroup("evening", {"daylight": None}, evening), few)
    write_light_groups(tmp_path, LightGroups(("daylight", "lamp"), groups))
    scene = read_scene(tmp_path)
    assert {view.group for view in scene.lit_test} == {"evening"} and len(scene.lit_test) == 1
    assert names(view for view in scene.lit if view.group == "lamp off") == ["shot_00", "shot_01"]
    (held_out,) = scene.lit_test
    assert held_out.lighting_levels == (None, 1.0) and not held_out.is_standard
    with pytest.raises(BadValueError, match="is unknown"):
        _ = held_out.known_levels
    assert len(scene.train) + len(scene.test) == 8


def test_a_light_that_is_on_in_its_own_groups_alone_is_at_1_in_the_first(tmp_path):
    layouts.write_colmap(tmp_path, poses=6)
    one = LightGroup("flash", {"flash": None}, ("shot_00", "shot_01"))
    two = LightGroup("flash again", {"flash": None}, ("shot_02",))
    write_light_groups(tmp_path, LightGroups(("flash",), (one, two), {"flash": 0.0}))
    assert [view.lighting_levels for view in read_scene(tmp_path).lit] == [(1.0,), (1.0,), (None,)]
    known = LightGroup("flash again", {"flash": 2.0}, ("shot_02",))
    write_light_groups(tmp_path, LightGroups(("flash",), (one, known), {"flash": 0.0}))
    assert [view.lighting_levels for view in read_scene(tmp_path).lit] == [(None,), (None,), (2.0,)]


def test_a_group_without_a_pose_is_named_and_all_in_groups_is_refused(tmp_path):
    layouts.write_colmap(tmp_path, poses=6)
    nothing = LightGroup("desk lamp", {"desk": 0.0}, ("desk/*",))
    write_light_groups(tmp_path, LightGroups(("desk",), (nothing,)))
    assert any("no pose is of the group 'desk lamp'" in message for message in read_scene(tmp_path).messages)
    write_light_groups(tmp_path, LightGroups(("desk",), (LightGroup("all", {"desk": 0.0}, ("*",)),)))
    with pytest.raises(DataMismatchError, match="none is of the standard one"):
        read_scene(tmp_path)


def test_frames_of_transforms_json_may_say_their_levels(tmp_path):
    layouts.write_nerfstudio(tmp_path, poses=9)
    path = tmp_path / "transforms.json"
    content = json.loads(path.read_text())
    by_name = {frame["file_path"]: frame for frame in content["frames"]}
    by_name["images/frame_00007.png"]["lighting_levels"] = {"pendant": 0, "flash": 0}
    by_name["images/frame_00008.png"]["lighting_levels"] = {"pendant": None, "flash": 0}
    content["lighting_levels"] = {"flash": 0}
    path.write_text(json.dumps(content))
    scene = read_scene(tmp_path)
    assert scene.lights == ("pendant", "flash") and scene.standard_levels == (1.0, 0.0)
    assert {view.name: view.lighting_levels for view in scene.lit} == {
        "images/frame_00007": (0.0, 0.0),
        "images/frame_00008": (None, 0.0),
    }
    # A list of the split decides of them, too; a file beside it decides of the light.
    content["test_filenames"] = ["images/frame_00004.png", "images/frame_00008.png"]
    path.write_text(json.dumps(content))
    scene = read_scene(tmp_path)
    assert names(scene.lit_test) == ["images/frame_00008"] and names(scene.test) == ["images/frame_00004"]
    write_light_groups(tmp_path, LightGroups(("desk",), (LightGroup("x", {"desk": 2.0}, ("frame_00003",)),)))
    scene = read_scene(tmp_path)
    assert names(scene.lit) == ["images/frame_00003"] and scene.lights == ("desk",)


def test_one_frame_of_no_object_is_refused(tmp_path):
    layouts.write_nerfstudio(tmp_path, poses=4)
    content = json.loads((tmp_path / "transforms.json").read_text())
    content["frames"][0]["lighting_levels"] = 0.5
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(BadValueError, match="'lighting_levels' is"):
        read_scene(tmp_path)
