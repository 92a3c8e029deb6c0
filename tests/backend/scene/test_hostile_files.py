# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets with files that are none, with damage of every kind, and with absurd numbers.

Whatever is in the folder, the reader ends soon, with a scene or with one of our errors.
"""

import json
import math
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from physhdr.backend.evaluate.truth import relit_truth
from physhdr.backend.inspect import inspect
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.capture.exposures import exposures_from_file
from physhdr.backend.scene.capture.photos import Photo
from physhdr.backend.scene.exif import Exif, comparable, read_exif
from physhdr.backend.scene.points import read_points
from physhdr.bridge.errors import BadValueError, FileDamagedError, PhysHDRError
from physhdr.bridge.limits import EXPOSURE

pytestmark = pytest.mark.usefixtures("never_waits")

#: Layouts: writer, its arguments, the files that its reader reads and, of those, the ones that are JSON.
LAYOUTS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "write_syn": ({}, ("transforms_train.json", "exposure_test.json", "train/r_2_1.png")),
    "write_real": ({"poses": 2, "scale": 1.0}, ("poses_bounds_exps.npy", "input_images/001_1.jpg")),
    "write_gausshdr": ({}, ("exposure.json", "images/train_r_2_1.png", "sparse/0/images.bin")),
    "write_colmap": (
        {"poses": 3},
        ("sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin", "images/shot_01_1.jpg"),
    ),
    "write_nerfstudio": ({"poses": 3}, ("transforms.json", "images/frame_00001.png")),
    "write_nerf": ({}, ("transforms_train.json", "transforms_test.json")),
}
TEXT = ("sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt")
FILES = [
    *((writer, arguments, file) for writer, (arguments, files) in LAYOUTS.items() for file in files),
    *(("write_colmap", {"poses": 3, "form": "txt"}, file) for file in TEXT),
]
#: Of these the pictures that cannot be read are left out, as long as most can.
SKIPPING = ("write_colmap", "write_nerfstudio")
OURS = ("dataset.json", "transforms_train.json", "transforms_lit.json", "exposure_lit.json", "points3d.ply")


def replaced_by_a_pipe(path: Path) -> Path:
    path.unlink()
    os.mkfifo(path)
    return path


# ---- what is no file ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("writer", "arguments", "file"), FILES)
def test_a_pipe_in_place_of_a_file(layouts: ModuleType, tmp_path: Path, writer, arguments, file) -> None:
    root = getattr(layouts, writer)(tmp_path / "data", **arguments)
    read_scene(root)
    replaced_by_a_pipe(root / file)
    if writer in SKIPPING and file.startswith("images/"):
        scene = read_scene(root)
        assert any(f"skipped (first: {root / file} is a pipe" in message for message in scene.messages)
        return
    with pytest.raises(FileDamagedError, match=rf"{Path(file).name} is a pipe, not a file\n  \w"):
        read_scene(root)
    assert any("is a pipe" in error for error in inspect(root).errors)


@pytest.mark.parametrize("file", [*OURS, "train/r_2_1.png", "exposure_train.json"])
def test_a_pipe_in_a_data_set_of_ours(data_set: Path, file: str) -> None:
    path = replaced_by_a_pipe(data_set / file)
    with pytest.raises(FileDamagedError, match=rf"{path.name} is a pipe, not a file\n  \w"):
        read_scene(data_set)
    assert any("is a pipe" in error for error in inspect(data_set).errors)


def test_a_pipe_in_place_of_the_list_of_relit_truth(data_set: Path) -> None:
    replaced_by_a_pipe(data_set / "dataset.json")
    with pytest.raises(FileDamagedError, match=r"dataset\.json is a pipe"):
        relit_truth(data_set)


def test_pipes_among_what_prepare_reads(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "photo.jpg")
    assert read_exif(tmp_path / "photo.jpg") == Exif()
    for name in ("exposures.json", "exposures.csv"):
        os.mkfifo(tmp_path / name)
        with pytest.raises(FileDamagedError, match=f"{name} is a pipe"):
            exposures_from_file(tmp_path / name, [])


# ---- damage ------------------------------------------------------------------------------------------


def ends_in_a_scene_or_an_error(root: Path, files: Iterator[bytes], path: Path, *readers: Callable) -> None:
    whole = path.read_bytes()
    for case, damaged in enumerate(files):
        path.write_bytes(damaged)
        for read in readers:
            try:
                read(root)
            except PhysHDRError as error:
                assert error.message, f"case {case} of {path.name}"
            except Exception as error:
                raise AssertionError(f"case {case} of {path.name}: {error!r}") from error
    path.write_bytes(whole)


@pytest.mark.filterwarnings("error::RuntimeWarning")  # arithmetic that overflows
@pytest.mark.parametrize(("writer", "arguments", "file"), FILES)
def test_damaged_bytes(layouts, fuzzing, tmp_path: Path, writer, arguments, file) -> None:
    root = getattr(layouts, writer)(tmp_path / "data", **arguments)
    path = root / file
    ends_in_a_scene_or_an_error(root, fuzzing.mutations(path.read_bytes(), 15, 1), path, read_scene)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("file", ["dataset.json", "transforms_train.json", "transforms_lit.json"])
def test_other_values_in_json_of_ours(data_set: Path, fuzzing: ModuleType, file: str) -> None:
    path = data_set / file
    whole = json.loads(path.read_text())
    if file == "dataset.json":
        whole |= {
            "relit": [{"folder": "relit/level_4", "levels": {"ambient": 4}}],
            "lights": ["ambient", "lamp"],
            "noise_floor": {"psnr": [50.0]},
            "dynamic_range": {"stops": 5.0},
            "frames": {"train/r_0": {"file": "passes/a.exr", "sha256": "ab", "samples": 8}},
            "splits": {"train": 3},
        }
    cases = (fuzzing.json_bytes(value) for value in fuzzing.json_mutations(whole, 15, 1))
    ends_in_a_scene_or_an_error(data_set, cases, path, read_scene, inspect, relit_truth)
    ends_in_a_scene_or_an_error(data_set, iter(fuzzing.JSON_TEXTS), path, read_scene)


@pytest.mark.parametrize(
    ("writer", "file"), [("write_nerfstudio", "transforms.json"), ("write_gausshdr", "exposure.json")]
)
def test_other_values_in_json_of_others(layouts, fuzzing, tmp_path: Path, writer: str, file: str) -> None:
    root = getattr(layouts, writer)(tmp_path / "data", poses=3)
    path = root / file
    whole = json.loads(path.read_text())
    cases = (fuzzing.json_bytes(value) for value in fuzzing.json_mutations(whole, 60, 2))
    ends_in_a_scene_or_an_error(root, cases, path, read_scene)


def test_damaged_points(data_set: Path, fuzzing: ModuleType) -> None:
    path = data_set / "points3d.ply"
    cases = fuzzing.mutations(path.read_bytes(), 200, 4)
    ends_in_a_scene_or_an_error(data_set, cases, path, lambda root: read_points(root / "points3d.ply"))


def test_an_array_whose_header_has_no_end(layouts: ModuleType, tmp_path: Path) -> None:
    """numpy's reader lets the tokenizer's error through, which is of none of the usual classes."""
    root = layouts.write_real(tmp_path / "data", poses=2, scale=1.0)
    path = root / "poses_bounds_exps.npy"
    path.write_bytes(path.read_bytes().replace(b"(6, 18), }", b"(6, 18(, {"))
    with pytest.raises(FileDamagedError, match="is not a readable array"):
        read_scene(root)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("e.json", "[" * 100_000, "cannot be read as JSON: maximum recursion"),
        ("e.csv", "a.jpg," + "9" * 200_000, "is not readable .field larger than"),
        ("e.json", '{"a.jpg": 1e300}', r"the exposure of a\.jpg is 1e\+300 s"),
        ("e.csv", "a.jpg,1/1e300", r"the exposure of a\.jpg is 1e-300 s"),
    ],
)
def test_files_of_exposures(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    photo = Photo(tmp_path / "a.jpg", 4, 4)
    with pytest.raises(PhysHDRError, match=message):
        exposures_from_file(tmp_path / name, [photo])


# ---- absurd numbers ----------------------------------------------------------------------------------


def edited(path: Path, change: Callable[[Any], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def refused(root: Path, *words: str) -> None:
    with pytest.raises(BadValueError) as caught:
        read_scene(root)
    for word in words:
        assert word in str(caught.value), f"'{word}' is not in: {caught.value}"


@pytest.mark.parametrize("seconds", [1e300, 1e10, 1e-10, 5e-324])
def test_exposures_that_no_camera_has(layouts: ModuleType, small, tmp_path: Path, seconds: float) -> None:
    told = (f"is {seconds:g} s: it must be from 9.31323e-10 to 1.07374e+09", "seconds")
    ours = small.write_data_set(tmp_path / "ours")
    edited(ours / "exposure_train.json", lambda e: e.update({"./train/r_2_1.png": seconds}))
    refused(ours, "exposure_train.json: the exposure of './train/r_2_1.png'", *told)
    packed = layouts.write_gausshdr(tmp_path / "gausshdr", poses=3)
    edited(packed / "exposure.json", lambda e: e.update({"train_r_0_0.png": seconds}))
    refused(packed, "exposure.json: the exposure of 'train_r_0_0.png'", *told)
    real = layouts.write_real(tmp_path / "real", poses=2, scale=1.0)
    rows = np.load(real / "poses_bounds_exps.npy")
    rows[4, 17] = seconds
    np.save(real / "poses_bounds_exps.npy", rows)
    refused(real, "poses_bounds_exps.npy: the exposure of row 4", *told)
    nerf = layouts.write_nerfstudio(tmp_path / "nerf", poses=3)
    edited(nerf / "transforms.json", lambda c: [frame.update(exposure_time=seconds) for frame in c["frames"]])
    refused(nerf, "transforms.json: the exposure of 'frame_00000.png'", *told)


def test_an_exposure_by_exif_that_no_camera_has(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=3)
    path = root / "images" / "shot_01_1.jpg"
    layouts.save(path, layouts.draw(1, 1), exif=layouts.camera_exif(4e9))
    refused(root, "shot_01_1.jpg: the exposure by its EXIF data is 4e+09 s", "it must be from")


def test_apertures_that_no_lens_has() -> None:
    """Their ratio squared is beyond a float: an exposure that is refused, by whoever knows the file."""
    seconds = comparable([Exif(0.5, 100.0, 1e-80), Exif(0.5, 100.0, 1e100)]).seconds
    assert seconds[0] == math.inf and seconds[0] not in EXPOSURE


@pytest.mark.parametrize("coordinate", [3e38, 5.3e6, -1e300])
def test_cameras_at_the_end_of_the_world(layouts: ModuleType, small, tmp_path: Path, coordinate) -> None:
    told = (f"{coordinate:g}", "coordinates must be from -1e+06 to 1e+06 metres", "Move the world's origin")

    def move(content: dict) -> None:
        content["frames"][0]["transform_matrix"][1][3] = coordinate

    ours = small.write_data_set(tmp_path / "ours")
    edited(ours / "transforms_test.json", move)
    refused(ours, "transforms_test.json: the camera of frame 0 ('test/r_1')", *told)
    nerf = layouts.write_nerfstudio(tmp_path / "nerf", poses=3)
    edited(nerf / "transforms.json", move)
    refused(nerf, "transforms.json: the camera of frame", *told)
    real = layouts.write_real(tmp_path / "real", poses=2, scale=1.0)
    rows = np.load(real / "poses_bounds_exps.npy")
    rows[:3, 8] = coordinate
    np.save(real / "poses_bounds_exps.npy", rows)
    refused(real, "poses_bounds_exps.npy: the camera of pose 0", *told)


@pytest.mark.parametrize("form", ["bin", "txt"])
def test_a_model_in_the_coordinates_of_a_map(layouts: ModuleType, tmp_path: Path, form: str) -> None:
    """UTM's northings: half a metre is the step of float32 there."""
    root = layouts.write_colmap(tmp_path / "data", poses=3, form=form)
    folder = root / "sparse" / "0"
    point = layouts.POINTS[1]
    if form == "bin":
        raw = (folder / "points3D.bin").read_bytes()
        moved = raw.replace(struct.pack("<3d", *point), struct.pack("<3d", 5e5, 5.3e6, 200.0))
        (folder / "points3D.bin").write_bytes(moved)
    else:
        text = (folder / "points3D.txt").read_text()
        old = " ".join(repr(float(value)) for value in point)
        (folder / "points3D.txt").write_text(text.replace(old, "500000 5300000 200"))
    refused(
        root, f"points3D.{form}: 1 of 3 points are too far away, the first, 1, at (500000, 5.3e+06, 200)",
        "subtract one vector", "delete them",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ((1e300, 90.0, 48.0, 36.0), ("the focal length of camera 7 is 1e+300 pixels", "from 0.01 to 1e+07")),
        ((90.0, 1e-300, 48.0, 36.0), ("the focal length of camera 7 is 1e-300 pixels",)),
        ((90.0, 90.0, 1e300, 36.0), ("the principal point of camera 7 is 1e+300 pixels",)),
    ],
)
def test_absurd_cameras_of_colmap(layouts: ModuleType, tmp_path: Path, params, words) -> None:
    refused(layouts.write_colmap(tmp_path / "data", poses=3, params=params), *words)


