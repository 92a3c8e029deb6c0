# SPDX-License-Identifier: GPL-3.0-or-later
"""cameras.json: its numbers against the projection that readers of 3DGS's files do, and what it refuses."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.axes import world_to_camera_opencv
from physhdr.bridge.camera_list import (
    LISTED_MOST,
    ListedCamera,
    camera_text,
    cameras_of,
    moved,
    read_learned_poses,
    write_camera_list,
)
from physhdr.bridge.errors import FileDamagedError, OutputError


def pose(angle: float = 0.0) -> np.ndarray:
    """At (1, −4, 2), looks along +Y, turned by ``angle`` about the view's axis."""
    c, s = math.cos(angle), math.sin(angle)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    matrix[:3, 3] = (1.0, -4.0, 2.0)
    return matrix


def camera(name: str = "train_000", is_learned: bool = True, angle: float = 0.0) -> ListedCamera:
    return ListedCamera(name, pose(angle), 640, 480, 500.0, 510.0, 322.5, 239.0, is_learned)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cameras.json"


def test_it_is_3dgss_form(path):
    """A point 4 m before the camera, half a metre to the right and a metre above, by plain arithmetic."""
    write_camera_list(path, [camera()])
    (entry,) = json.loads(path.read_text())
    assert (entry["id"], entry["img_name"], entry["width"], entry["height"]) == (0, "train_000", 640, 480)
    rotation, position = np.array(entry["rotation"]), np.array(entry["position"])
    x, y, z = rotation.T @ (np.array([1.5, 0.0, 3.0]) - position)
    np.testing.assert_allclose((x, y, z), (0.5, -1.0, 4.0), atol=1e-12)  # right, down, forward
    assert entry["fx"] * x / z + entry["cx"] == pytest.approx(322.5 + 62.5)
    assert entry["fy"] * y / z + entry["cy"] == pytest.approx(239.0 - 127.5)


def test_learned_poses_come_back_and_given_ones_are_not_among_them(path):
    write_camera_list(path, [camera(angle=0.3), camera("train_001", is_learned=False)])
    learned = read_learned_poses(path)
    assert learned.keys() == {"train_000"}
    np.testing.assert_allclose(learned["train_000"], pose(0.3), atol=1e-15)
    point = np.array([1.5, 0.0, 3.0, 1.0])
    seen = world_to_camera_opencv(learned["train_000"]) @ point
    np.testing.assert_allclose(seen, world_to_camera_opencv(pose(0.3)) @ point, atol=1e-12)


def test_another_programs_file_says_nothing_and_is_never_replaced(path):
    theirs = json.dumps([{"id": 0, "img_name": "a", "position": [0, 0, 0], "rotation": np.eye(3).tolist()}])
    for content in (theirs, "{", '{"frames": []}'):
        path.write_text(content)
        with pytest.raises(OutputError, match="PhysHDR did not write it"):
            write_camera_list(path, [camera()])
        assert path.read_text() == content
    path.write_text(theirs)
    assert read_learned_poses(path) == {}


def test_no_file_is_no_pose_and_ours_is_replaced(path):
    assert read_learned_poses(path) == {}
    for name in ("a", "b"):
        write_camera_list(path, [camera(name)])
    assert read_learned_poses(path).keys() == {"b"}


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("img_name", 3, "no img_name"),
        ("position", [1.0, 2.0], "position is not 3 numbers"),
        ("position", ["1", "2", "3"], "position is not 3 numbers"),
        ("position", [1.0, 2.0, 10**400], "position is not 3 numbers"),
        ("position", [1.0, 2.0, 1e30], "coordinates must be"),
        ("position", None, "position is not 3 numbers"),
        ("rotation", [[1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "rotation is not 3×3 numbers"),
        ("rotation", (2.0 * np.eye(3)).tolist(), "rotation is not a rotation"),
        ("rotation", np.diag([1.0, 1.0, -1.0]).tolist(), "rotation is not a rotation"),
    ],
)
def test_a_damaged_entry_is_named(path, key, value, said):
    write_camera_list(path, [camera()])
    content = json.loads(path.read_text())
    content[0][key] = value
    path.write_text(json.dumps(content))
    with pytest.raises(FileDamagedError, match=said) as caught:
        read_learned_poses(path)
    assert str(path) in caught.value.message and "Delete it, and export the run again" in caught.value.hint


def test_of_very_many_cameras_some_are_in_the_file():
    listed = json.loads(camera_text([camera(f"train_{index}") for index in range(7 * LISTED_MOST)]))
    assert [each["id"] for each in listed] == list(range(0, 7 * LISTED_MOST, 7))
    assert camera_text([]) == "[]"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "has no size"),
        ({"height": 2.5}, "has no size"),
        ({"fx": -1.0}, "no focal length"),
        ({"cy": 10**400}, "no focal length"),
        ({"img_name": ""}, "no img_name"),
        ({"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}, "rotation is not a rotation"),
        ({"pose": "unknown"}, "PhysHDR did not write"),
    ],
)
def test_cameras_that_cannot_be_are_refused(change, message):
    content = json.loads(camera_text([camera()]))
    content[0] |= change
    with pytest.raises(FileDamagedError, match=message):
        cameras_of(content, Path("model.safetensors"), "Export it again.")


def test_cameras_move_with_a_scene_and_stay_rigid():
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.5 * turn, (1.0, 2.0, 3.0)
    (found,) = moved([camera()], matrix)
    np.testing.assert_allclose(found.camera_to_world[:3, 3], 2.5 * turn @ (1.0, -4.0, 2.0) + (1.0, 2.0, 3.0))
    np.testing.assert_allclose(found.camera_to_world[:3, :3], turn @ pose()[:3, :3], atol=1e-12)
