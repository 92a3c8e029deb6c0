# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG and OpenEXR: what is written is what is read, and damage is named."""

import os
import re
import struct
import zlib
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.inspect.layers import read_layers
from physhdr.backend.scene.pictures import (
    picture_size,
    read_codes,
    read_exr,
    read_radiance,
    write_exr,
    write_png,
)
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError, PhysHDRError


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


@pytest.mark.parametrize("keep", [10, 200, 376, 500, 0.5, 0.99])
def test_truncated_exr(tmp_path: Path, radiance: np.ndarray, keep: float) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, radiance)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(keep if keep > 1 else keep * len(raw))])
    with pytest.raises(FileDamagedError, match=r"a.exr is not a readable OpenEXR picture[\s\S]*Delete it"):
        read_exr(path)


def test_a_damaged_exr_says_nothing_on_stdout(tmp_path: Path, radiance: np.ndarray, capfd) -> None:
    """Where ``physhdr inspect --json`` tells programs what it has found."""
    write_exr(tmp_path / "a.exr", radiance)
    raw = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(raw[: len(raw) // 2])
    for read in (read_exr, read_layers):
        with pytest.raises(FileDamagedError):
            read(tmp_path / "a.exr")
    assert capfd.readouterr().out == ""


def test_exr_that_claims_to_be_huge(tmp_path: Path, radiance: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, radiance)
    raw = path.read_bytes()
    window = struct.pack("<4i", 0, 0, 46, 32)
    assert raw.count(window) == 2
    path.write_bytes(raw.replace(window, struct.pack("<4i", 0, 0, 15999, 15999)))
    with pytest.raises(FileDamagedError, match=r"claims (16000×16000 pixels|a \d+ MB image)"):
        read_exr(path)


@pytest.mark.parametrize(
    "window", [(0, 0, 29, 19), (3, 4, 20, 15), (-5, -3, 40, 30), (-5, 4, 10, 30), (40, 40, 99, 99)]
)
def test_an_exr_of_another_window_is_where_it_is_shown(tmp_path: Path, window) -> None:
    """A renderer writes what is not empty, a region alone, or more than is shown."""
    x0, y0, x1, y1 = window
    pixels = np.random.default_rng(0).random((y1 - y0 + 1, x1 - x0 + 1, 3)).astype(np.float32)
    corners = {
        "dataWindow": (np.int32([x0, y0]), np.int32([x1, y1])),
        "displayWindow": (np.int32([0, 0]), np.int32([29, 19])),
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **corners}
    OpenEXR.File(header, {"RGB": pixels}).write(str(tmp_path / "a.exr"))
    expected = np.zeros((20, 30, 3), np.float32)
    for y in range(max(y0, 0), min(y1 + 1, 20)):
        for x in range(max(x0, 0), min(x1 + 1, 30)):
            expected[y, x] = pixels[y - y0, x - x0]
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), expected)
    assert picture_size(tmp_path / "a.exr") == (30, 20)


def test_an_exr_that_is_shown_in_a_huge_window(tmp_path: Path, radiance: np.ndarray) -> None:
    corner = {"displayWindow": (np.int32([0, 0]), np.int32([99_999, 99_999]))}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **corner}
    OpenEXR.File(header, {"RGB": radiance}).write(str(tmp_path / "a.exr"))
    with pytest.raises(FileDamagedError, match="display window has 100000×100000 pixels"):
        read_exr(tmp_path / "a.exr")