def test_absurd_translations_of_colmap(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_colmap(tmp_path / "data", poses=3)
    path = root / "sparse" / "0" / "images.bin"
    _, translation = layouts.world_to_camera(1)
    moved = path.read_bytes().replace(struct.pack("<3d", *translation), struct.pack("<3d", 0.0, 0.0, 3e38))
    path.write_bytes(moved)
    refused(root, "images.bin: the camera of picture 2 ('shot_01_1.jpg') is at", "coordinates must be")


def test_a_picture_whose_name_is_too_long_for_any_file(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_nerfstudio(tmp_path / "data", poses=3)
    edited(root / "transforms.json", lambda c: c["frames"][1].update(file_path="images/" + "x" * 5000))
    (told,) = (message for message in read_scene(root).messages if "skipped" in message)
    assert told.startswith("1 of 3 frames have a picture that cannot be read")
    assert "cannot be read: File name too long" in told


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fl_x": 1e300}, ("'fl_x' is 1e+300 pixels", "from 0.01 to 1e+07")),
        ({"fl_y": 1e-300}, ("'fl_y' is 1e-300 pixels",)),
        ({"cx": -1e300}, ("'cx' is -1e+300 pixels", "from -1e+06 to 1e+06")),
        ({"camera_angle_x": 1e-300, "fl_x": None}, ("the focal length of 'camera_angle_x' = 1e-300",)),
    ],
)
def test_absurd_cameras_of_nerfstudio(layouts: ModuleType, tmp_path: Path, change: dict, words) -> None:
    root = layouts.write_nerfstudio(tmp_path / "data", poses=3)

    def spoil(content: dict) -> None:
        content.update(change)
        for key in [key for key, value in change.items() if value is None]:
            del content[key]

    edited(root / "transforms.json", spoil)
    refused(root, "transforms.json: frame 'images/frame_00000'", *words)


