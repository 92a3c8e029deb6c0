# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says of captures: COLMAP's folders, ``prepare``'s, ``transforms.json``, LLFF.

No Blender: the folders are written here, by hand, and read by COLMAP's own bindings where those are there.
"""

import json
import math
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from physhdr.addon.layouts.cameras import camera_places, read_frames
from physhdr.addon.layouts.summary import summarise
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.light_groups import LightGroup, LightGroups, write_light_groups

#: Where cameras stand, metres; each is turned by its own angle about an axis of its own.
PLACES = np.array([[0.5, -2.0, 1.5], [1.0, -1.5, 1.25], [-1.0, 2.0, 1.75], [3.0, 0.25, 1.5]])


def png(width: int, height: int) -> bytes:
    """A black picture as any program writes it."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes((1 + 3 * width) * height))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def jpeg_head(width: int, height: int) -> bytes:
    """The segments of a JPEG up to its frame, with EXIF's place before it (ITU-T T.81, B.2)."""
    exif = b"\xff\xe1" + struct.pack(">H", 2 + 500) + bytes(500)
    return b"\xff\xd8" + exif + b"\xff\xc0" + struct.pack(">HBHHB", 8, 8, height, width, 3) + bytes(9)


def rotation(index: int) -> tuple[np.ndarray, np.ndarray]:
    """A quaternion (wxyz) and its matrix, by Rodrigues' formula."""
    axis = np.array([1.0, index, -0.5])
    axis /= np.linalg.norm(axis)
    angle = 0.3 + 0.9 * index
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    matrix = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)]), matrix


def sparse(root: Path, names: list[str], binary: bool) -> None:
    """COLMAP's model of pictures at ``PLACES``, each with two keypoints, and one point."""
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    poses = []
    for index, place in enumerate(PLACES[: len(names)]):
        quaternion, matrix = rotation(index)
        poses.append([*quaternion, *(-matrix @ place)])
    if not binary:
        told = [
            f"{k} {' '.join(map(repr, map(float, pose)))} 1 {name}\n1 2 -1 3 4 1"
            for k, (pose, name) in enumerate(zip(poses, names, strict=True), 1)
        ]
        (folder / "images.txt").write_text("# comment\n" + "\n".join(told) + "\n")
        (folder / "cameras.txt").write_text("1 PINHOLE 60 40 50 50 30 20\n")
        (folder / "points3D.txt").write_text("# comment\n1 0 0 0 9 9 9 0.5 1 1\n")
        return
    content = struct.pack("<Q", len(names))
    for k, (pose, name) in enumerate(zip(poses, names, strict=True), 1):
        content += struct.pack("<i7di", k, *pose, 1) + name.encode() + b"\0" + struct.pack("<Q", 2)
        content += struct.pack("<ddq", 1.0, 2.0, -1) + struct.pack("<ddq", 3.0, 4.0, 1)
    (folder / "images.bin").write_bytes(content)
    camera = struct.pack("<QiiQQ", 1, 1, 1, 60, 40) + struct.pack("<4d", 50, 50, 30, 20)
    (folder / "cameras.bin").write_bytes(camera)
    point = struct.pack("<QQ3d3BdQ", 1, 1, 0, 0, 0, 9, 9, 9, 0.5, 1) + struct.pack("<ii", 1, 1)
    (folder / "points3D.bin").write_bytes(point)


@pytest.fixture
def prepared(tmp_path):
    """As ``physhdr prepare`` writes it: four places, one for the test, three exposures each."""
    (tmp_path / "images").mkdir()
    stems = ["train_000", "train_001", "test_002", "train_003"]
    seconds = {f"{stem}_{2 * k}.png": 4.0**k / 60 for stem in stems for k in range(3)}
    for name in seconds:
        (tmp_path / "images" / name).write_bytes(png(6, 4))
    (tmp_path / "exposure.json").write_text(json.dumps(seconds))
    (tmp_path / "prepare.json").write_text(json.dumps({"format": "physhdr-capture", "version": 1}))
    sparse(tmp_path, [f"{stem}_2.png" for stem in stems], binary=True)
    return tmp_path


