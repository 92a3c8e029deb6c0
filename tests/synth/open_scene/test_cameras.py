# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs around the camera of the user's scene, its lens, and what the rig looks at."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest

from physhdr.synth import dataset, open_scene, rig, user_camera
from physhdr.synth.errors import OptionError, SceneError
from physhdr.synth.options import FOLLOW
from physhdr.synth.progress import Report
from physhdr.tests.synth import conftest as readers
from physhdr.tests.synth.open_scene.user_scene import CAMERA, SMALL, add, in_front, poses_of


@pytest.mark.parametrize("name", ["grid", "orbit", "hemisphere"])
def test_rigs_stand_around_the_users_camera_and_look_where_it_looks(scene, tmp_path, name):
    options = replace(SMALL, camera_rig=name, rig_distance=5.0)
    dataset.make(tmp_path, options)
    target = in_front(5.0)
    places = [pose[:3, 3] for split in ("train", "test") for pose in poses_of(tmp_path, split)]
    for pose in [pose for split in ("train", "test", "lit") for pose in poses_of(tmp_path, split)]:
        away = target - pose[:3, 3]
        assert np.allclose(-pose[:3, 2], away / np.linalg.norm(away), atol=1e-6)
    if name == "grid":
        assert np.allclose(np.mean(places, 0), CAMERA, atol=1e-6)
        assert np.ptp(np.array(places)[:, 0]) == pytest.approx(0.5 * 5.0)
        assert np.ptp(np.array(places)[:, 2]) == pytest.approx(0.3 * 5.0)
    else:
        assert np.allclose(np.linalg.norm(places - target, axis=1), 5.0)
        height = np.array(places)[:, 2]
        assert np.allclose(height, CAMERA[2]) if name == "orbit" else np.ptp(height) > 1.0
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["resolution"] == [32, 18] and told["splits"] == {"train": 3, "test": 3, "lit": 2}
    assert told["source"]["camera"] == "mine" and told["source"]["rig_distance"] == 5.0
    radiance = readers.read_exr(tmp_path / "test_hdr/hdr_001.exr").astype(np.float64)
    for k, t in enumerate(told["exposures"]):
        code = np.floor(255 * (radiance * t / (1 + radiance * t)) ** (1 / 2.2) + 0.5)
        np.testing.assert_array_equal(readers.read_png(tmp_path / f"test/r_1_{k}.png")[..., :3], code)
    points = readers.read_ply(tmp_path / "points3d.ply")
    place = np.stack([points[k] for k in "xyz"], -1)
    on_cube = (np.abs(np.abs(place[:, :2]).max(1) - 0.5) < 1e-4) | (np.abs(place[:, 2] - 1) < 1e-4)
    assert ((np.abs(place[:, 2]) < 1e-4) | on_cube).all() and on_cube.sum() > 50


def test_the_path_is_the_cameras_own_however_it_moves(scene, tmp_path):
    """A camera on a turning parent that is scaled: the poses are those that Blender itself gives, rigid."""
    mine = scene.camera
    arm = add("arm", None)
    arm.scale = (2.0, 2.0, 2.0)
    mine.parent = arm
    scene.frame_start, scene.frame_end = 10, 60
    for frame, angle in ((10, 0.0), (60, 1.0)):
        arm.rotation_euler.z = angle
        arm.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(17)
    dataset.make(tmp_path, replace(SMALL, camera_rig="path"))
    assert scene.frame_current == 17
    given = {"train": (0, 2, 4), "test": (1, 3, 5)}
    for split, at in given.items():
        for pose, k in zip(poses_of(tmp_path, split), at, strict=True):
            scene.frame_set(10 + 10 * k)
            expected = np.array(mine.matrix_world)
            expected[:3, :3] /= 2.0
            np.testing.assert_allclose(pose, expected, atol=1e-5)
    assert readers.read_json(tmp_path / "dataset.json")["source"]["frames"] == [10, 60]


def test_validation_views_keep_off_the_others_of_a_path(scene):
    """A camera that moves by 34 m, a metre a view: they lie a quarter of a metre or more from each view."""
    mine = scene.camera
    scene.frame_start, scene.frame_end = 1, 100
    for frame, x in ((1, 0.0), (100, 34.0)):
        mine.location.x = x
        mine.keyframe_insert("location", index=0, frame=frame)
    for curve in mine.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    poses = user_camera.path(scene, mine, replace(SMALL, views=35, validation_views=12, camera_rig="path"))
    at = [np.array([pose[0, 3] for pose in each]) for each in (poses.train + poses.test, poses.validation)]
    assert sorted(at[0] - at[0].min()) == pytest.approx(range(35), abs=1e-3)
    assert len(at[1]) == 12 and np.abs(at[1][:, None] - at[0][None]).min() > 0.249


def test_a_path_that_stands_still_is_refused(scene, tmp_path):
    with pytest.raises(OptionError, match="'mine' stands still over the frames 1 … 250"):
        dataset.make(tmp_path / "d", replace(SMALL, camera_rig="path"))
    assert not (tmp_path / "d").exists()


def test_a_full_circle_has_no_camera_twice(scene):
    with open_scene.opened(
        replace(SMALL, camera_rig="orbit", rig_arc=360.0, rig_distance=4.0, views=8), Report()
    ) as (stage, _):
        poses = rig.poses("orbit", stage.cameras, 8, 0)
    places = np.array([pose[:3, 3] for pose in [*poses.train, *poses.test]])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1)[~np.eye(8, dtype=bool)]
    assert gaps.min() > 1.0