@pytest.mark.parametrize("angle", [1e-300, math.nextafter(math.pi, 0.0)])
def test_absurd_fields_of_view(data_set: Path, angle: float) -> None:
    edited(data_set / "transforms_train.json", lambda c: c.update(camera_angle_x=angle))
    refused(
        data_set, "transforms_train.json", f"the focal length of 'camera_angle_x' = {angle:g} is", "pixels"
    )


@pytest.mark.parametrize("level", [1e300, 1e7, 1e-9])
def test_absurd_levels(data_set: Path, level: float) -> None:
    edited(data_set / "transforms_lit.json", lambda c: c["frames"][1].update(lighting_level=level))
    refused(data_set, "frame 1 ('lit/r_1'): the lighting level of 'ambient' is", "0, or from 1e-06 to 1e+06")
    (data_set / "relit" / "level_4").rename(data_set / "relit" / f"level_{level:g}")
    with pytest.raises(BadValueError, match=rf"level_{level:g}: the level of ambient is".replace("+", r"\+")):
        relit_truth(data_set)
    levels = {"folder": f"relit/level_{level:g}", "levels": {"ambient": level}}
    edited(data_set / "dataset.json", lambda c: c.update(relit=[levels]))
    with pytest.raises(BadValueError, match="relit 0: the level of 'ambient' is"):
        relit_truth(data_set)


