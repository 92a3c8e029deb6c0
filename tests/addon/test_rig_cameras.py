# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras that are drawn before a data set is rendered are those that it is rendered with."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from mathutils import Matrix, Vector  # noqa: E402

from physhdr.addon.dataset import dataset_settings, rig_cameras, rig_preview  # noqa: E402

SMALL = {"exposures": "-2 0 2", "resolution_x": 32, "samples": 1, "denoise": False, "relit_views": 1}


@pytest.fixture
def room(registered):
    """A floor, a sun and a camera that turns and moves in time."""
    scene = registered
    scene.render.resolution_x, scene.render.resolution_y = 200, 100
    floor = bpy.data.meshes.new("floor")
    floor.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    for name, data in (
        ("floor", floor),
        ("sun", bpy.data.lights.new("sun", "SUN")),
        ("camera", bpy.data.cameras.new("camera")),
    ):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    camera = scene.camera = bpy.data.objects["camera"]
    camera.location, camera.rotation_euler = (0.3, -4, 2), (1.1, 0, 0.2)
    camera.data.lens = 28.0
    bpy.context.view_layer.update()
    return scene


def poses(folder, split):
    frames = json.loads((folder / f"transforms_{split}.json").read_text())["frames"]
    return np.array([frame["transform_matrix"] for frame in frames])


@pytest.mark.parametrize(
    "rig",
    [
        {"rig": "GRID", "rig_width": 1.5, "rig_height": 0.5},
        pytest.param({"rig": "ORBIT", "rig_arc": 2.0, "rig_distance": 3.0}, marks=pytest.mark.long),
        pytest.param({"rig": "HEMISPHERE"}, marks=pytest.mark.long),
        {"rig": "PATH"},
    ],
)
def test_they_are_those_of_the_data_set(room, tmp_path, rig):
    if rig["rig"] == "PATH":
        for frame, x in ((1, 0.0), (50, 2.0)):
            room.camera.location.x = x
            room.camera.keyframe_insert("location", frame=frame)
        room.frame_set(7)
    settings = dataset_settings.settings_of(room)
    for name, value in {**SMALL, **rig, "views": 5, "lit_views": 2}.items():
        setattr(settings, name, value)
    found = rig_cameras.of(room, bpy.context.view_layer, dataset_settings.chosen(room))
    assert room.frame_current == (7 if rig["rig"] == "PATH" else 1)
    assert bpy.ops.physhdr.dataset_render(out=str(tmp_path / "data")) == {"FINISHED"}
    for split in ("train", "test", "lit"):
        np.testing.assert_allclose(getattr(found, split), poses(tmp_path / "data", split), atol=1e-5)
    told = json.loads((tmp_path / "data/transforms_train.json").read_text())
    assert found.angle_x == pytest.approx(told["camera_angle_x"]) and found.aspect == 0.5


@pytest.fixture
def hung_up(room):
    """The camera on an arm that turns, constrained and driven, and a marker that binds another camera."""
    camera, arm = room.camera, bpy.data.objects.new("arm", None)
    room.collection.objects.link(arm)
    camera.parent = arm
    for item, path, index, first, last in (
        (arm, "rotation_euler", 2, 0.0, 2.0),
        (camera, "location", 0, 0, 3),
    ):
        for frame, value in ((1, first), (20, last)):
            getattr(item, path)[index] = value
            item.keyframe_insert(path, index=index, frame=frame)
    camera.driver_add("location", 2).driver.expression = "frame / 8"
    track = camera.constraints.new("DAMPED_TRACK")
    track.target, track.track_axis = bpy.data.objects["floor"], "TRACK_NEGATIVE_Z"
    room.frame_end = 20
    other = bpy.data.objects.new("other", bpy.data.cameras.new("other"))
    room.collection.objects.link(other)
    room.timeline_markers.new("cut", frame=1).camera = other
    room.frame_set(7, subframe=0.5)
    room.camera = camera  # the marker's, until the user takes another (Ctrl Numpad 0)
    dataset_settings.settings_of(room).rig = "PATH"
    return room


def kept(scene):
    """What a user would miss, and what would be found in the file."""
    places = {item.name: [*item.location, *item.rotation_euler] for item in scene.objects}
    counts = [len(getattr(bpy.data, name)) for name in ("scenes", "objects", "collections", "actions")]
    markers = [(marker.frame, marker.camera) for marker in scene.timeline_markers]
    frame = scene.frame_current, scene.frame_subframe
    return places, counts, markers, frame, scene.camera, bpy.context.scene, bpy.data.is_dirty


def test_to_show_them_changes_nothing(hung_up):
    """Not the camera of the scene, nor what was moved and has no keyframe yet, nor what handlers hear."""
    scene, lamp = hung_up, bpy.data.objects["sun"]
    lamp.keyframe_insert("location", frame=1)
    for item in (lamp, scene.camera, scene.camera.parent):
        item.location.y, item.rotation_euler.z = 4.25, 0.75
    bpy.context.view_layer.update()
    before, told = kept(scene), []
    for handlers in (bpy.app.handlers.frame_change_pre, bpy.app.handlers.frame_change_post):
        handlers.append(lambda *_: told.append(1))
    assert bpy.ops.physhdr.rig_show() == {"FINISHED"} and rig_preview._shown.lines
    dataset_settings.settings_of(scene).views += 2
    assert kept(scene) == before and not told
    bpy.context.view_layer.update()
    assert kept(scene) == before and scene.camera.name == "camera"


