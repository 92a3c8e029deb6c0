# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set's cameras in Blender: where they see points, against a pinhole in float64, and that they go
along when the scale and the ground of their capture are set."""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import similarity  # noqa: E402
from physhdr.addon.capture import dataset_cameras, placement  # noqa: E402
from physhdr.addon.layouts import cameras  # noqa: E402
from physhdr.addon.model import origin  # noqa: E402
from physhdr.addon.operators.base import done_in  # noqa: E402
from physhdr.addon.session.advice import IMPORTED, SEEN, SET_UP, SHARED  # noqa: E402
from physhdr.addon.viewport import framing  # noqa: E402
from physhdr.bridge.camera_list import ListedCamera, write_camera_list  # noqa: E402
from physhdr.bridge.errors import FileDamagedError, FileMissingError, PhysHDRError  # noqa: E402
from physhdr.bridge.model_file import read_model, write_model  # noqa: E402

WIDTH, HEIGHT = 120, 90
#: Pixels: Blender's matrices, lenses and shifts are float32.
CLOSE = 2e-3


@pytest.fixture
def run(tmp_path, make_model) -> Path:
    """A run's folder, whose data set is the empty folder beside it."""
    for name in ("run", "data"):
        (tmp_path / name).mkdir()
    write_model(tmp_path / "run/model.safetensors", make_model(count=10))
    config = {"config": {}, "preset": "default", "data": str(tmp_path / "data")}
    (tmp_path / "run/config.json").write_text(json.dumps(config))
    return tmp_path / "run"


def load(run: Path):
    bpy.ops.physhdr.model_import(filepath=str(run / "model.safetensors"), name="room")
    return bpy.data.objects["room"]


def poses(count: int, seed: int = 0) -> np.ndarray:
    """``[N, 4, 4]``: rigid, anywhere, any way up."""
    rng = np.random.default_rng(seed)
    made = np.tile(np.eye(4), (count, 1, 1))
    for pose in made:
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
        pose[:3, 3] = rng.uniform(-3.0, 3.0, 3)
    return made


def png(path: Path, width: int, height: int) -> None:
    """The head of a PNG, which is all that is read."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", width, height) + bytes(8))


def of_ours(data: Path, angle: float = 0.9) -> dict[str, np.ndarray]:
    """A data set of our layout: the pose of each frame."""
    expected = {}
    for split, seed, count in (("train", 1, 3), ("test", 2, 2)):
        matrices = poses(count, seed)
        names = [f"{split}/r_{index}" for index in range(count)]
        frames = [
            {"file_path": f"./{name}", "transform_matrix": matrix.tolist()}
            for name, matrix in zip(names, matrices, strict=True)
        ]
        content = {"camera_angle_x": angle, "frames": frames}
        (data / f"transforms_{split}.json").write_text(json.dumps(content))
        exposures = {f"./{name}_0.png": 1.0 for name in names}
        (data / f"exposure_{split}.json").write_text(json.dumps(exposures))
        for name in names:
            png(data / f"{name}_0.png", WIDTH, HEIGHT)
        expected |= dict(zip(names, matrices, strict=True))
    return expected


def projected(pose: np.ndarray, lens: tuple[float, float, float, float], points: np.ndarray) -> np.ndarray:
    """``[N, 2]`` pixels, x right, y down, of world points: a pinhole in float64."""
    fx, fy, cx, cy = lens
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
    return np.column_stack([cx + fx * x / -z, cy - fy * y / -z])


def seen(scene, camera, points: np.ndarray) -> np.ndarray:
    """``[N, 2]`` pixels of world points in a render of the scene: by Blender's own matrices."""
    bpy.context.view_layer.update()
    render = scene.render
    window = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=render.resolution_x,
        y=render.resolution_y,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    view = np.array(camera.matrix_world.normalized().inverted(), float)
    clip = np.column_stack([points, np.ones(len(points))]) @ (np.array(window, float) @ view).T
    ndc = clip[:, :2] / clip[:, 3:]
    return (ndc * [1.0, -1.0] + 1.0) * 0.5 * [render.resolution_x, render.resolution_y]


def in_front(pose: np.ndarray) -> np.ndarray:
    """``[N, 3]``: points before a camera, some beyond the picture's rim."""
    rng = np.random.default_rng(3)
    local = np.column_stack([rng.uniform(-1, 1, (40, 2)), -np.ones(40)]) * rng.uniform(1, 6, (40, 1))
    return local @ pose[:3, :3].T + pose[:3, 3]