def test_points_at_the_end_of_the_world(data_set: Path) -> None:
    path = data_set / "points3d.ply"
    raw = bytearray(path.read_bytes())
    first = raw.index(b"end_header\n") + len(b"end_header\n")
    raw[first + 27 : first + 31] = struct.pack("<f", 3e38)
    path.write_bytes(raw)
    refused(data_set, "points3d.ply: 1 of 4 points are too far away, the first, 1, at (3e+38, 0, 0.5)")


@pytest.mark.parametrize("kind", ["ply", "bin", "txt"])
def test_single_points_at_the_end_of_the_world_are_left_out(
    layouts: ModuleType, data_set: Path, tmp_path: Path, kind: str
) -> None:
    """One of 300 at (3e6, 0, 9e6), the last: what two almost parallel rays make. Four are too many."""
    rows = [(0.01 * i, 0.5, 0.25, i % 256, 2, 3) for i in range(299)]

    def written(strays: int) -> Path:
        table = [*rows[: 300 - strays], *[(3e6, 0.0, 9e6, 7, 8, 9)] * strays]
        if kind == "ply":
            lines = ["ply", "format ascii 1.0", f"element vertex {len(table)}"]
            lines += [f"property float {axis}" for axis in "xyz"]
            lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
            lines += ["end_header", *(" ".join(map(str, row)) for row in table)]
            (data_set / "points3d.ply").write_text("\n".join(lines) + "\n")
            return data_set
        root = layouts.write_colmap(tmp_path / f"data{strays}", poses=4, form=kind)
        points = root / "sparse" / "0" / f"points3D.{kind}"
        if kind == "txt":
            points.write_text("".join(f"{i} {' '.join(map(str, row))} 0.5\n" for i, row in enumerate(table)))
        else:
            packed = (struct.pack("<Q3d3BdQ", i, *row, 0.5, 0) for i, row in enumerate(table))
            points.write_bytes(struct.pack("<Q", len(table)) + b"".join(packed))
        return root

    scene = read_scene(written(1))
    assert scene.points is not None and len(scene.points.positions) == len(scene.points.colours) == 299
    np.testing.assert_allclose(scene.points.positions[:, 0], [row[0] for row in rows], atol=1e-6)
    np.testing.assert_allclose(scene.points.colours[:, 0], [row[3] / 255 for row in rows], atol=1e-6)
    assert "ignoring 1 of 300 points: farther away than 1e+06" in scene.messages
    refused(written(4), "4 of 300 points are too far away, the first, 296, at (3e+06, 0, 9e+06)")


def test_a_point_cloud_that_claims_more_than_it_has(data_set: Path) -> None:
    """No memory is taken for rows before they are found."""
    header = "ply\nformat ascii 1.0\nelement vertex 100000000000\nproperty list uchar int x\nend_header\n"
    (data_set / "points3d.ply").write_text(header)
    with pytest.raises(
        FileDamagedError, match=r"points3d\.ply .*it claims 100000000000 rows of vertex and has 0"
    ):
        read_scene(data_set)


def test_real_worlds_are_within(layouts: ModuleType, tmp_path: Path) -> None:
    """A telephoto lens, an exposure of a day, a flash, a scene of ten kilometres."""
    root = layouts.write_nerfstudio(tmp_path / "data", poses=3, fl_x=3e5, fl_y=3e5, cx=-4000.0)

    def spread(content: dict) -> None:
        for frame, seconds in zip(content["frames"], (86400.0, 1.0, 1e-7), strict=True):
            frame["exposure_time"] = seconds
            frame["transform_matrix"][0][3] += 1e4

    edited(root / "transforms.json", spread)
    scene = read_scene(root)
    assert sorted(view.exposures[0] for view in [*scene.train, *scene.test]) == [1e-7, 1.0, 86400.0]
