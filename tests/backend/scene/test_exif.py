# SPDX-License-Identifier: GPL-3.0-or-later
"""EXIF of PNGs: wherever it stands, and at what price."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, PngImagePlugin

from physhdr.backend.scene.exif import orientation_of, read_exif, tags_of_file


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def of_half_a_second() -> bytes:
    """A block of EXIF, without the header that JPEG has before it."""
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.ExposureTime] = 0.5
    return exif.tobytes().removeprefix(b"Exif\0\0")


def raw_profile(kind: bytes) -> bytes:
    """EXIF as ImageMagick writes it into a text: hexadecimal digits below a heading."""
    block = b"Exif\0\0" + of_half_a_second()
    text = f"\nexif\n{len(block):8}\n{block.hex()}\n".encode()
    packed = b"\0" + zlib.compress(text) if kind == b"zTXt" else text
    return chunk(kind, b"Raw profile type exif\0" + packed)


def write_png(path: Path, before: bytes = b"", behind: bytes = b"") -> Path:
    """A picture with chunks before and behind its pixels."""
    pixels = np.random.default_rng(0).integers(0, 256, (200, 300, 3), np.uint8)
    Image.fromarray(pixels).save(path)
    whole = path.read_bytes()
    first, last = whole.index(b"IDAT") - 4, len(whole) - 12
    path.write_bytes(whole[:first] + before + whole[first:last] + behind + whole[last:])
    return path


TOLD = {
    "eXIf": chunk(b"eXIf", of_half_a_second()),
    "zTXt": raw_profile(b"zTXt"),
    "tEXt": raw_profile(b"tEXt"),
}


@pytest.mark.parametrize("kind", TOLD)
@pytest.mark.parametrize("where", ["before", "behind"])
def test_exif_of_a_png_is_found_before_and_behind_its_pixels(tmp_path: Path, kind: str, where: str) -> None:
    path = write_png(tmp_path / "a.png", **{where: TOLD[kind]})
    assert read_exif(path).time == pytest.approx(0.5)


def test_a_png_without_exif_is_not_decoded_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a data set asks for the EXIF of each picture: decoding them takes minutes."""
    path = write_png(tmp_path / "a.png", behind=chunk(b"tEXt", b"date:create\x002026-05-01T12:00:00"))
    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load", lambda picture: pytest.fail("it was decoded"))
    assert tags_of_file(path) == {}


def test_xmp_behind_the_pixels_tells_how_a_picture_lies(tmp_path: Path) -> None:
    xmp = b'<x:xmpmeta><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    behind = chunk(b"iTXt", b"XML:com.adobe.xmp" + bytes(5) + xmp)
    assert orientation_of(tags_of_file(write_png(tmp_path / "a.png", behind=behind))) == 6


@pytest.mark.parametrize("length", [5, 1 << 31, (1 << 32) - 1])
def test_damaged_chunks_of_a_png_tell_nothing(tmp_path: Path, length: int) -> None:
    behind = struct.pack(">I", length) + b"tEXtnote"
    path = write_png(tmp_path / "a.png", behind=behind)
    assert tags_of_file(path) == {}
    path.write_bytes(path.read_bytes()[:-15])
    assert tags_of_file(path) == {}