def hdr(path: Path, header: bytes) -> None:
    """4×2 pixels of radiance 1, by the format's own words: bytes of RGB, and an exponent above 128."""
    row = bytes([128, 128, 128, 129]) * 4
    path.write_bytes(b"#?RADIANCE\n" + header + b"FORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + 2 * row)


@pytest.mark.parametrize(
    "header, expected",
    [
        (b"", 1.0),
        (b"EXPOSURE=4.0\n", 0.25),
        (b"EXPOSURE= 8\nVIEW= -vp 0 0 0\nEXPOSURE=0.5\n", 0.25),
        (b"# EXPOSURE=4\n", 1.0),
    ],
)
def test_what_an_hdr_was_exposed_by_is_taken_back(tmp_path: Path, header, expected) -> None:
    hdr(tmp_path / "a.hdr", header)
    np.testing.assert_allclose(read_radiance(tmp_path / "a.hdr").pixels, expected, rtol=1e-6)


@pytest.mark.parametrize("order", ["+Y 2 +X 4", "-Y 2 -X 4", "+Y 2 -X 4", "+X 4 -Y 2", "-X 4 +Y 2"])
def test_an_hdr_that_is_stored_another_way_up_is_refused(tmp_path: Path, order: str) -> None:
    """Mirrored or turned pixels would be trained on with cameras that look another way."""
    hdr(tmp_path / "a.hdr", b"")
    whole = (tmp_path / "a.hdr").read_bytes()
    (tmp_path / "a.hdr").write_bytes(whole.replace(b"-Y 2 +X 4", order.encode()))
    for read in (read_radiance, picture_size):
        with pytest.raises(FileDamagedError, match=re.escape(f"on its side ('{order}')")) as caught:
            read(tmp_path / "a.hdr")
        assert "'-Y height +X width'" in caught.value.hint


@pytest.mark.parametrize("told", [b"0", b"nan", b"bright", b"1e99", b"-1"])
def test_an_exposure_that_is_none_is_damage(tmp_path: Path, told) -> None:
    hdr(tmp_path / "a.hdr", b"EXPOSURE=" + told + b"\n")
    with pytest.raises(FileDamagedError, match="its EXPOSURE"):
        read_radiance(tmp_path / "a.hdr")


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
    np.testing.assert_array_equal(read_codes(tmp_path / "a.png")[0], picture)
    alpha = np.random.default_rng(1).integers(0, 256, (9, 13, 1), dtype=np.uint8)
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "rgba.png")
    np.testing.assert_array_equal(read_codes(tmp_path / "rgba.png")[0], picture)


def png_of(width: int, height: int, depth: int, colour: int, interlaced: int = 0) -> bytes:
    """A black PNG of bytes that deflate cannot make fewer; ``colour``: the header's own number."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour]
    adam7 = [(0, 8, 0, 8), (4, 8, 0, 8), (0, 4, 4, 8), (2, 4, 0, 4), (0, 2, 2, 4), (1, 2, 0, 2), (0, 1, 1, 2)]
    raw = 0
    for x, across, y, down in adam7 if interlaced else [(0, 1, 0, 1)]:
        columns, rows = len(range(x, width, across)), len(range(y, height, down))
        raw += rows * (1 + (columns * channels * depth + 7) // 8) if columns else 0
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(raw), 9)), (b"IEND", b"")]
    if colour == 3:
        chunks.insert(1, (b"PLTE", bytes(3)))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


@pytest.mark.parametrize("interlaced", [0, 1])
@pytest.mark.parametrize(
    ("depth", "colour"),
    [
        (1, 0),
        (2, 0),
        (4, 0),
        (8, 0),
        (8, 2),
        (16, 2),
        (1, 3),
        (2, 3),
        (4, 3),
        (8, 3),
        (8, 4),
        (16, 4),
        (8, 6),
    ],
)
def test_a_black_png_may_be_as_small_as_it_can_be(tmp_path: Path, depth, colour, interlaced) -> None:
    """A frame that is black is no damage, of whatever kind of PNG."""
    path = tmp_path / "black.png"
    path.write_bytes(png_of(1600, 1200, depth, colour, interlaced))
    picture, _ = read_codes(path)
    assert picture.shape == (1200, 1600, 3) and not picture.any()


def test_a_png_that_claims_more_than_deflate_can_hold_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    whole = png_of(100, 80, 8, 0)
    size = struct.pack(">II", 100, 80)
    assert whole.count(size) == 1
    header = b"IHDR" + struct.pack(">II", 11585, 11585) + whole[24:29]
    path.write_bytes(whole[:12] + header + struct.pack(">I", zlib.crc32(header)) + whole[33:])
    for read in (picture_size, read_codes):
        with pytest.raises(FileDamagedError, match=r"a\.png .*claims 11585×11585 pixels of 1 channels"):
            read(path)


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


# ---- hostile files -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("never_waits")
@pytest.mark.parametrize("read", [read_exr, read_layers, read_codes, picture_size])
def test_a_pipe_is_no_picture(tmp_path: Path, read) -> None:
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(FileDamagedError, match=r"pipe\.exr is a pipe, not a file"):
        read(tmp_path / "pipe.exr")


def write_deep(path: Path, kind: OpenEXR.Storage) -> bytes:
    """A deep picture: each pixel has two values."""
    pixels = np.empty((4, 4), object)
    for place in np.ndindex(4, 4):
        pixels[place] = np.ones(2, np.float32)
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": kind}
    if kind == OpenEXR.deeptile:
        header["tiles"] = OpenEXR.TileDescription()
    OpenEXR.File(header, {name: pixels for name in "RGB"}).write(str(path))
    return path.read_bytes()


@pytest.mark.parametrize("kind", [OpenEXR.deepscanline, OpenEXR.deeptile])
@pytest.mark.parametrize("read", [read_exr, read_layers])
def test_deep_pictures_are_refused_whole_or_damaged(
    tmp_path: Path, fuzzing: ModuleType, kind: OpenEXR.Storage, read
) -> None:
    path = tmp_path / "deep.exr"
    whole = write_deep(path, kind)
    with pytest.raises(
        FileDamagedError, match=r"deep\.exr is not a readable OpenEXR picture .*it is a deep EXR"
    ):
        read(path)
    for damaged in fuzzing.mutations(whole, 60, 1):
        path.write_bytes(damaged)
        with pytest.raises(FileDamagedError, match=r"deep\.exr is not a readable "):
            read(path)


def test_a_deep_tiled_file_that_says_it_is_a_flat_one(tmp_path: Path) -> None:
    """As OpenEXR's own broken files: the version's bits and the header's type contradict each other."""
    path = tmp_path / "deep.exr"
    whole = write_deep(path, OpenEXR.deeptile)
    told = b"type\0string\0" + struct.pack("<i", 8) + b"deeptile"
    assert whole.count(told) == 1
    for name in (b"tiledimage", b"scanlineimage", b"deepscanline", b"", b"deeptilx"):
        path.write_bytes(whole.replace(told, b"type\0string\0" + struct.pack("<i", len(name)) + name))
        for read in (read_exr, read_layers):
            with pytest.raises(FileDamagedError, match=r"deep\.exr is not a readable "):
                read(path)


