# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare --triangulate`` on a room whose surfaces are known, and what can go wrong."""

import importlib.util
import json
import math
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tyro
from PIL import Image

from physhdr.backend.cli.prepare import Prepare
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.points import STRUCTURE_FROM_MOTION, read_points
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig
from physhdr.bridge.axes import camera_to_world_opengl
from physhdr.bridge.data_set import CAPTURE_FILE, CAPTURE_FORMAT
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.ply import open_ply

VIEWS, SIZE, FOCAL = 7, (320, 240), 300.0
SFM = "points3d_sfm.ply"


@pytest.fixture(scope="module")
def room():
    path = Path(__file__).parents[1] / "scene" / "capture" / "room.py"
    spec = importlib.util.spec_from_file_location("room", path)
    module = sys.modules["room"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def photograph(room, pose, focal=FOCAL):
    rays = room.rays_of_pinhole(*SIZE, focal, focal, 0.5 * SIZE[0], 0.5 * SIZE[1])
    return room.picture(pose, rays, *SIZE)


def matrix_of(pose):
    return camera_to_world_opengl(np.concatenate([pose, [[0.0, 0.0, 0.0, 1.0]]])).tolist()


@pytest.fixture(scope="module")
def made(room, tmp_path_factory):
    """The room in our own layout: brackets of three, of which training sees the first and the last."""
    root = tmp_path_factory.mktemp("room") / "data"
    poses = room.arc(VIEWS + 2)
    for split, of in (("train", poses[:VIEWS]), ("test", poses[VIEWS:])):
        (root / split).mkdir(parents=True)
        frames, exposures = [], {}
        for number, pose in enumerate(of):
            seen = photograph(room, pose)
            for k, seconds in enumerate(room.EXPOSURES):
                Image.fromarray(room.codes(seen, seconds)).save(root / split / f"r_{number}_{k}.png")
                exposures[f"./{split}/r_{number}_{k}.png"] = seconds
            frames.append({"file_path": f"./{split}/r_{number}", "transform_matrix": matrix_of(pose)})
        angle = 2.0 * math.atan(0.5 * SIZE[0] / FOCAL)
        transforms = {"camera_angle_x": angle, "frames": frames}
        (root / f"transforms_{split}.json").write_text(json.dumps(transforms))
        (root / f"exposure_{split}.json").write_text(json.dumps(exposures))
    return root


@pytest.fixture(scope="module")
def with_points(made, tmp_path_factory):
    """Points of the room where nothing that training must not see can be decoded."""
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    spoiled = shutil.copytree(made, tmp_path_factory.mktemp("spoiled") / "data")
    unseen = [*spoiled.glob("test/*.png"), *spoiled.glob("train/r_?_1.png")]
    assert len(unseen) == 6 + VIEWS
    for path in unseen:
        raw = path.read_bytes()
        path.write_bytes(raw[:200] + bytes(len(raw) - 200))  # a header, which readers look at, and no picture
    assert triangulate(spoiled) == 0
    return spoiled


def triangulate(*words):
    return tyro.cli(Prepare, args=[str(word) for word in (*words, "--triangulate", "--threads", 1)]).run()


def refused(*words):
    """A call that must fail; its message, which names a remedy."""
    with pytest.raises(PhysHDRError) as caught:
        triangulate(*words)
    assert caught.value.hint
    return str(caught.value)


def distances(room, positions):
    """From each of ``positions`` ``[P, 3]`` to the nearest surface of the room and of what stands in it."""
    nearest = []
    for low, high in room.BOXES:
        middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
        beyond = np.abs(positions - middle) - half
        outside = np.linalg.norm(beyond.clip(min=0.0), axis=1)
        nearest.append(np.where(outside > 0.0, outside, -beyond.max(axis=1)))
    return np.min(nearest, axis=0)


def test_points_lie_on_the_surfaces_where_the_cameras_are(room, with_points):
    points = read_points(with_points / SFM)
    away = distances(room, points.positions)
    assert len(away) > 500 and np.median(away) < 0.01 and np.mean(away < 0.05) > 0.9
    assert points.origin == STRUCTURE_FROM_MOTION
    first, _, third = (np.array(box) for box in room.BOXES[:3])  # not on one wall alone
    on_wall = np.abs(points.positions[:, 0] - first[1, 0]) < 0.05
    on_box = (points.positions > third[0] - 0.05).all(1) & (points.positions < third[1] + 0.05).all(1)
    assert on_wall.sum() > 20 and on_box.sum() > 20


def test_colours_are_those_of_the_middle_exposure_that_training_sees(room, with_points):
    points = read_points(with_points / SFM)
    pose = room.arc(VIEWS + 2)[3]
    in_camera = points.positions @ pose[:, :3].T + pose[:, 3]
    x, y = (FOCAL * in_camera[:, :2] / in_camera[:, 2:] + np.array(SIZE) / 2).T
    inside = (x > 0) & (x < SIZE[0] - 1) & (y > 0) & (y < SIZE[1] - 1)
    codes = 255.0 * points.colours[inside]
    away = []
    for k in (0, 2):
        shown = np.asarray(Image.open(with_points / f"train/r_3_{k}.png"))[
            y[inside].astype(int), x[inside].astype(int)
        ]
        away.append(np.median(np.abs(codes - shown)))
    assert inside.sum() > 200 and away[1] < 12.0 < 40.0 < away[0]


def test_the_file_says_what_it_is(with_points):
    ply = open_ply(with_points / SFM, "point cloud", "")
    assert f"from {2 * VIEWS} pictures of {VIEWS} training views" in ply.comments[0]
    vertex = ply.elements["vertex"]
    assert vertex["views"].min() >= 2 and vertex["views"].max() <= VIEWS
    assert 0.0 < vertex["error"].mean() < 1.0
    assert not any(vertex[axis].any() for axis in ("nx", "ny", "nz"))  # without them 3DGS's loader fails


@pytest.mark.long
def test_nothing_but_the_pictures_of_training_is_read(made, with_points, tmp_path):
    """The same points, byte for byte, where all that training must not see can be decoded, too."""
    assert triangulate(made, "--out", tmp_path / "other.ply") == 0
    assert (tmp_path / "other.ply").read_bytes() == (with_points / SFM).read_bytes()


def test_training_starts_from_them(with_points):
    count = len(read_points(with_points / SFM).positions)
    scene = read_scene(with_points)
    state = begin(scene, TrainConfig(points_file=SFM, initial_points="file"))
    assert len(state.method.gaussians) == count
    points, response = state.start_message.split(", the response ")
    assert points == f"{count:,} points of {SFM} ({STRUCTURE_FROM_MOTION})"
    assert response == "as brackets tell it"


@pytest.mark.long
def test_cameras_may_differ_from_picture_to_picture(room, tmp_path):
    """nerfstudio's layout, one exposure a view, every second one by a longer lens."""
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    frames = []
    for number, pose in enumerate(room.arc(6)):
        focal = FOCAL if number % 2 else 1.2 * FOCAL
        codes = room.codes(photograph(room, pose, focal), 0.5)
        Image.fromarray(codes).save(tmp_path / f"frame_train_{number}.png")
        frame = {"file_path": f"frame_train_{number}.png", "transform_matrix": matrix_of(pose)}
        frames.append({**frame, "fl_x": focal, "w": SIZE[0], "h": SIZE[1]})
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    assert triangulate(tmp_path) == 0
    away = distances(room, read_points(tmp_path / SFM).positions)
    assert len(away) > 300 and np.median(away) < 0.01 and np.mean(away < 0.05) > 0.9


@pytest.mark.long
def test_all_exposures_of_photographs_are_seen(made, tmp_path):
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    out, data = tmp_path / "points.ply", tmp_path / "data"
    shutil.copytree(made, data, ignore=shutil.ignore_patterns("*.ply"))
    (data / CAPTURE_FILE).write_text(json.dumps({"format": CAPTURE_FORMAT, "version": 1}))
    assert triangulate(data, "--out", out) == 0
    assert f"from {3 * VIEWS} pictures" in open_ply(out, "point cloud", "").comments[0]


@pytest.mark.long
def test_nothing_is_looked_for_where_pictures_are_masked(room, tmp_path):
    """The lower half of each is: a point that only lies there in all but one view cannot be found."""
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    frames = []
    Image.fromarray((np.arange(SIZE[1]) < SIZE[1] // 2)[:, None] & np.ones(SIZE[0], bool)).save(
        tmp_path / "upper.png"
    )
    poses = list(room.arc(6))
    for number, pose in enumerate(poses):
        Image.fromarray(room.codes(photograph(room, pose), 0.5)).save(tmp_path / f"frame_train_{number}.png")
        frames.append({"file_path": f"frame_train_{number}.png", "transform_matrix": matrix_of(pose)})
    whole = {"fl_x": FOCAL, "w": SIZE[0], "h": SIZE[1]}

    def lower_in_all_but_one(masked):
        listed = [{**frame, "mask_path": "upper.png"} for frame in frames] if masked else frames
        (tmp_path / "transforms.json").write_text(json.dumps({**whole, "frames": listed}))
        out = tmp_path / f"points_{masked}.ply"
        assert triangulate(tmp_path, "--out", out) == 0
        points = read_points(out).positions
        seen = [points @ pose[:, :3].T + pose[:, 3] for pose in poses]
        upper = np.sum([FOCAL * each[:, 1] / each[:, 2] < 1.0 for each in seen], axis=0)
        return np.count_nonzero(upper < 2), len(points)

    assert lower_in_all_but_one(masked=False)[0] > 50
    lower, found = lower_in_all_but_one(masked=True)
    assert lower == 0 and found > 100


# ---- what can go wrong -----------------------------------------------------------------------------------


@pytest.mark.long
def test_points_that_are_there_are_replaced_if_they_are_ours_and_one_says_so(with_points, tmp_path):
    assert "points3d_sfm.ply already exists" in refused(with_points)
    other = tmp_path / "scan.ply"
    other.write_bytes(
        (with_points / SFM).read_bytes().replace(b"structure from motion", b"structure from a scan")
    )
    before = other.read_bytes()
    assert "was not made by 'physhdr prepare --triangulate'" in refused(
        with_points, "--out", other, "--overwrite"
    )
    assert other.read_bytes() == before
    ours = tmp_path / "ours.ply"
    ours.write_bytes((with_points / SFM).read_bytes()[:-50] + bytes(50))
    assert triangulate(with_points, "--out", ours, "--overwrite") == 0
    assert ours.read_bytes() == (with_points / SFM).read_bytes()


def test_a_place_that_cannot_be_written_is_told_before_anything_is_matched(made, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "physhdr.backend.cli.triangulate.read_scene", lambda *_, **__: pytest.fail("too late")
    )
    (tmp_path / "file").write_text("in the way")
    assert "cannot write to" in refused(made, "--out", tmp_path / "file" / "points.ply")


def test_without_pycolmap_it_says_how_to_install_it(made, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    told = refused(made, "--out", made / "never.ply")
    assert "pip install pycolmap" in told and "physhdr prepare --triangulate" in told


def test_pictures_without_texture(made, tmp_path):
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    data = tmp_path / "data"
    shutil.copytree(made, data, ignore=shutil.ignore_patterns("*.ply"))
    for path in data.glob("train/*.png"):
        Image.new("RGB", SIZE, (90, 90, 90)).save(path)
    told = refused(data)
    assert f"COLMAP found 0 points in {2 * VIEWS} pictures of {VIEWS} training views" in told
    assert "--initial-points stereo" in told and not (data / SFM).exists()


def test_one_view(made, tmp_path):
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    data = tmp_path / "data"
    shutil.copytree(made, data, ignore=shutil.ignore_patterns("*.ply"))
    transforms = json.loads((data / "transforms_train.json").read_text())
    transforms["frames"] = transforms["frames"][:1]
    (data / "transforms_train.json").write_text(json.dumps(transforms))
    assert "1 training view" in refused(data)


def test_exposures_that_the_data_have_not(made):
    pytest.importorskip("pycolmap", reason="points are triangulated by pycolmap")
    assert "training wants [7]" in refused(made, "--out", made / "never.ply", "--training-exposures", 7)


def test_each_picture_is_matched_with_the_nearest_of_its_own_step(monkeypatch):
    """Thirty views along a line that take turns with two exposures: none is starved by the other's."""
    from physhdr.backend.scene.capture import triangulate as module

    monkeypatch.setattr(module, "NEIGHBOURS", 3)
    views = [SimpleNamespace(camera=SimpleNamespace(position=np.array([k, 0.0, 0.0]))) for k in range(30)]
    shown = [(k, k % 2) for k in range(30)]
    pairs = module._pairs(views, shown)
    assert all(a < b and a % 2 == b % 2 for a, b in pairs) and len(set(pairs)) == len(pairs)
    matched = {k: [a + b - k for a, b in pairs if k in (a, b)] for k in range(30)}
    assert all(len(others) >= 3 for others in matched.values())
    assert {10, 14} <= set(matched[12]) and max(
        abs(k - other) for k in range(30) for other in matched[k]
    ) <= 6