@pytest.fixture
def transforms(tmp_path):
    """instant-ngp's form: names without folder's dot, JPEG, a frame whose picture is missing."""
    (tmp_path / "images").mkdir()
    frames = []
    for index, place in enumerate(PLACES):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation(index)[1], place
        frames.append({"file_path": f"./images/{index:04d}.jpg", "transform_matrix": pose.tolist()})
        if index < 3:
            (tmp_path / f"images/{index:04d}.jpg").write_bytes(jpeg_head(1080, 1920))
    content = {"camera_angle_x": 0.9, "k1": 0.06, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path


def test_a_prepared_capture(prepared):
    found = summarise(prepared)
    assert found.lines == [
        f"{prepared.name}: 3 training views, 1 test, 6 × 4",
        "3 exposures: EV -5.91, -3.91, -1.91",  # log2 of 1/60, 4/60, 16/60
        "Dynamic range: 4.0 stops (between the shortest and the longest exposure)",
        "Starts from 1 points",
    ]
    assert not found.warnings and found.layout == "photographs"
    np.testing.assert_allclose(camera_places(prepared), PLACES[[2, 0, 1, 3]], atol=1e-12)
    (prepared / "images/train_003_4.png").unlink()
    assert "Pictures are missing (1): train_003_4.png" in summarise(prepared).warnings[0]


def test_which_lights_of_a_capture_can_be_turned(prepared):
    off = LightGroup("pendant off", {"pendant": 0.0}, ("train_001", "test_002"))
    dim = LightGroup("lamps dim", {"lamp": None, "desk": None}, ("train_003_0.png",))
    lights = ("ambient", "pendant", "lamp", "desk")
    write_light_groups(prepared, LightGroups(lights, (off, dim)))
    found = summarise(prepared)
    assert found.views == {"train": 1, "lit": 3} and "1 training views, 0 test, 3 under" in found.lines[0]
    assert found.lines[-1] == "pendant can be turned afterwards: off from 2 views"
    assert any(each.startswith("Lamp and desk always change together") for each in found.warnings)
    (prepared / "lights.json").write_text("{}")
    with pytest.raises(BadValueError, match="physhdr-lights"):
        summarise(prepared)


@pytest.mark.parametrize("binary", [True, False])
def test_a_folder_of_colmap(tmp_path, binary):
    names = [f"folder/view{k}.jpg" for k in range(4)]
    (tmp_path / "images/folder").mkdir(parents=True)
    for name in names:
        (tmp_path / "images" / name).write_bytes(jpeg_head(60, 40))
    sparse(tmp_path, names, binary)
    found = summarise(tmp_path)
    assert found.lines == [f"{tmp_path.name}: 4 views, 60 × 40, COLMAP", "Starts from 1 points"]
    assert not found.warnings  # exposures may be in EXIF, which the trainer reads
    np.testing.assert_allclose(camera_places(tmp_path), PLACES, atol=1e-12)
    pycolmap = pytest.importorskip("pycolmap", reason="COLMAP itself is asked for the cameras' places")
    theirs = pycolmap.Reconstruction(str(tmp_path / "sparse" / "0"))
    by_name = {image.name: image.projection_center() for image in theirs.images.values()}
    np.testing.assert_allclose(camera_places(tmp_path), [by_name[name] for name in names], atol=1e-12)


@pytest.mark.parametrize(
    ("camera", "is_told"),
    [
        ("PINHOLE 60 40 50 50 30 20", False),
        ("OPENCV 60 40 50 50 30 20 0 0 0 0", False),
        ("OPENCV 60 40 50 50 30 20 0.1 0 0 0", True),
        ("SIMPLE_FISHEYE 60 40 50 30 20", True),  # it has no number of its own for what it bends
    ],
)
def test_a_lens_that_bends_lines_is_told_of(tmp_path, camera, is_told):
    (tmp_path / "images").mkdir()
    sparse(tmp_path, ["view0.jpg"], binary=False)
    (tmp_path / "sparse/0/cameras.txt").write_text(f"1 {camera}\n")
    found = read_frames(tmp_path)
    assert ["bends straight lines" in note for note in found.notes] == [True] * is_told


def test_of_several_models_the_largest_counts_as_for_the_trainer(tmp_path):
    (tmp_path / "images").mkdir()
    for k in range(4):
        (tmp_path / f"images/view{k}.jpg").write_bytes(jpeg_head(60, 40))
    sparse(tmp_path, ["view0.jpg", "view1.jpg"], binary=True)
    (tmp_path / "sparse/0").rename(tmp_path / "sparse/7")
    sparse(tmp_path, [f"view{k}.jpg" for k in range(4)], binary=False)
    (tmp_path / "sparse/0").rename(tmp_path / "sparse/11")
    assert summarise(tmp_path).views == {"views": 4}
    assert [frame.name for frame in read_frames(tmp_path).frames] == [f"view{k}" for k in range(4)]


@pytest.fixture
def lego(tmp_path):
    """NeRF's synthetic scenes: a file a split, names without a suffix, and one picture that is missing."""
    for split, places in (("train", PLACES[:2]), ("test", PLACES[2:3]), ("val", PLACES[3:])):
        (tmp_path / split).mkdir()
        frames = []
        for index, place in enumerate(places):
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation(index)[1], place
            frames.append({"file_path": f"./{split}/r_{index}", "transform_matrix": pose.tolist()})
            (tmp_path / split / f"r_{index}.png").write_bytes(png(8, 6))
        content = {"camera_angle_x": 0.9, "frames": frames}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(content))
    return tmp_path


