# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG: splat-transform's own against what it decodes them to, pictures made here by hand, and bad files."""

import io
import json
import math
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.formats.sog import read_sog
from physhdr.bridge.affine import matrices_of
from physhdr.bridge.errors import FileDamagedError, PhysHDRError
from physhdr.bridge.splat_files import read_splat_file

COUNT, WIDTH, HEIGHT = 300, 20, 16
RNG = np.random.default_rng(3)
#: Bytes of each plane's pixels, and where the palette's labels point.
MEANS = RNG.integers(0, 256, (2, COUNT, 3))
QUATS = RNG.integers(60, 196, (COUNT, 3))
LARGEST = RNG.integers(0, 4, COUNT)
SCALES, SH0 = RNG.integers(0, 256, (COUNT, 3)), RNG.integers(0, 256, (COUNT, 4))
ENTRIES = 130
LABELS, PALETTE = RNG.integers(0, ENTRIES, COUNT), RNG.integers(0, 256, (ENTRIES, 8, 3))
CODES = {name: np.sort(RNG.normal(size=256)) for name in ("scales", "sh0", "shN")}


def webp(pixels: np.ndarray, width: int, height: int) -> bytes:
    """A lossless picture whose first pixels are these ``[n, 3 or 4]``."""
    whole = np.full((width * height, 4), 255, np.uint8)
    whole[: len(pixels), : pixels.shape[1]] = pixels
    file = io.BytesIO()
    Image.fromarray(whole.reshape(height, width, 4)).save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def a_set(version: int) -> dict[str, bytes]:
    """Files of a SOG of ``COUNT`` Gaussians of degree 2 (three palette rows of 64 entries)."""

    def of_each(pixels: np.ndarray) -> bytes:
        return webp(pixels, WIDTH, HEIGHT)

    palette = np.zeros((3, 64, 8, 3), np.uint8)
    palette.reshape(-1, 8, 3)[:ENTRIES] = PALETTE
    labels = np.stack([LABELS & 255, LABELS >> 8, 0 * LABELS], axis=1)
    quats = np.concatenate([QUATS, 252 + LARGEST[:, None]], axis=1)
    means = {"mins": [-1.0, -2.0, 0.0], "maxs": [1.5, 2.0, 0.5], "files": ["means_l.webp", "means_u.webp"]}
    parts = {"means": means, "quats": {"files": ["quats.webp"]}}
    parts |= {name: {"files": [f"{name}.webp"]} for name in ("scales", "sh0")}
    parts["shN"] = {"files": ["shN_centroids.webp", "shN_labels.webp"]}
    if version == 2:
        for name, codes in CODES.items():
            parts[name]["codebook"] = codes.tolist()
        parts["shN"] |= {"count": ENTRIES, "bands": 2}
        parts |= {"version": 2, "count": COUNT}
    else:
        parts["means"]["shape"] = [COUNT, 3]
        parts["scales"] |= {"mins": [-5.0, -6.0, -7.0], "maxs": [0.0, -1.0, 1.0]}
        parts["sh0"] |= {"mins": [-2.0, -1.0, 0.0, -6.0], "maxs": [2.0, 3.0, 4.0, 8.0]}
        parts["shN"] |= {"mins": -0.5, "maxs": 0.75}
    return {
        "meta.json": json.dumps(parts).encode(),
        "means_l.webp": of_each(MEANS[0]),
        "means_u.webp": of_each(MEANS[1]),
        "quats.webp": of_each(quats),
        "scales.webp": of_each(SCALES),
        "sh0.webp": of_each(SH0),
        "shN_labels.webp": of_each(labels),
        "shN_centroids.webp": webp(palette.reshape(-1, 3), 64 * 8, 3),
    }