def assert_sees(scene, camera, pose, lens) -> None:
    points = in_front(pose)
    np.testing.assert_allclose(seen(scene, camera, points), projected(pose, lens, points), atol=CLOSE)


def test_cameras_of_our_layout_see_as_the_pinhole_does(registered, run):
    expected = of_ours(run.parent / "data")
    load(run)
    assert bpy.ops.physhdr.cameras_import() == {"FINISHED"}
    registered.render.resolution_x, registered.render.resolution_y = WIDTH, HEIGHT
    cameras = {camera.name: camera for camera in registered.objects if camera.type == "CAMERA"}
    assert set(cameras) == set(expected)
    focal = 0.5 * WIDTH / math.tan(0.45)
    for name, pose in expected.items():
        assert_sees(registered, cameras[name], pose, (focal, focal, WIDTH / 2, HEIGHT / 2))
    folders = {camera.users_collection[0].name for camera in cameras.values()}
    assert folders == {"Cameras of data: train", "Cameras of data: test"}
    assert registered.camera is cameras["test/r_0"]  # there was none


@pytest.fixture
def alone(registered, run, make_model):
    """A model whose data set nobody has, with two cameras in its file; with their poses by name."""
    lens = (100.0, 110.0, 55.0, 48.0)
    named = dict(zip(("train_000", "train_001"), poses(2, seed=7), strict=True))
    cameras = tuple(ListedCamera(name, pose, WIDTH, HEIGHT, *lens) for name, pose in named.items())
    (run / "config.json").unlink()
    path = run / "model.safetensors"
    path.unlink()
    write_model(path, dataclasses.replace(make_model(count=10), cameras=cameras))
    return load(run), named, lens


def test_a_model_alone_brings_its_cameras(registered, alone):
    _, named, lens = alone
    assert bpy.ops.physhdr.cameras_import() == {"FINISHED"}
    registered.render.resolution_x, registered.render.resolution_y = WIDTH, HEIGHT
    registered.render.pixel_aspect_y, registered.render.pixel_aspect_x = 1.0, 1.1
    dataset_cameras.take_size(registered, bpy.data.objects["train_000"])
    for name, pose in named.items():
        assert_sees(registered, bpy.data.objects[name], pose, lens)


def test_they_are_in_the_file_that_it_is_saved_in(registered, alone, tmp_path):
    """Where it stood in the scene, too: they move along."""
    target, named, _ = alone
    target.location.x, target.scale = 3.0, (2.0, 2.0, 2.0)
    for name, apply in (("plain.safetensors", False), ("world.safetensors", True)):
        path = tmp_path / name
        bpy.ops.physhdr.model_save(filepath=str(path), apply_transform=apply)
        for each in read_model(path).cameras:
            expected = named[each.name][:3, 3]
            expected = 2.0 * expected + (3.0, 0.0, 0.0) if apply else expected
            np.testing.assert_allclose(each.camera_to_world[:3, 3], expected, atol=1e-5)


def test_one_looks_through_one_camera_after_the_other(registered, alone):
    look = bpy.ops.physhdr.look_through
    seen = []
    for step in (0, 1, 1, -1, 0):
        assert look(step=step) == {"FINISHED"}
        seen.append(registered.camera.name)
    assert seen == ["train_000", "train_001", "train_000", "train_001", "train_001"]


def test_the_panel_knows_what_was_done_with_a_model(registered, alone):
    """Each step is known once it is done, whatever order they are done in."""
    assert done_in(registered, "") == {IMPORTED, SHARED}  # a page would be of a run
    bpy.ops.physhdr.look_through(step=0)
    assert done_in(registered, "") == {IMPORTED, SEEN, SHARED}
    bpy.ops.physhdr.render_setup()
    assert done_in(registered, "") == {IMPORTED, SEEN, SET_UP, SHARED}
    bpy.data.objects.remove(alone[0])
    assert done_in(registered, "") == frozenset()


