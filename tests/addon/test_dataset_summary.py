# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says of a data set's folder. No Blender: the folders are written here, by hand."""

import json
import math
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from physhdr.addon.layouts.cameras import read_pose
from physhdr.addon.layouts.summary import summarise
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError

SECONDS = (0.125, 0.5, 2.0)


def png(width: int, height: int) -> bytes:
    """A black picture as any program writes it."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    pixels = zlib.compress(bytes((1 + 4 * width) * height))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """HDR-NeRF-Syn's layout: 3 training and 2 test poses of 6 × 4 pixels at three exposures."""
    pose = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
    for split, count in (("train", 3), ("test", 2)):
        (tmp_path / split).mkdir()
        frames = [{"file_path": f"./{split}/r_{i}", "transform_matrix": pose} for i in range(count)]
        seconds = {f"./{split}/r_{i}_{k}.png": t for i in range(count) for k, t in enumerate(SECONDS)}
        for name in seconds:
            (tmp_path / name).write_bytes(png(6, 4))
        transforms = {"camera_angle_x": 0.9, "frames": frames}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(transforms))
        (tmp_path / f"exposure_{split}.json").write_text(json.dumps(seconds))
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 7\nproperty float x\nend_header\n"
    (tmp_path / "points3d.ply").write_bytes(header.encode() + bytes(28))
    return tmp_path


def test_a_plain_folder(folder):
    found = summarise(folder)
    assert found.views == {"train": 3, "test": 2} and found.size == (6, 4) and found.points == 7
    assert found.exposures == SECONDS and found.evs == (-3.0, -1.0, 1.0)
    assert found.stops == 4.0 and "exposure" in found.stops_from  # log2(2 / 0.125), by hand
    assert not found.warnings
    assert found.lines == [
        f"{folder.name}: 3 training views, 2 test, 6 × 4",
        "3 exposures: EV -3, -1, +1",
        "Dynamic range: 4.0 stops (between the shortest and the longest exposure)",
        "Starts from 7 points",
    ]


def test_validation_views_are_named(folder):
    (folder / "val").mkdir()
    frame = {"file_path": "./val/r_0", "transform_matrix": []}
    (folder / "transforms_val.json").write_text(json.dumps({"camera_angle_x": 0.9, "frames": [frame]}))
    (folder / "exposure_val.json").write_text(json.dumps({"./val/r_0_0.png": 2.0}))
    assert "Pictures are missing (1): val/r_0_0.png" in summarise(folder).warnings[0]
    (folder / "val/r_0_0.png").write_bytes(png(6, 4))
    found = summarise(folder)
    assert found.lines[0] == f"{folder.name}: 3 training views, 2 test, 1 validation, 6 × 4"
    assert found.views["val"] == 1 and found.exposures == SECONDS and not found.warnings


def test_a_validation_split_of_nerf_is_passed_over_as_the_trainers_reader_does(folder):
    frame = {"file_path": "./val/r_0", "transform_matrix": []}
    (folder / "transforms_val.json").write_text(json.dumps({"camera_angle_x": 0.9, "frames": [frame]}))
    found = summarise(folder)
    assert found.views == {"train": 3, "test": 2} and not found.warnings
    (folder / "dataset.json").write_text("{}")  # of ours: then its exposures are missing
    found = summarise(folder)
    assert found.views["val"] == 1 and "exposure_val.json is missing" in found.warnings[0]


def test_a_folder_of_ours(folder):
    info = {"format": "physhdr-dataset", "version": 1, "scene": "attic", "dynamic_range": {"stops": 15.25}}
    (folder / "dataset.json").write_text(json.dumps(info))
    (folder / "lit").mkdir()
    (folder / "lit/r_0_0.png").write_bytes(png(6, 4))
    frame = {"file_path": "./lit/r_0", "transform_matrix": [], "lighting_level": 0.25}
    (folder / "transforms_lit.json").write_text(json.dumps({"camera_angle_x": 0.9, "frames": [frame]}))
    (folder / "exposure_lit.json").write_text(json.dumps({"./lit/r_0_0.png": 2.0}))
    for level in ("0.5", "4"):
        (folder / f"relit/level_{level}").mkdir(parents=True)
    found = summarise(folder)
    assert found.name == "attic" and found.views["lit"] == 1
    assert (found.stops, found.stops_from) == (15.25, "measured")
    assert found.levels == (0.25,) and found.relit_levels == (0.5, 4.0)
    assert "Ambient light: trained at 0.25; truth at 0.5, 4" in found.lines and not found.warnings


