# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and OpenEXR: what is written is what is read, and damage is named."""

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.scene.pictures import read_exr, read_png, write_exr, write_png
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError


@pytest.fixture
def radiance() -> np.ndarray:
    return np.random.default_rng(0).lognormal(sigma=4.0, size=(33, 47, 3)).astype(np.float32)


def test_exr_round_trip_is_exact(tmp_path: Path, radiance: np.ndarray) -> None:
    path = tmp_path / "new" / "a.exr"
    write_exr(path, radiance, {"note": "scene-linear"})
    np.testing.assert_array_equal(read_exr(path), radiance)
    assert OpenEXR.File(str(path), header_only=True).parts[0].header["note"] == "scene-linear"
    assert [file.name for file in path.parent.iterdir()] == ["a.exr"], "no temporary file is left"


def test_exr_of_half_floats_and_more_channels(tmp_path: Path, radiance: np.ndarray) -> None:
    half = np.clip(radiance, 0, 60000).astype(np.float16)
    channels = {name: np.ascontiguousarray(half[..., i]) for i, name in enumerate("RGB")}
    channels["A"] = np.ones_like(channels["R"])
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / "half.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "half.exr"), half.astype(np.float32))


def test_missing_exr(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError, match=r"gone.exr is missing\n.*Restore"):
        read_exr(tmp_path / "gone.exr")


@pytest.mark.parametrize("keep", [0, 10, 200, 376, 500, 0.5, 0.99])
def test_truncated_exr(tmp_path: Path, radiance: np.ndarray, keep: float) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, radiance)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(keep if keep > 1 else keep * len(raw))])
    with pytest.raises(FileDamagedError, match=r"a.exr is not a readable OpenEXR picture[\s\S]*Delete it"):
        read_exr(path)


def test_exr_that_claims_to_be_huge(tmp_path: Path, radiance: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, radiance)
    raw = path.read_bytes()
    window = struct.pack("<4i", 0, 0, 46, 32)
    assert raw.count(window) == 2
    path.write_bytes(raw.replace(window, struct.pack("<4i", 0, 0, 15999, 15999)))
    with pytest.raises(FileDamagedError, match="claims 16000×16000 pixels"):
        read_exr(path)


def test_exr_without_colour(tmp_path: Path) -> None:
    header = {"type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": np.ones((4, 5), np.float32)}).write(str(tmp_path / "depth.exr"))
    with pytest.raises(FileDamagedError, match=r"depth.exr.*no channels R, G, B but \['Z'\]"):
        read_exr(tmp_path / "depth.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_exr_with_nan(tmp_path: Path, radiance: np.ndarray, value: float) -> None:
    radiance[5, 7, 1] = value
    write_exr(tmp_path / "a.exr", radiance)
    with pytest.raises(
        BadValueError, match=r"a.exr holds NaN or infinity, first at row 5, column 7\n.*Render"
    ):
        read_exr(tmp_path / "a.exr")


def test_png_round_trip_and_alpha_is_ignored(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (9, 13, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(read_png(tmp_path / "a.png"), picture)
    alpha = np.random.default_rng(1).integers(0, 256, (9, 13, 1), dtype=np.uint8)
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "rgba.png")
    np.testing.assert_array_equal(read_png(tmp_path / "rgba.png"), picture)


def test_png_of_16_bits_is_refused(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 40000, np.uint16)).save(tmp_path / "deep.png")
    with pytest.raises(FileDamagedError, match=r"deep.png is not an 8-bit colour PNG[\s\S]*Save it again"):
        read_png(tmp_path / "deep.png")


def test_output_that_cannot_be_written(tmp_path: Path, radiance: np.ndarray) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write .*file/a.exr[\s\S]*choose another path"):
        write_exr(tmp_path / "file" / "a.exr", radiance)
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OutputError, match=r"folder.png: a folder is there\n.*another file name"):
        write_png(tmp_path / "folder.png", np.zeros((2, 2, 3), np.uint8))
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_text("precious")
    with pytest.raises(BadValueError, match="uint8"):
        write_png(path, np.zeros((2, 2, 3), np.float32))
    assert path.read_text() == "precious"