def test_a_view_takes_the_place_of_a_camera_and_shows_its_whole_picture(registered, alone):
    """By Blender's own matrices: the picture's corners are in the view, the nearer pair at its rim."""
    target, named, (fx, fy, _, _) = alone
    place = dataset_cameras.first_place(target)
    np.testing.assert_allclose(place.camera_to_world, named["train_000"], atol=1e-5)
    for width, height in ((800, 300), (300, 800), (500, 500)):
        lens = framing.lens_of(place, width, height)
        half = 36.0 / lens  # of the larger side, at a metre
        across, up = (half, half * height / width) if width >= height else (half * width / height, half)
        reach = 0.5 * WIDTH / fx / across, 0.5 * HEIGHT / fy / up
        assert max(reach) == pytest.approx(1.0)


def test_the_scenes_own_camera_stays_unless_it_is_asked_otherwise(registered, run, look_at):
    of_ours(run.parent / "data")
    load(run)
    own = bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    registered.collection.objects.link(own)
    registered.camera = own
    bpy.ops.physhdr.cameras_import()
    assert registered.camera is own
    bpy.ops.physhdr.cameras_import(look_through=True)
    assert registered.camera.name == "test/r_0"


LENSES = [
    {"fl_x": 100.0, "cx": 60.0, "cy": 45.0},
    {"fl_x": 100.0, "cx": 48.5, "cy": 61.25},
    {"fl_x": 100.0, "fl_y": 130.0, "cx": 70.0, "cy": 30.0},
    {"fl_x": 130.0, "fl_y": 100.0, "cx": 70.0, "cy": 30.0},
]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (HEIGHT, WIDTH)])
def test_focal_lengths_and_principal_points_of_nerfstudio(registered, run, lens, size):
    pose = poses(1)[0]
    frame = {"file_path": "images/a.jpg", "transform_matrix": pose.tolist(), **lens}
    content = {"w": size[0], "h": size[1], "frames": [frame]}
    (run.parent / "data/transforms.json").write_text(json.dumps(content))
    load(run)
    before = registered.render.resolution_x, registered.render.resolution_y
    bpy.ops.physhdr.cameras_import()
    bpy.ops.physhdr.render_setup(camera="images/a")
    assert (registered.render.resolution_x, registered.render.resolution_y) == before
    bpy.ops.physhdr.render_setup(camera="images/a", use_size=True)
    assert (registered.render.resolution_x, registered.render.resolution_y) == size
    expected = (lens["fl_x"], lens.get("fl_y", lens["fl_x"]), lens["cx"], lens["cy"])
    assert_sees(registered, bpy.data.objects["images/a"], pose, expected)


def test_cameras_of_colmap_one_a_bracket(registered, run):
    """Text files, OpenCV's axes, quaternions; of a bracket the picture that shows the most points."""
    data = run.parent / "data"
    (data / "sparse/0").mkdir(parents=True)
    (data / "images").mkdir()
    matrices = poses(3, seed=7)
    names = ["test_a_0.png", "train_b_0.png", "train_b_1.png"]
    lines = ["# pictures"]
    for number, (name, pose, points) in enumerate(zip(names, matrices, (1, 1, 2), strict=True)):
        to_camera = np.linalg.inv(pose @ np.diag([1.0, -1.0, -1.0, 1.0]))
        w, x, y, z = quaternion(to_camera[:3, :3])
        tx, ty, tz = to_camera[:3, 3]
        lines.append(f"{number} {w} {x} {y} {z} {tx} {ty} {tz} 1 {name}")
        lines.append(" ".join(["1.0 1.0 5"] * points))
    (data / "sparse/0/images.txt").write_text("\n".join(lines) + "\n")
    (data / "sparse/0/cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} 100 100 55 50\n")
    (data / "exposure.json").write_text(json.dumps({name: 1.0 for name in names}))
    load(run)
    bpy.ops.physhdr.cameras_import()
    registered.render.resolution_x, registered.render.resolution_y = WIDTH, HEIGHT
    cameras = {camera.name: camera for camera in registered.objects if camera.type == "CAMERA"}
    assert set(cameras) == {"test_a", "train_b"}
    for name, pose in (("test_a", matrices[0]), ("train_b", matrices[2])):
        assert_sees(registered, cameras[name], pose, (100.0, 100.0, 55.0, 50.0))
        assert cameras[name][dataset_cameras.SPLIT] == name[:-2]


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz: the eigenvector of Bar-Itzhack's matrix, exact for rotations."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = [
        [a - e - i, 0, 0, 0],
        [d + b, e - a - i, 0, 0],
        [g + c, h + f, i - a - e, 0],
        [h - f, c - g, d - b, a + e + i],
    ]
    x, y, z, w = np.linalg.eigh(np.array(matrix) / 3.0)[1][:, -1]
    return np.array([w, x, y, z])


