# SPDX-License-Identifier: GPL-3.0-or-later
"""Every format, written by other programs of the same Gaussians, read within its own quantisation step.

``tests/fixtures/splat_files.zip`` has the files, the PLY that they are of, and which program wrote which.
"""

import gzip
import importlib.util
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.affine import matrices_of
from physhdr.bridge.axes import turn_of_up
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.gaussian_import import read_gaussians
from physhdr.bridge.gaussian_ply import SH_C0
from physhdr.bridge.splat_files import SplatCloud, read_splat_file, turned, write_spz
from physhdr.bridge.splat_files.usable import ANTIALIASED_NOTE, taken

needs_zstd = pytest.mark.skipif(
    sys.version_info < (3, 14) and importlib.util.find_spec("zstandard") is None,
    reason="SPZ 4 needs the package zstandard, or Python 3.14",
)


@pytest.fixture(scope="session")
def source(files: Path) -> SplatCloud:
    return read_splat_file(files / "source.ply")


@dataclass(frozen=True)
class Step:
    """The largest differences that a format's numbers allow."""

    position: float
    log_scale: float
    #: Radians between an ellipsoid's axes.
    turn: float
    opacity: float
    colour: float
    #: Of SH band 1, 2 and 3; as many as the format has.
    bands: tuple[float, ...]


def half(steps: float) -> float:
    return 0.5 / steps


#: SPZ: 12 bits behind the point; 1/16 of ln scale; sign and 9 bits of a quaternion; 0.15 of colour in a byte;
#: SH of 5 and 4 bits, which the reference writer finds by rounding twice.
SPZ = Step(
    half(4096) * 1.01, half(16) * 1.001, 0.006, half(255) * 1.001, half(0.15 * 255) * SH_C0 * 1.01,
    (half(16) + 1 / 256, half(8) + 1 / 256, half(8) + 1 / 256),
)  # fmt: skip
#: Ours has as many bits behind the point as the scene leaves: 19 for one that reaches less than 16 m.
OURS = Step(
    half(1 << 19) * 1.01, SPZ.log_scale, SPZ.turn, SPZ.opacity, SPZ.colour,
    (half(16) * 1.001, half(8) * 1.001, half(8) * 1.001),
)  # fmt: skip
#: Three bytes of a quaternion, whose w follows: near 0 it is known to no better than √(2/127.5).
FIRST_THREE = Step(SPZ.position, SPZ.log_scale, 0.35, SPZ.opacity, SPZ.colour, SPZ.bands)
#: Bounds of 256 Gaussians that spread over 20 m and 6 of ln scale; 10 bits of a quaternion; SH 1/32 apart.
CHUNKS = Step(20 * half(1023), 6 * half(1023), 0.006, half(255) * 1.001, half(255) * 1.01, (half(32),) * 3)
#: Bytes that were cut off, not rounded.
SPLAT = Step(0.0, 1e-6, 0.04, 1 / 255, 1 / 255, ())
#: Floats, but bytes for colours.
KSPLAT_0 = Step(0.0, 1e-6, 1e-3, 1 / 255, 1 / 255, (1e-6,))
#: 16 bits over a bucket of 5 m; half floats, whose steps are 2⁻¹¹ of the number.
KSPLAT_1 = Step(5 * half(65534) * 1.01, 2.0**-10, 2e-3, 1 / 255, 1 / 255, (1e-3,))
#: SH in bytes between their bounds, −1.7 and 1.7 at most.
KSPLAT_2 = Step(
    KSPLAT_1.position, KSPLAT_1.log_scale, 2e-3, 1 / 255, 1 / 255, (3.4 * half(255), 3.4 * half(255))
)