def test_they_are_where_the_camera_is_at_these_frames(hung_up):
    """Against the scene itself, set to these frames: parent, constraint, driver, and time stretched."""
    scene, camera = hung_up, hung_up.camera
    scene.render.frame_map_new = 50  # half as fast
    settings = dataset_settings.settings_of(scene)
    settings.views, settings.lit_views = 5, 0
    found = rig_cameras.of(scene, bpy.context.view_layer, dataset_settings.chosen(scene))
    for pose, frame in zip([*found.train, *found.test], (1, 10.5, 20, 5.75, 15.25), strict=True):
        scene.frame_set(int(frame), subframe=frame % 1.0)
        np.testing.assert_allclose(pose, np.array(camera.matrix_world), atol=1e-5)


def test_lines_against_blenders_own_frame_of_a_camera(room):
    """The corners of the drawn picture are where Blender has those of a camera that stands there."""
    pose = Matrix.Translation((1, 2, 3)) @ Matrix.Rotation(0.7, 4, Vector((1, 2, 3)).normalized())
    camera = room.camera
    camera.matrix_world = pose
    angle = camera.data.angle_x
    (lines,) = rig_cameras.frustums(np.array([pose]), angle, 0.5, 0.25)
    assert lines.shape == (10, 2, 3)
    frame = camera.data.view_frame(scene=room)  # at some depth
    expected = [pose @ (corner * (0.25 / -corner.z)) for corner in frame]
    np.testing.assert_allclose(lines[:4, 0], np.tile(pose.translation, (4, 1)), atol=1e-6)
    for corner in expected:
        assert np.linalg.norm(lines[:4, 1] - np.array(corner), axis=1).min() < 1e-5
    up = np.array(pose.to_3x3() @ Vector((0, 1, 0)))
    tip = lines[8, 1]
    assert (tip - np.array(pose.translation)) @ up > max((lines[:4, 1] - np.array(pose.translation)) @ up)
    height = 0.25 * math.tan(angle / 2.0) * 0.5
    heights = np.sort((lines[:4, 1] - np.array(pose.translation)) @ up)[::3]
    np.testing.assert_allclose(heights, [-height, height], rtol=1e-5)


def test_thousands_are_thinned():
    many = np.tile(np.eye(4), (1000, 1, 1)) * np.arange(1000)[:, None, None]
    few = rig_cameras.thinned(many, 10)
    assert len(few) == 10 and np.ptp(np.diff(few[:, 3, 3])) <= 1.0
    assert rig_cameras.thinned(many[:10], 10) is not None and len(rig_cameras.thinned(many[:3], 10)) == 3


def test_the_toggle(room):
    """Shown while it is pressed; what is drawn follows the settings and the camera."""
    shown = rig_preview._shown
    assert not shown.lines
    settings = dataset_settings.settings_of(room)
    settings.views, settings.lit_views = 6, 0
    assert not shown.lines  # nobody looks
    assert bpy.ops.physhdr.rig_show() == {"FINISHED"}
    assert [len(shown.lines[kind]) for kind in ("train", "test", "lit")] == [3, 3, 0]
    settings.views, settings.lit_views = 8, 1
    assert [len(shown.lines[kind]) for kind in ("train", "test", "lit")] == [4, 4, 1]
    before = shown.lines["train"].copy()
    room.camera.location.z += 1.0
    bpy.context.view_layer.update()
    rig_preview.refresh()
    assert not np.allclose(before, shown.lines["train"])
    settings.rig, settings.rig_width = "GRID", 1.0  # one side only: no cameras, and no error from here
    assert not shown.lines
    settings.rig_width = 0.0
    assert shown.lines and bpy.ops.physhdr.rig_show() == {"FINISHED"} and not shown.lines
    room.camera.data.type = "ORTHO"
    with pytest.raises(RuntimeError, match="give no cameras"):
        bpy.ops.physhdr.rig_show()
    assert not rig_preview.pinned()


def test_with_the_dialog_they_come_and_go(room):
    shown, settings = rig_preview._shown, dataset_settings.settings_of(room)
    rig_preview.dialog_opened(bpy.context)
    assert shown.lines
    settings.show_cameras = False
    assert not shown.lines
    settings.show_cameras = True
    assert shown.lines
    rig_preview.dialog_closed()
    assert not shown.lines
    bpy.ops.physhdr.rig_show()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not shown.lines and not rig_preview.pinned()


def test_an_animation_that_stands_still_is_looked_at_once(room, monkeypatch):
    """To look along it evaluates a scene of its own, of which handlers hear, at which the cameras follow."""
    assert bpy.ops.physhdr.rig_show() == {"FINISHED"}
    looked = []
    monkeypatch.setattr(rig_preview, "lines", lambda *given: looked.append(given) or {})
    dataset_settings.settings_of(room).rig = "PATH"
    for _ in range(3):
        rig_preview._follow()
    assert len(looked) == 1 and rig_preview.pinned()
    dataset_settings.settings_of(room).views += 1
    assert len(looked) == 2