def test_the_lights_of_a_data_set_are_one_line(folder):
    info = {"lights": ["ambient", "pendant", "screen"], "lit_lights": ["ambient"]}
    (folder / "dataset.json").write_text(json.dumps(info))
    assert "Lights: ambient, pendant, screen; levels to learn from: ambient" in summarise(folder).lines
    # The split itself tells which lights vary; folders of the truth tell its settings.
    frame = {"file_path": "./lit/r_0", "transform_matrix": [], "lighting_levels": {"pendant": 2.0}}
    lit = {"camera_angle_x": 0.9, "lights": ["ambient", "pendant"], "frames": [frame]}
    (folder / "transforms_lit.json").write_text(json.dumps(lit))
    (folder / "exposure_lit.json").write_text("{}")
    for setting in ("level_0.25", "ambient_4+pendant_0.25", "pendant_0"):
        (folder / "relit" / setting).mkdir(parents=True)
    found = summarise(folder)
    assert (found.lights, found.lit_lights) == (("ambient", "pendant", "screen"), ("ambient", "pendant"))
    line = "ambient, pendant, screen; levels to learn from: ambient, pendant; truth for 2 mixtures"
    assert f"Lights: {line}" in found.lines and found.relit_levels == (0.25,)
    (folder / "dataset.json").unlink()
    assert summarise(folder).lights == ("ambient", "pendant")
    (folder / "dataset.json").write_text("{}")
    edit(folder / "dataset.json", lambda content: content.update(lights="ambient"))
    assert "dataset.json: 'lights' is 'ambient', not a list of lights." in summarise(folder).warnings


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda f: (f / "train/r_1_2.png").unlink(), "missing (1): train/r_1_2.png"),
        (lambda f: (f / "train/r_1_2.png").write_bytes(b"GIF89a"), "no PNG files (1): train/r_1_2.png"),
        (lambda f: (f / "test/r_1_2.png").write_bytes(png(8, 4)), "not of one size: 6 × 4"),
        (lambda f: (f / "points3d.ply").unlink(), "points3d.ply is missing"),
        (lambda f: (f / "points3d.ply").write_text("solid"), "no PLY file"),
        (lambda f: (f / "dataset.partial.json").write_text("{}"), "not complete yet"),
        (lambda f: (f / "exposure_train.json").unlink(), "exposures are unknown"),
        (
            lambda f: [(f / f"{kind}_test.json").unlink() for kind in ("transforms", "exposure")],
            "no test split",
        ),
        (
            lambda f: edit(f / "exposure_train.json", lambda e: e.update({"./train/r_0_0.png": 0})),
            "exposure of ./train/r_0_0.png is 0",
        ),
        (
            lambda f: edit(f / "exposure_train.json", lambda e: e.pop("./train/r_2_1.png")),
            "same number of exposures: train/r_2 has 2",
        ),
        (
            lambda f: edit(f / "exposure_train.json", lambda e: e.update(dict.fromkeys(e, 0.5))),
            "one exposure: high dynamic range cannot be learned",
        ),
        (
            lambda f: edit(
                f / "transforms_train.json", lambda t: t["frames"].append({"file_path": "./train/r_9"})
            ),
            "names no picture of train/r_9",
        ),
    ],
)
def test_what_is_wrong_is_told(folder, spoil, told):
    spoil(folder)
    first, *others = summarise(folder).warnings
    assert told in first
    assert all("same number of exposures" in other for other in others)  # what follows from the first


@pytest.mark.parametrize(
    ("spoil", "kind", "told"),
    [
        (
            lambda f: (f / "transforms_train.json").unlink(),
            FileMissingError,
            "looked for transforms_train.json",
        ),
        (lambda f: (f / "transforms_test.json").write_text("{"), FileDamagedError, "transforms_test.json"),
        (lambda f: (f / "transforms_test.json").write_text("[]"), FileDamagedError, "not an object"),
        (lambda f: (f / "transforms_test.json").write_text("{}"), FileDamagedError, "has no 'frames'"),
        (lambda f: (f / "exposure_test.json").write_bytes(b"\xff"), FileDamagedError, "exposure_test.json"),
        (lambda f: (f / "dataset.json").write_text('{"format": "x"}'), BadValueError, "format 'x'"),
        (lambda f: (f / "dataset.json").write_text('{"version": 2}'), BadValueError, "version 2"),
    ],
)
def test_what_is_no_data_set_is_refused(folder, spoil, kind, told):
    spoil(folder)
    with pytest.raises(kind) as error:
        summarise(folder)
    assert told in error.value.message and error.value.hint