def test_nerfs_synthetic_scenes(lego):
    (lego / "transforms.json").write_text('{"frames": []}')  # the trainer does not look at it either
    found = summarise(lego)
    assert found.lines == [f"{lego.name}: 2 training views, 1 test, 1 validation, 8 × 6"]
    assert not found.warnings
    np.testing.assert_array_equal(camera_places(lego), PLACES[:3])
    cameras = read_frames(lego).frames
    assert [camera.split for camera in cameras] == ["train", "train", "test", "val"]
    expected = 0.5 * 8 / math.tan(0.45)
    for camera, place in zip(cameras, PLACES, strict=True):
        assert camera.fx == pytest.approx(expected)
        np.testing.assert_allclose(camera.camera_to_world[:3, 3], place)
    (lego / "transforms_test.json").unlink()
    assert summarise(lego).views == {"train": 2, "test": 1}, "validation's, as the trainer has it"
    (lego / "train/r_1.png").unlink()
    assert "Pictures are missing (1): train/r_1; they are ignored." in summarise(lego).warnings


def test_a_transforms_file_with_frames_that_have_no_picture(transforms):
    found = summarise(transforms)
    assert found.lines == [f"{transforms.name}: 3 views, 1080 × 1920, nerfstudio"]
    told = "Pictures are missing (1): images/0003.jpg; they are ignored."
    assert found.warnings == (told,)
    np.testing.assert_array_equal(camera_places(transforms), PLACES[:3])
    for picture in transforms.glob("images/*"):
        picture.unlink()
    with pytest.raises(FileMissingError, match="names no picture that is there"):
        summarise(transforms)


def test_exposures_of_many_views_are_told_by_their_ends(transforms):
    content = json.loads((transforms / "transforms.json").read_text())
    frames = [
        {**content["frames"][0], "file_path": f"images/a{k}", "exposure_time": 2.0**-k} for k in range(9)
    ]
    for k in range(9):
        (transforms / f"images/a{k}.png").write_bytes(png(6, 4))
    (transforms / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.9, "frames": frames}))
    lines = summarise(transforms).lines
    assert lines[1:3] == [
        "9 exposures: EV -8 to +0",
        "Dynamic range: 8.0 stops (between the shortest and the longest exposure)",
    ]