@pytest.mark.parametrize("compression", ["ZIP", "RLE", "PIZ", "DWAA", "B44", "PXR24", "NO"])
@pytest.mark.parametrize("kind", [OpenEXR.scanlineimage, OpenEXR.tiledimage])
def test_damage_of_every_kind_of_exr(
    tmp_path: Path, radiance: np.ndarray, fuzzing: ModuleType, compression: str, kind: OpenEXR.Storage
) -> None:
    path = tmp_path / "a.exr"
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": kind}
    if kind == OpenEXR.tiledimage:
        header["tiles"] = OpenEXR.TileDescription()
    OpenEXR.File(header, {"RGB": radiance}).write(str(path))
    for case, damaged in enumerate(fuzzing.mutations(path.read_bytes(), 25, 7)):
        path.write_bytes(damaged)
        for read in (read_exr, read_layers):
            try:
                read(path)
            except PhysHDRError as error:
                assert "a.exr" in error.message, f"case {case}"


def test_a_name_of_a_channel_that_is_no_text(tmp_path: Path) -> None:
    """The binding raises where the name is asked for, long after it opened the file."""
    header = {"type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"depth": np.ones((4, 5), np.float32)}).write(str(tmp_path / "a.exr"))
    raw = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(raw.replace(b"depth\0", b"dep\xffh\0"))
    for read in (read_exr, read_layers):
        with pytest.raises(FileDamagedError, match=r"a\.exr is not a readable OpenEXR picture"):
            read(tmp_path / "a.exr")


def test_many_channels_in_a_small_file_take_no_memory(tmp_path: Path) -> None:
    """Width and height alone would pass: 1900×1900 in 11 kB; with 500 channels they are 7 GB."""
    pixel = np.zeros((1, 1), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {f"c{k:03d}": pixel for k in range(500)}).write(
        str(tmp_path / "a.exr")
    )
    raw = (tmp_path / "a.exr").read_bytes()
    window, large = struct.pack("<4i", 0, 0, 0, 0), struct.pack("<4i", 0, 0, 1899, 1899)
    raw = raw.replace(b"box2i\0\x10\0\0\0" + window, b"box2i\0\x10\0\0\0" + large)
    (tmp_path / "a.exr").write_bytes(raw)
    with pytest.raises(FileDamagedError, match="claims a 6885 MB image from a 10827 byte file"):
        read_layers(tmp_path / "a.exr")


@pytest.mark.parametrize("value", [3e38, -2e12])
def test_a_radiance_that_nothing_has(tmp_path: Path, radiance: np.ndarray, value: float) -> None:
    radiance[5, 7, 1] = value
    write_exr(tmp_path / "a.exr", radiance)
    with pytest.raises(BadValueError, match=r"a\.exr holds the radiance .*: no more than 1e\+12"):
        read_exr(tmp_path / "a.exr")
