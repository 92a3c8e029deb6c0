# SPDX-License-Identifier: GPL-3.0-or-later
"""Data that can be read, but from which nothing can be learned: it is said before hours are spent on it."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from plyfile import PlyData

from physhdr.backend.cli import main
from physhdr.backend.inspect import inspect
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.encoding import LogEncoding
from physhdr.backend.scene.plausible import with_warnings
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.splatting import NEAR_PLANE


@pytest.fixture
def changed(tiny_data, tmp_path):
    """``tiny_data`` with other positions, lenses or exposures."""

    def change(scale=1.0, angle=None, exposure=None, points=True):
        root = tmp_path / "data"
        shutil.copytree(tiny_data, root)
        for path in root.glob("transforms_*.json"):
            content = json.loads(path.read_text())
            content["camera_angle_x"] = angle or content["camera_angle_x"]
            for frame in content["frames"]:
                pose = np.array(frame["transform_matrix"])
                pose[:3, 3] *= scale
                frame["transform_matrix"] = pose.tolist()
            path.write_text(json.dumps(content))
        for path in root.glob("exposure_*.json"):
            seconds = json.loads(path.read_text())
            path.write_text(json.dumps({name: exposure or each for name, each in seconds.items()}))
        (ply,) = root.glob("*.ply")
        content = PlyData.read(ply, mmap=False)
        for axis in "xyz":
            content["vertex"][axis] *= scale
        content.write(ply)
        if not points:
            ply.unlink()
        return root

    return change


def words(scene):
    """What is said of learning, which no reader says."""
    return with_warnings(replace(scene, messages=())).messages


def test_an_ordinary_scene_has_nothing_said_of_it(tiny_data):
    assert words(read_scene(tiny_data)) == ()


def test_a_scene_smaller_than_the_near_plane_is_refused(changed):
    with pytest.raises(BadValueError, match=rf"100% .* {NEAR_PLANE:g} m .* within 0\.00\d+ m") as refused:
        read_scene(root := changed(scale=0.001))
    assert "by 1000" in refused.value.hint
    assert any("nothing so near is drawn" in fault for fault in inspect(root).errors)


def test_as_it_is_without_points_once_stereo_has_found_them(changed, tmp_path, capsys):
    root = changed(scale=0.001, points=False)
    assert any("0.01 m is drawn" in message for message in read_scene(root).messages)
    assert main(["train", str(root), "--out", str(tmp_path / "run"), "--iterations", "2"]) == 1
    assert "nothing so near is drawn" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_scene_that_reaches_before_the_near_plane_is_warned_of(changed):
    said = read_scene(changed(scale=0.0027)).messages[-1]
    assert "nothing so near is drawn" in said and "by 100." in said


def test_cameras_in_one_place_are_said_to_tell_no_depth(changed):
    assert "nothing tells how far" in words(read_scene(changed(scale=0.0, points=False)))[0]


def test_a_focal_length_in_millimetres_is_asked_about(changed):
    assert "given in pixels?" in words(read_scene(changed(angle=3.1)))[0]


def test_of_one_exposure_there_is_no_dynamic_range(changed):
    scene = read_scene(root := changed(exposure=0.5))
    assert ["no dynamic range" in message for message in words(scene)] == [True]
    assert any("no dynamic range" in message for message in inspect(root).messages)
    radiance = [
        replace(view, sources=tuple(replace(each, encoding=LogEncoding(1.0)) for each in view.sources))
        for view in scene.train
    ]
    assert words(replace(scene, train=radiance)) == ()