def test_poses_of_llff(tmp_path):
    (tmp_path / "input_images").mkdir()
    rows = np.zeros((4, 18))
    for index, place in enumerate(PLACES):
        pose = np.zeros((3, 5))
        pose[:, :3], pose[:, 3], pose[:, 4] = rotation(index)[1], place, (4, 6, 9)
        rows[index, :15], rows[index, 17] = pose.reshape(-1), 0.25 * 2.0**index
        (tmp_path / f"input_images/{index:03d}_0.png").write_bytes(png(6, 4))
    np.save(tmp_path / "poses_bounds_exps.npy", rows)
    found = summarise(tmp_path)
    assert found.lines[0] == f"{tmp_path.name}: 2 training views, 2 test, 6 × 4"
    assert found.exposures == (0.25, 0.5, 1.0, 2.0)
    np.testing.assert_array_equal(camera_places(tmp_path), PLACES)
    # With COLMAP's model beside them, the trainer's world is that of the model, and has its pictures alone.
    rows[:, 3:15:5] *= 3.0
    np.save(tmp_path / "poses_bounds_exps.npy", rows)
    sparse(tmp_path, ["000_0.png", "001_0.png", "002_0.png"], binary=True)
    np.testing.assert_allclose(
        sorted(camera_places(tmp_path).tolist()), sorted(PLACES[:3].tolist()), atol=1e-9
    )
    assert summarise(tmp_path).points is not None
    np.save(tmp_path / "poses_bounds_exps.npy", rows[:, :4])
    with pytest.raises(FileDamagedError, match="not one row of 18"):
        summarise(tmp_path)


def test_cameras_of_a_data_set_of_ours(tmp_path):
    for split, rows in (("train", PLACES[:3]), ("test", PLACES[3:])):
        poses = [np.block([[np.eye(3), row[:, None]], [np.zeros(3), 1.0]]).tolist() for row in rows]
        frames = [{"file_path": "x", "transform_matrix": pose} for pose in poses]
        (tmp_path / f"transforms_{split}.json").write_text(
            json.dumps({"camera_angle_x": 0.9, "frames": frames})
        )
    (tmp_path / "exposure_train.json").write_text("{}")
    np.testing.assert_array_equal(camera_places(tmp_path), PLACES)


# ---- hostile files -----------------------------------------------------------------------------------------


def test_a_model_with_any_byte_wrong_is_read_or_refused(prepared, fuzzing):
    path = prepared / "sparse/0/images.bin"
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    cases = [whole[:size] for size in range(0, len(whole), 23)]
    for _ in range(100):
        content = bytearray(whole)
        content[rng.integers(len(whole))] = rng.integers(256)
        cases.append(bytes(content))
    for case, content in enumerate(cases):
        path.write_bytes(content)
        try:
            assert np.isfinite(camera_places(prepared)).all(), f"case {case}"
        except PhysHDRError as error:
            assert "images.bin" in error.message, f"case {case}"
        try:
            summarise(prepared)
        except PhysHDRError as error:
            assert error.hint, f"case {case}"


def test_any_value_anywhere_in_transforms(transforms, fuzzing):
    path = transforms / "transforms.json"
    whole = json.loads(path.read_text())
    cases = [fuzzing.json_bytes(value) for value in fuzzing.json_mutations(whole, 100, 1)]
    for case, text in enumerate([*fuzzing.JSON_TEXTS, *cases]):
        path.write_bytes(text)
        for look in (summarise, camera_places):
            try:
                look(transforms)
            except PhysHDRError as error:
                assert str(transforms) in error.message, f"case {case}"