@pytest.mark.parametrize("up", [0.0, 0.4])
def test_a_camera_that_looks_straight_down_keeps_its_own_up(scene, tmp_path, up):
    scene.camera.location, scene.camera.rotation_euler = (0, 0, 5), (0, 0, up)
    dataset.make(tmp_path, replace(SMALL, relit_views=0, lit_views=0))
    for pose in [*poses_of(tmp_path, "train"), *poses_of(tmp_path, "test")]:
        assert pose[:3, 1] @ [-math.sin(up), math.cos(up), 0] > 0.9


class TestLens:
    """The picture's horizontal angle, against the corners that Blender itself gives the camera."""

    @pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
    @pytest.mark.parametrize("size", [(64, 36), (36, 64), (40, 40)])
    def test_angle(self, scene, fit, size):
        lens = scene.camera.data
        lens.sensor_fit, lens.lens, lens.sensor_width, lens.sensor_height = fit, 28.0, 36.0, 20.0
        scene.render.resolution_x, scene.render.resolution_y = size
        right = max(corner.x / -corner.z for corner in lens.view_frame(scene=scene))
        assert math.tan(user_camera.angle_x(lens, size) / 2) == pytest.approx(right, rel=1e-5)

    @pytest.mark.parametrize("kind", ["ORTHO", "PANO"])
    def test_cameras_that_are_no_pinholes_are_refused(self, scene, tmp_path, kind):
        scene.camera.data.type = kind
        with pytest.raises(SceneError, match="perspective camera"):
            dataset.make(tmp_path / "d", SMALL)

    def test_a_shift_is_left_out_and_told(self, scene, capsys):
        scene.camera.data.shift_x = 0.1
        report = Report()
        with open_scene.opened(SMALL, report):
            pass
        assert "lens shift" in report.warnings[0] and "lens shift" in capsys.readouterr().err

    def test_the_picture_is_what_the_users_camera_sees(self, scene, tmp_path):
        """The middle of an odd grid is the user's own view: against a render with their camera."""
        size = (48, FOLLOW)
        scene.camera.data.lens = 35.0
        options = replace(SMALL, resolution=size, views=35, lit_views=0, relit_views=0, samples=16)
        dataset.make(tmp_path, options)
        middle = next(
            k
            for k, pose in enumerate(poses_of(tmp_path, "test"))
            if np.allclose(pose[:3, 3], CAMERA, atol=1e-5)
        )
        ours = readers.read_exr(tmp_path / f"test_hdr/hdr_{middle:03d}.exr")
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_denoising = 16, False
        scene.cycles.use_adaptive_sampling = False
        scene.cycles.sample_clamp_indirect = 0.0
        scene.render.resolution_x, scene.render.resolution_y = 48, 27
        picture = scene.render.image_settings
        picture.file_format, picture.color_depth, picture.color_mode = "OPEN_EXR", "32", "RGB"
        scene.render.filepath = str(tmp_path / "theirs.exr")
        bpy.ops.render.render(write_still=True)
        theirs = readers.read_exr(tmp_path / "theirs.exr")
        assert np.median(np.abs(ours - theirs) / theirs) < 0.02


class TestTarget:
    """What the rig looks at."""

    def distance(self, scene, **changes):
        with open_scene.opened(replace(SMALL, **changes), Report()) as (stage, _):
            return stage.source["rig_distance"]

    def test_the_focus(self, scene):
        scene.camera.data.dof.use_dof, scene.camera.data.dof.focus_distance = True, 3.25
        assert self.distance(scene) == pytest.approx(3.25)
        scene.camera.data.dof.focus_object = add("focus", None, tuple(in_front(2.5) + [0.7, 0, 0]))
        assert self.distance(scene) == pytest.approx(2.5, rel=1e-5)

    def test_what_the_camera_sees(self, scene):
        """Straight down onto the floor, past a cutter that is not rendered."""
        scene.camera.location, scene.camera.rotation_euler = (3, 3, 4), (0, 0, 0)
        scene.camera.data.lens = 200.0
        assert self.distance(scene) == pytest.approx(4.0, rel=1e-4)
        blocker = add("cutter", bpy.data.meshes["cube"], (3, 3, 2))
        assert self.distance(scene) == pytest.approx(1.0, rel=1e-4)
        blocker.hide_viewport = True  # and rendered all the same
        assert self.distance(scene) == pytest.approx(1.0, rel=1e-4)
        blocker.hide_render = True
        assert self.distance(scene) == pytest.approx(4.0, rel=1e-4)

    def test_the_middle_of_the_scene_where_it_sees_nothing(self, scene):
        scene.camera.rotation_euler = (math.pi / 2 + 0.5, 0, 0)  # up into the sky
        low, high = np.array([-6, -6, 0]), np.array([6, 6, 1])
        forward = np.array([0, math.cos(0.5), math.sin(0.5)])
        expected = ((low + high) / 2 - CAMERA) @ forward
        assert self.distance(scene) == pytest.approx(expected, rel=1e-3)

    def test_what_is_asked(self, scene):
        assert self.distance(scene, rig_distance=7.5) == 7.5

    def test_walls_in_the_way_are_told(self, scene, tmp_path):
        for x in (-1, 1):
            add("wall", bpy.data.meshes["cube"], (0.5 + x, -5, 1)).scale = (0.2, 20, 20)
        report = Report()
        with open_scene.opened(replace(SMALL, rig_extent=(8.0, 1.0), rig_distance=4.0), report):
            pass
        assert any("behind or within things" in line and "--rig-extent" in line for line in report.warnings)