def write(path: Path, files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    """As a zip, or as a folder where the name has no suffix."""
    if path.suffix:
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name, raw in files.items():
                archive.writestr(name, raw)
        return path
    path.mkdir()
    for name, raw in files.items():
        (path / name).write_bytes(raw)
    return path


def test_a_codebook_whose_first_number_was_left_out_goes_on_by_its_mean_step(tmp_path: Path) -> None:
    files = a_set(2)
    meta = json.loads(files["meta.json"])
    even = np.linspace(-4.0, 1.1, 256).tolist()
    meta["scales"]["codebook"] = even
    whole = read_sog(write(tmp_path / "a.sog", files | {"meta.json": json.dumps(meta).encode()}))
    meta["scales"]["codebook"] = [None, *even[1:]]
    # The others' mean step, of 254 steps, over 255: the format's readers have it so.
    first = even[1] + (even[1] - even[255]) / 255.0
    read = read_sog(write(tmp_path / "b.sog", files | {"meta.json": json.dumps(meta).encode()}))
    lost = SCALES == 0
    assert lost.any()
    np.testing.assert_allclose(read.scale[~lost], whole.scale[~lost], rtol=1e-6)
    np.testing.assert_allclose(read.scale[lost], np.exp(first), rtol=1e-6)
    meta["scales"]["codebook"] = [None, None, *even[2:]]
    with pytest.raises(FileDamagedError, match="list of 256 numbers"):
        read_sog(write(tmp_path / "c.sog", files | {"meta.json": json.dumps(meta).encode()}))


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("name", ["a.sog", "folder"])
def test_every_byte_is_what_the_format_says(tmp_path: Path, version: int, name: str) -> None:
    """A Gaussian at a time, by the format's own description, in plain Python."""
    read = read_sog(write(tmp_path / name, a_set(version)))
    assert read.count == COUNT
    for i in range(0, COUNT, 7):
        for axis, (low, high) in enumerate([(-1.0, 1.5), (-2.0, 2.0), (0.0, 0.5)]):
            whole = int(MEANS[0, i, axis]) + 256 * int(MEANS[1, i, axis])
            n = low + (high - low) * whole / 65535.0
            place = math.copysign(math.exp(abs(n)) - 1.0, n)
            assert read.position[i, axis] == pytest.approx(place, rel=1e-6, abs=1e-7)
        small = [(int(code) / 255.0 - 0.5) * math.sqrt(2.0) for code in QUATS[i]]
        quaternion = list(small)
        quaternion.insert(int(LARGEST[i]), math.sqrt(1.0 - sum(c * c for c in small)))
        np.testing.assert_allclose(read.rotation[i], quaternion, atol=1e-6)
        for c in range(3):
            if version == 2:
                scale, dc = CODES["scales"][SCALES[i, c]], CODES["sh0"][SH0[i, c]]
                rest = CODES["shN"][PALETTE[LABELS[i], :, c]]
            else:
                scale = (-5.0, -6.0, -7.0)[c] + (5.0, 5.0, 8.0)[c] * SCALES[i, c] / 255.0
                dc = (-2.0, -1.0, 0.0)[c] + 4.0 * SH0[i, c] / 255.0
                rest = -0.5 + 1.25 * PALETTE[LABELS[i], :, c] / 255.0
            assert read.scale[i, c] == pytest.approx(math.exp(scale), rel=1e-5)
            assert read.colour_sh[i, 0, c] == pytest.approx(dc, rel=1e-5, abs=1e-6)
            np.testing.assert_allclose(read.colour_sh[i, 1:, c], rest, rtol=1e-5, atol=1e-6)
        alpha = SH0[i, 3] / 255.0 if version == 2 else 1.0 / (1.0 + math.exp(6.0 - 14.0 * SH0[i, 3] / 255.0))
        assert read.opacity[i] == pytest.approx(alpha, rel=1e-5, abs=1e-7)


def assert_decoded(one, other) -> None:
    """Equal but for floats' rounding; its decoder keeps opacities 1e-6 from 0 and 1."""
    np.testing.assert_allclose(one.position, other.position, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.scale, other.scale, rtol=1e-5)
    np.testing.assert_allclose(one.opacity, other.opacity, atol=2e-6)
    np.testing.assert_allclose(one.colour_sh, other.colour_sh, atol=1e-6)
    np.testing.assert_allclose(matrices_of(one.rotation), matrices_of(other.rotation), atol=1e-5)


def test_what_splat_transform_wrote_is_what_it_reads(files: Path) -> None:
    assert_decoded(read_sog(files / "gaussians.sog"), read_splat_file(files / "decoded.ply"))


def test_splat_transform_as_it_is_installed(cloud, tmp_path: Path, splat_transform, physhdr_ply) -> None:
    physhdr_ply(tmp_path / "a.ply", cloud)
    (tmp_path / "folder").mkdir()
    for name in ("a.sog", "folder/meta.json"):
        splat_transform(tmp_path / "a.ply", tmp_path / name)
        splat_transform(tmp_path / name, tmp_path / "decoded.ply")
        assert_decoded(read_sog(tmp_path / name), read_splat_file(tmp_path / "decoded.ply"))


# -- bad files -----------------------------------------------------------------------------------------------


def refused(path: Path) -> str:
    with pytest.raises(PhysHDRError) as caught:
        read_sog(path)
    return str(caught.value)


def test_a_file_that_is_cut_off_is_refused_wherever(tmp_path: Path) -> None:
    raw = write(tmp_path / "a.sog", a_set(2)).read_bytes()
    for size in [0, 1, 4, *range(30, len(raw), 499), len(raw) - 1]:
        (tmp_path / "b.sog").write_bytes(raw[:size])
        assert "b.sog" in refused(tmp_path / "b.sog")


@pytest.mark.parametrize("name", sorted(a_set(2)))
def test_each_file_that_is_missing_or_damaged_is_named(tmp_path: Path, name: str) -> None:
    files = a_set(2)
    lacking = {each: raw for each, raw in files.items() if each != name}
    assert name in refused(write(tmp_path / "lacking.sog", lacking))
    if name != "meta.json":
        assert name in refused(write(tmp_path / "lacking", lacking))
    assert name in refused(
        write(tmp_path / "damaged.sog", files | {name: files[name][: len(files[name]) // 2]})
    )


def changed(files: dict[str, bytes], **changes) -> dict[str, bytes]:
    """``part__key=value`` in the meta.json."""
    meta = json.loads(files["meta.json"])
    for name, value in changes.items():
        part, _, key = name.partition("__")
        if key:
            meta[part][key] = value
        else:
            meta[part] = value
    return files | {"meta.json": json.dumps(meta).encode()}


@pytest.mark.parametrize(
    "change, told",
    [
        ({"count": 1 << 62}, "claims 4611686018427387904 Gaussians"),
        ({"count": 100_000_000}, "claims 100000000 Gaussians in"),
        ({"count": 321}, "has 20×16 pixels"),
        ({"count": -1}, "claims -1"),
        ({"count": True}, "claims True"),
        ({"version": 3}, "version 3"),
        ({"means__files": ["../../../etc/passwd", "means_u.webp"]}, "etc/passwd"),
        ({"means__files": ["/etc/passwd", "means_u.webp"]}, "etc/passwd"),
        ({"means__files": []}, "names no picture"),
        ({"means__mins": [0.0, 1.0]}, "list of 3 numbers"),
        ({"means__mins": [0.0, 1.0, float("nan")]}, "list of 3 numbers"),
        ({"scales__codebook": [0.0] * 255}, "list of 256 numbers"),
        ({"shN__bands": 7}, "degree 7"),
        ({"shN__bands": 3}, "pixels"),
        ({"sh0": None}, "no sh0"),
    ],
)
@pytest.mark.parametrize("name", ["a.sog", "folder"])
def test_what_cannot_be_is_refused(tmp_path: Path, change, told: str, name: str) -> None:
    assert told in refused(write(tmp_path / name, changed(a_set(2), **change)))


def test_a_member_of_ten_gigabytes_is_refused(tmp_path: Path) -> None:
    """By what the archive claims; and where it claims less than comes, when more than that has come."""
    path = write(tmp_path / "a.sog", a_set(2), zipfile.ZIP_DEFLATED)
    raw = bytearray(path.read_bytes())
    at = raw.rfind(b"PK\x01\x02", 0, raw.rfind(b"means_l.webp"))
    struct.pack_into("<I", raw, at + 24, 0xFFFFFFF0)  # its size, as the directory at the end has it
    path.write_bytes(raw)
    assert "claims 4294967280 bytes" in refused(path)
    bomb = a_set(2) | {"quats.webp": bytes(200_000_000)}
    assert "claims 200000000 bytes" in refused(write(tmp_path / "b.sog", bomb, zipfile.ZIP_DEFLATED))


def test_a_small_picture_of_many_pixels_is_refused_unopened(tmp_path: Path, monkeypatch) -> None:
    """16,383 × 16,383 pixels of one colour are a few kilobytes, and a gigabyte when they are decoded."""
    header = b"\x2f" + (16382 | 16382 << 14).to_bytes(4, "little")
    body = b"VP8L" + struct.pack("<I", 1000) + header + bytes(995)
    files = a_set(2) | {"scales.webp": b"RIFF" + struct.pack("<I", 4 + len(body)) + b"WEBP" + body}
    opened = []
    monkeypatch.setattr(Image, "open", lambda *a, **k: opened.append(a) or pytest.fail("opened"))
    with pytest.raises(FileDamagedError, match="16383×16383"):
        read_sog(write(tmp_path / "a.sog", files | {n: files["scales.webp"] for n in files if "webp" in n}))
    assert not opened