def check(found: SplatCloud, expected: SplatCloud, step: Step) -> None:
    """``found`` is ``expected`` in any order, to within ``step``."""
    assert found.count == expected.count
    distance = np.linalg.norm(found.position[:, None] - expected.position, axis=2)
    order = distance.argmin(axis=0)
    assert len(set(order.tolist())) == found.count
    found = taken(found, order)
    assert np.abs(found.position - expected.position).max() <= step.position
    assert np.abs(np.log(found.scale) - np.log(expected.scale)).max() <= step.log_scale
    np.testing.assert_allclose(np.linalg.norm(found.rotation, axis=1), 1.0, atol=1e-6)
    # An axis that is turned half about is the same ellipsoid.
    axes = np.einsum("nki,nkj->nij", matrices_of(expected.rotation), matrices_of(found.rotation))
    cosines = np.abs(np.diagonal(axes, axis1=1, axis2=2))
    assert np.arccos(np.minimum(cosines, 1.0)).max() <= step.turn
    assert np.abs(found.opacity - expected.opacity).max() <= step.opacity
    difference = np.abs(found.colour_sh - expected.colour_sh[:, : found.colour_sh.shape[1]])
    assert difference[:, 0].max() * SH_C0 <= step.colour
    assert found.colour_sh.shape[1] == (1 + len(step.bands)) ** 2
    for band, allowed in enumerate(step.bands, start=1):
        largest = difference[:, band**2 : (band + 1) ** 2].max()
        assert largest <= allowed, f"band {band}"
        assert allowed < 1e-2 or largest > 0.5 * allowed, "the step is not the format's"
    assert found.notes == ()


@pytest.mark.parametrize(
    ("name", "up", "step"),
    [
        ("version-2.spz", "y", FIRST_THREE),
        ("version-3.spz", "y", SPZ),
        pytest.param("version-4.spz", "y", SPZ, marks=needs_zstd),
        ("chunks.compressed.ply", "colmap", CHUNKS),
        ("gaussians.splat", "colmap", SPLAT),
        ("level-0.ksplat", "colmap", KSPLAT_0),
        ("level-1.ksplat", "colmap", KSPLAT_1),
        ("level-2.ksplat", "colmap", KSPLAT_2),
    ],
)
def test_what_other_programs_wrote(files: Path, source: SplatCloud, name: str, up: str, step: Step) -> None:
    found = read_splat_file(files / name)
    assert found.up == up
    check(found, source, step)


def test_formats_are_told_by_their_first_bytes(files: Path, source: SplatCloud, tmp_path: Path) -> None:
    shutil.copy(files / "version-3.spz", tmp_path / "a.ply")
    shutil.copy(files / "source.ply", tmp_path / "a.splat")
    check(read_splat_file(tmp_path / "a.ply"), source, SPZ)
    assert read_splat_file(tmp_path / "a.splat").count == source.count


def test_turned_as_the_formats_own_library_turns(files: Path, source: SplatCloud) -> None:
    """Its writer was told that the PLY is right-down-forward, and turned it to right-up-backward."""
    check(read_splat_file(files / "turned.spz"), turned(source, turn_of_up("colmap", "y")), SPZ)


def test_every_format_becomes_the_same_model(files: Path) -> None:
    """As Blender imports it: radiance toward one direction, which coarse SH shift by a tenth or so."""
    expected = read_gaussians(files / "source.ply")
    for name in ("version-3.spz", "chunks.compressed.ply"):
        found = read_gaussians(files / name)
        assert found.colour_sh is not None and found.left_out == 0
        assert any("linearised" in note for note in found.notes)
        order = np.linalg.norm(found.model.position[:, None] - expected.model.position, axis=2).argmin(axis=0)
        ours = found.model.radiance(np.broadcast_to(np.float32([0, 0.6, 0.8]), found.model.position.shape))
        theirs = expected.model.radiance(
            np.broadcast_to(np.float32([0, 0.6, 0.8]), (expected.model.count, 3))
        )
        assert np.median(np.abs(np.log(ours[order] / theirs))) < 0.15


# ---- writing SPZ -------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [3, pytest.param(4, marks=needs_zstd)])
def test_our_spz_is_read_back(tmp_path: Path, source: SplatCloud, version: int) -> None:
    write_spz(tmp_path / "a.spz", source, version)
    check(read_splat_file(tmp_path / "a.spz"), source, OURS)
    first = (tmp_path / "a.spz").read_bytes()
    write_spz(tmp_path / "a.spz", source, version)
    assert (tmp_path / "a.spz").read_bytes() == first, "the same Gaussians, the same bytes"


@pytest.mark.parametrize("version", [3, pytest.param(4, marks=needs_zstd)])
@pytest.mark.parametrize("coefficients", [1, 4, 9])
def test_spz_of_lower_degrees(tmp_path: Path, source: SplatCloud, version: int, coefficients: int) -> None:
    narrow = SplatCloud(
        source.position, source.rotation, source.scale, source.opacity, source.colour_sh[:, :coefficients]
    )
    write_spz(tmp_path / "a.spz", narrow, version)
    found = read_splat_file(tmp_path / "a.spz")
    assert found.colour_sh.shape == narrow.colour_sh.shape
    assert np.abs(found.colour_sh - narrow.colour_sh)[:, 1:].max(initial=0.0) <= half(8) * 1.001