def test_cameras_stand_where_training_has_found_them(registered, run):
    """Those that ``cameras.json`` has so; the others, and all without it, where the data set says."""
    expected = of_ours(run.parent / "data")
    moved = dict(zip(("train/r_0", "train/r_1"), poses(2, seed=9), strict=True))
    size = (WIDTH, HEIGHT, 100.0, 100.0, WIDTH / 2, HEIGHT / 2)
    listed = [ListedCamera(name, pose, *size, is_learned=True) for name, pose in moved.items()]
    listed.append(ListedCamera("test/r_0", poses(1, seed=3)[0], *size, is_learned=False))
    write_camera_list(run / "cameras.json", listed)
    target = load(run)
    imported = dataset_cameras.import_cameras(registered, target)
    assert imported.notes == (
        f"2 of {len(expected)} stand where training has found their pictures to be taken from.",
    )
    for name, pose in {**expected, **moved}.items():
        found = np.array(bpy.data.objects[name].matrix_world, float)
        np.testing.assert_allclose(found, pose, atol=1e-5)
    assert bpy.data.objects["train/r_1"].data.angle == pytest.approx(0.9)  # the data set's lens
    write_camera_list(
        run / "cameras.json", [ListedCamera("train/r", moved["train/r_0"], *size, is_learned=True)]
    )
    assert dataset_cameras.import_cameras(registered, target).notes[0].startswith("3 of"), (
        "a bracket's pictures"
    )
    (run / "cameras.json").unlink()
    assert dataset_cameras.import_cameras(registered, target).notes == ()
    for name, pose in expected.items():
        found = np.array(bpy.data.objects[name].matrix_world, float)
        np.testing.assert_allclose(found, pose, atol=1e-5)


def test_damaged_learned_cameras_make_nothing_and_say_what_to_do(registered, run):
    of_ours(run.parent / "data")
    (run / "cameras.json").write_text('[{"pose": "learned", "img_name": "train/r_0"}]')
    target, before = load(run), len(bpy.data.objects)
    with pytest.raises(FileDamagedError, match="camera train/r_0: position") as caught:
        dataset_cameras.import_cameras(registered, target)
    assert "Delete it" in caught.value.hint and len(bpy.data.objects) == before


def test_importing_twice_puts_back_and_duplicates_nothing(registered, run):
    expected = of_ours(run.parent / "data")
    load(run)
    bpy.ops.physhdr.cameras_import()
    count, folders = len(bpy.data.objects), len(bpy.data.collections)
    moved = bpy.data.objects["train/r_1"]
    moved.location.x += 1.0
    moved.data.lens = 300.0
    bpy.ops.physhdr.cameras_import()
    assert (len(bpy.data.objects), len(bpy.data.collections)) == (count, folders)
    np.testing.assert_allclose(np.array(moved.matrix_world), expected["train/r_1"], atol=1e-5)
    assert moved.data.angle == pytest.approx(0.9)


def test_cameras_go_along_with_scale_and_ground_and_back(registered, run):
    """What a camera sees of the capture never changes: points that move with it stay in their pixels."""
    expected = of_ours(run.parent / "data")
    target = load(run)
    bpy.ops.physhdr.cameras_import()
    registered.render.resolution_x, registered.render.resolution_y = WIDTH, HEIGHT
    camera, pose = bpy.data.objects["test/r_1"], expected["test/r_1"]
    points = in_front(pose)
    before = seen(registered, camera, points)
    bpy.context.view_layer.objects.active = target
    bpy.ops.physhdr.capture_scale(first=(0.0, 0.0, 0.0), second=(1.0, 0.0, 0.0), distance=2.7)
    bpy.ops.physhdr.capture_floor(first=(0.0, 0.0, 0.2), second=(3.0, 0.0, 0.0), third=(0.0, 3.0, 1.0))
    stands = np.array(target.matrix_world, float)
    assert similarity.scale_of(stands) == pytest.approx(2.7)
    np.testing.assert_allclose(seen(registered, camera, similarity.apply(stands, points)), before, atol=0.01)
    assert np.allclose(camera.matrix_world.to_scale(), 1.0, atol=1e-5)  # a camera has no size
    bpy.ops.physhdr.capture_reset()
    np.testing.assert_allclose(np.array(camera.matrix_world), pose, atol=1e-5)
    np.testing.assert_allclose(np.array(target.matrix_world), np.eye(4), atol=1e-6)