def test_folders_that_are_none(tmp_path):
    (tmp_path / "file").write_text("")
    for name, told in (("nowhere", "does not exist"), ("file", "is a file"), (".", "is not a data set")):
        with pytest.raises(FileMissingError, match=told):
            summarise(tmp_path / name)
    (tmp_path / "dataset.partial.json").write_text("{}")
    with pytest.raises(FileMissingError, match="only just been begun"):
        summarise(tmp_path)


def test_other_folders_are_no_levels(folder):
    (folder / "relit/level_high").mkdir(parents=True)
    assert summarise(folder).relit_levels == ()


# ---- hostile files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["transforms_train.json", "exposure_test.json", "dataset.json"])
def test_a_pipe_in_place_of_a_file(folder, never_waits, name):
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    with pytest.raises(FileDamagedError, match=f"{name} is a pipe, not a file"):
        summarise(folder)


def test_pipes_in_place_of_pictures_and_points(folder, never_waits):
    for name in ("train/r_1_2.png", "points3d.ply"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    missing, points = summarise(folder).warnings
    assert "Pictures are missing (1): train/r_1_2.png" in missing
    assert "points3d.ply cannot be read: " in points and "is a pipe" in points


def test_any_value_anywhere_in_json(folder, fuzzing):
    info = {"format": "physhdr-dataset", "version": 1, "dynamic_range": {"stops": 5.0}, "lights": ["ambient"]}
    lit = {"camera_angle_x": 0.9, "frames": [{"file_path": "./lit/r_0", "lighting_level": 0.25}]}
    (folder / "dataset.json").write_text(json.dumps(info))
    (folder / "transforms_lit.json").write_text(json.dumps(lit))
    (folder / "exposure_lit.json").write_text("{}")
    for name in ("dataset.json", "transforms_lit.json", "exposure_train.json"):
        path = folder / name
        whole = path.read_text()
        cases = [fuzzing.json_bytes(v) for v in fuzzing.json_mutations(json.loads(whole), 200, 1)]
        for case, text in enumerate([*fuzzing.JSON_TEXTS, *cases]):
            path.write_bytes(text)
            try:
                found = summarise(folder)
                assert found.lines and all(map(math.isfinite, found.evs)), f"case {case} of {name}"
            except PhysHDRError as error:
                assert name in error.message, f"case {case} of {name}"
        path.write_text(whole)


@pytest.mark.parametrize("level", [None, "1", [], True, -1.0, 1e300, 10**400])
def test_a_level_that_is_none(folder, level):
    lit = {"camera_angle_x": 0.9, "frames": [{"file_path": "./lit/r_0", "lighting_level": level}]}
    (folder / "transforms_lit.json").write_text(json.dumps(lit))
    (folder / "exposure_lit.json").write_text("{}")
    found = summarise(folder)
    assert found.levels == () and "transforms_lit.json: the lighting level" in found.warnings[0]


@pytest.mark.parametrize("seconds", [1e300, 1e-300, 10**400])
def test_an_exposure_that_no_camera_has(folder, seconds):
    edit(folder / "exposure_train.json", lambda e: e.update({"./train/r_0_0.png": seconds}))
    assert "exposure of ./train/r_0_0.png is 1" in summarise(folder).warnings[0]


@pytest.mark.parametrize("count", [b"9" * 5000, b"-1", b"x", b""])
def test_points_without_number(folder, count):
    (folder / "points3d.ply").write_bytes(b"ply\nelement vertex " + count + b"\nend_header\n")
    assert "points3d.ply is no PLY file" in summarise(folder).warnings[0]


def test_camera_files(folder, fuzzing, never_waits):
    path = folder / "transforms_train.json"
    matrix = [[1.0, 0, 0, 2], [0, 1, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1]]
    edit(path, lambda content: [frame.update(transform_matrix=matrix) for frame in content["frames"]])
    np.testing.assert_array_equal(read_pose(path, 1).camera_to_world, matrix)
    whole = json.loads(path.read_text())
    cases = [fuzzing.json_bytes(value) for value in fuzzing.json_mutations(whole, 300, 1)]
    for case, text in enumerate([*fuzzing.JSON_TEXTS, *cases]):
        path.write_bytes(text)
        try:
            assert np.abs(read_pose(path, 1).camera_to_world[:3, 3]).max() <= 1e6, f"case {case}"
        except PhysHDRError as error:
            assert str(path) in error.message, f"case {case}"
    matrix[2][3] = 3e38
    path.write_text(json.dumps(whole))
    edit(path, lambda content: content["frames"][1].update(transform_matrix=matrix))
    with pytest.raises(BadValueError, match=r"camera of frame 1 is at .*3e\+38.*(.|\n)*origin"):
        read_pose(path, 1)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(FileDamagedError, match="is a pipe"):
        read_pose(path, 1)