def test_an_spz_of_what_is_far_away_has_fewer_bits(tmp_path: Path, source: SplatCloud) -> None:
    far = SplatCloud(
        source.position * np.float32(5000.0), source.rotation, source.scale, source.opacity, source.colour_sh
    )
    write_spz(tmp_path / "a.spz", far, 3)
    found = read_splat_file(tmp_path / "a.spz").position
    assert np.abs(found - far.position).max() <= 0.5 * 2.0 * np.abs(far.position).max() / (1 << 23) * 2.0


def test_flat_and_saturated_gaussians_in_an_spz(tmp_path: Path, source: SplatCloud) -> None:
    scale, opacity = source.scale.copy(), source.opacity.copy()
    scale[:, 2], opacity[:10] = 0.0, 1.0
    cloud = SplatCloud(source.position, source.rotation, scale, opacity, source.colour_sh)
    write_spz(tmp_path / "a.spz", cloud, 3)
    found = read_splat_file(tmp_path / "a.spz")
    np.testing.assert_allclose(found.scale[:, 2], np.exp(-10.0), rtol=1e-5)
    assert (found.opacity[:10] == 1.0).all()


@pytest.mark.parametrize("reach, bits", [(0.9, 23), (1.5, 22), (100.0, 16), (2000.0, 12), (9e5, 3)])
def test_an_spz_has_the_finest_steps_that_reach_everything(
    tmp_path: Path, source: SplatCloud, reach: float, bits: int
) -> None:
    position = source.position * np.float32(reach / np.abs(source.position).max())
    cloud = replace(source, position=position)
    assert write_spz(tmp_path / "a.spz", cloud, 3) == ()
    assert gzip.decompress((tmp_path / "a.spz").read_bytes())[13] == bits
    found = read_splat_file(tmp_path / "a.spz").position.astype(np.float64)
    np.testing.assert_allclose(found, position, rtol=1e-7, atol=0.5 / 2.0**bits)


def test_what_an_spz_clips_is_counted(tmp_path: Path, source: SplatCloud) -> None:
    scale, sh = source.scale.copy(), source.colour_sh.copy()
    scale[:3, 0], scale[3, 2], scale[4] = 1e-5, 1000.0, np.exp(-10.0)  # the last is the smallest that it has
    sh[:, 1:] = sh[:, 1:].clip(-1.0, 1.0)
    sh[:, 0] = sh[:, 0].clip(-3.3, 3.3)
    sh[5, 7, 1], sh[6, 0, 2] = -1.2, 3.5
    cloud = replace(source, scale=scale, colour_sh=sh)
    [note] = write_spz(tmp_path / "a.spz", cloud, 3)
    assert "σ of 4 Gaussians" in note and "SH of 2 " in note
    found = read_splat_file(tmp_path / "a.spz")
    np.testing.assert_allclose(found.scale[:3, 0], 45e-6, rtol=0.01)  # as the note has it
    np.testing.assert_allclose(found.scale[3, 2], 379.0, rtol=0.01)


def test_an_spz_of_a_training_with_compensated_opacity_says_so(files: Path, tmp_path: Path) -> None:
    raw = bytearray(gzip.decompress((files / "version-3.spz").read_bytes()))
    raw[14] |= 1
    (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(raw)))
    assert read_splat_file(tmp_path / "a.spz").notes == (ANTIALIASED_NOTE,)


def test_other_versions_are_not_written(tmp_path: Path, source: SplatCloud) -> None:
    with pytest.raises(BadValueError, match=r"version 2 is not written\n.*3 and 4"):
        write_spz(tmp_path / "a.spz", source, 2)


# ---- the program itself ------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [3, pytest.param(4, marks=needs_zstd)])
def test_splat_transform_reads_our_spz(
    tmp_path: Path, source: SplatCloud, splat_transform: Callable[..., None], version: int
) -> None:
    write_spz(tmp_path / "a.spz", source, version)
    splat_transform(tmp_path / "a.spz", tmp_path / "b.ply")
    check(read_splat_file(tmp_path / "b.ply"), source, OURS)