def test_cameras_come_in_where_the_model_stands(registered, run):
    """After it was scaled, or moved by hand."""
    expected = of_ours(run.parent / "data")
    target = load(run)
    target.location, target.scale, target.rotation_euler.z = (1.0, 2.0, 3.0), (0.5,) * 3, 0.7
    bpy.ops.physhdr.cameras_import()
    stands = np.array(target.matrix_world, float)
    for name, pose in expected.items():
        whole = stands @ pose
        found = np.array(bpy.data.objects[name].matrix_world, float)
        np.testing.assert_allclose(found[:3, 3], whole[:3, 3], atol=1e-5)
        np.testing.assert_allclose(found[:3, :3], whole[:3, :3] / 0.5, atol=1e-5)


def test_a_data_set_that_is_gone_says_what_to_do_and_one_that_moved_is_chosen(registered, run):
    data = run.parent / "data"
    of_ours(data)
    target = load(run)
    data.rename(run.parent / "moved")
    with pytest.raises(FileMissingError, match="is not there") as error:
        dataset_cameras.import_cameras(registered, target)
    assert error.value.hint
    with pytest.raises(RuntimeError, match="is not there"):
        bpy.ops.physhdr.cameras_import()
    assert not any(each.type == "CAMERA" for each in registered.objects)
    assert bpy.ops.physhdr.cameras_import(directory=str(run.parent / "moved")) == {"FINISHED"}
    assert len(list(placement.cameras_of(registered, origin.capture_of(target)))) == 5


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("transforms.json", {"frames": []}),
        ("transforms.json", {"frames": [{"transform_matrix": [[1.0]]}], "w": 8, "h": 8, "fl_x": 9.0}),
        ("transforms.json", {"frames": [{"transform_matrix": np.eye(4).tolist()}], "w": 8, "h": 8}),
        (
            "transforms.json",
            {"frames": [{"transform_matrix": np.eye(4).tolist()}], "w": 0, "h": 8, "fl_x": 9.0},
        ),
        ("transforms.json", {"frames": [{"transform_matrix": np.eye(4).tolist()}], "fl_x": 9.0}),
        ("transforms.json", {"frames": [{"transform_matrix": (2 * np.eye(4)).tolist()}], "w": 8, "h": 8}),
        ("transforms_train.json", {"frames": [{"transform_matrix": np.eye(4).tolist()}]}),
        ("nothing.json", {}),
    ],
)
def test_a_damaged_data_set_makes_nothing_and_says_what_to_do(registered, run, file, content):
    (run.parent / "data" / file).write_text(json.dumps(content))
    target = load(run)
    count = len(bpy.data.objects)
    with pytest.raises(PhysHDRError) as error:
        dataset_cameras.import_cameras(registered, target)
    assert error.value.hint
    assert len(bpy.data.objects) == count


def test_what_a_camera_cannot_show_is_told(run):
    pose = np.eye(4).tolist()
    frames = [
        {"file_path": "a.png", "transform_matrix": pose},
        {"file_path": "b.png", "transform_matrix": pose},
    ]
    content = {"w": 8, "h": 8, "fl_x": 9.0, "k1": 0.1, "frames": frames, "train_filenames": ["a.png"]}
    path = run.parent / "data/transforms.json"
    path.write_text(json.dumps(content))
    found = cameras.read_frames(path.parent)
    assert [frame.split for frame in found.frames] == ["train", "views"]
    assert len(found.notes) == 1 and "bends" in found.notes[0]


def test_without_a_list_of_training_views_frames_in_no_list_are_those(run):
    frames = [{"file_path": f"{name}.png", "transform_matrix": np.eye(4).tolist()} for name in "ab"]
    content = {"w": 8, "h": 8, "fl_x": 9.0, "frames": frames, "test_filenames": ["a.png"]}
    path = run.parent / "data/transforms.json"
    path.write_text(json.dumps(content))
    assert [frame.split for frame in cameras.read_frames(path.parent).frames] == ["test", "train"]


def test_set_up_render_names_a_camera_that_is_none(registered, run):
    load(run)
    with pytest.raises(RuntimeError, match="not a camera of this scene"):
        bpy.ops.physhdr.render_setup(camera="room")
    with pytest.raises(RuntimeError, match="there is no camera"):
        bpy.ops.physhdr.render_setup(use_size=True)
