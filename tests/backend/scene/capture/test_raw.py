# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw files come out as what went in: DNGs that tifffile writes, read by LibRaw."""

import sys

import numpy as np
import pytest

from physhdr.backend.scene.capture import raw
from physhdr.backend.scene.capture.exposures import exposures_from_exif
from physhdr.backend.scene.capture.noise import Noise, estimated
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.bridge.errors import PhysHDRError

BLACK, WHITE = 512, 15000


def wanted(codes, white_balance=(1.0, 1.0, 1.0)):
    """0…65535 of a sensor's codes ``[H, W, 3]``, in float64."""
    return 65535.0 * np.clip((codes - BLACK) / (WHITE - BLACK) * white_balance, 0.0, 1.0)


def developed(folder):
    """The only photo in a folder as a data set has it."""
    return find_photos(folder).photos[0].codes()[0].astype(float)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_linear_dng_comes_out_within_one_code_everywhere(dng, tmp_path, orientation):
    """Every code from below black to above white, whichever way the camera was held."""
    codes = np.random.default_rng(0).integers(400, 16000, (40, 60, 3)).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE, orientation=orientation)
    upright = np.rot90(wanted(codes.astype(float)), {1: 0, 3: 2, 6: 3, 8: 1}[orientation])
    photo = find_photos(tmp_path).photos[0]
    assert (photo.width, photo.height) == upright.shape[1::-1] and photo.orientation == orientation
    assert np.abs(developed(tmp_path) - upright).max() <= 1.0


@pytest.mark.parametrize("neutral", [(1.0, 1.0, 1.0), (0.5, 1.0, 0.7), (1.0, 0.8, 0.4)])
def test_a_mosaic_comes_out_within_one_code_where_it_is_flat(dng, tmp_path, neutral):
    """Squares of 16 × 16, clipped ones among them; white balance is the camera's, its smallest factor 1."""
    squares = np.random.default_rng(1).uniform(600, 15000, (4, 6, 3)).round()
    squares[0, 0] = 16383
    codes = np.kron(squares, np.ones((16, 16, 1)))
    dng.write_dng(tmp_path / "a.dng", dng.mosaic(codes).astype(np.uint16), BLACK, WHITE, neutral)
    white_balance = 1.0 / np.array(neutral)
    middle = developed(tmp_path)[8::16, 8::16]
    difference = middle - wanted(squares, white_balance / white_balance.min())
    assert np.abs(difference).max() <= 1.0
    assert (middle[0, 0] == 65535).all()


def test_the_cameras_colours_become_those_of_rec_709(dng, tmp_path):
    """A camera with other primaries, by the DNG specification's matrices in float64; white stays white."""
    mixed = np.array([[0.7, 0.2, 0.1], [0.15, 0.8, 0.05], [0.05, 0.25, 0.7]])
    scene = np.random.default_rng(2).uniform(0.05, 0.6, (40, 60, 3))
    scene[:5] = 0.5
    codes = np.rint(BLACK + (WHITE - BLACK) * scene @ mixed.T).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE, camera_from_xyz=mixed @ dng.XYZ_TO_REC709)
    found = developed(tmp_path) / 65535.0
    # The file has its matrix to six digits, the sensor its codes to 1/14488, and unmixing triples that.
    assert np.abs(found - scene).max() < 3e-4
    assert np.abs(found[:5] - 0.5).max() < 1.5e-4


def test_where_one_channel_alone_is_full_the_colour_is_not_compared(dng, tmp_path):
    """…if a shorter exposure shows it."""
    codes = np.full((40, 60, 3), 5000, np.uint16)
    codes[:, :10, 0] = 16000
    codes[:, 10:15] = 16000
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    photo = find_photos(tmp_path).photos[0]
    assert photo.codes()[1] is None
    keep = photo.codes(shorter=True)[1]
    assert not keep[:, :10].any() and keep[:, 10:].all()


def test_one_white_balance_for_all_and_exposures_at_iso_100(dng, tmp_path):
    """The middle one of three; time × ISO / 100."""
    grey = np.full((40, 60, 3), 5000, np.uint16)
    for name, red, seconds, iso in (("a", 0.5, 0.01, 100), ("b", 0.52, 0.01, 400), ("c", 0.9, 0.04, 100)):
        dng.write_dng(tmp_path / f"{name}.dng", grey, BLACK, WHITE, (red, 1.0, 1.0), seconds, iso)
    found = find_photos(tmp_path)
    assert [photo.white_balance for photo in found.photos] == [pytest.approx((1 / 0.52, 1.0, 1.0))] * 3
    assert any("b.dng, the middle one of 3" in note for note in found.notes)
    seconds = exposures_from_exif(found.photos).seconds
    assert seconds == pytest.approx({"a.dng": 0.01, "b.dng": 0.04, "c.dng": 0.04})


def test_of_a_raw_file_and_its_jpeg_the_raw_file_is_used(dng, room, tmp_path):
    codes = np.full((40, 60), 5000, np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    room.write_photo(tmp_path / "a.jpg", np.full((40, 60, 3), 90, np.uint8))
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["a.dng"] and not found.skipped
    assert "1 photos are there as raw file and as picture" in found.notes[0]


def test_damaged_raw_files_and_none_without_rawpy(dng, tmp_path, monkeypatch):
    codes = np.full((40, 60), 5000, np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    (tmp_path / "b.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:100])
    (tmp_path / "c.nef").write_bytes(b"no raw file")
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["a.dng"]
    assert {each.name for each in found.skipped} == {"b.dng", "c.nef"}
    assert all("not a raw file that LibRaw can read" in each.why for each in found.skipped)
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(PhysHDRError, match="pip install rawpy"):
        find_photos(tmp_path)


# ---- noise -------------------------------------------------------------------------------------------


def test_the_noise_that_a_file_tells(dng, tmp_path):
    for name, told in (("a", (2e-4, 3e-6)), ("b", (1e-4, 1e-6, 2e-4, 3e-6, 5e-4, 9e-6)), ("c", ())):
        codes = np.full((40, 60), 5000, np.uint16)
        dng.write_dng(tmp_path / f"{name}.dng", codes, BLACK, WHITE, noise=told)
    assert [photo.noise for photo in find_photos(tmp_path).photos] == [Noise(2e-4, 3e-6)] * 2 + [None]


@pytest.mark.parametrize(("slope", "offset"), [(2e-4, 2e-6), (2e-3, 5e-5)])
def test_the_noise_that_a_mosaic_shows(dng, tmp_path, slope, offset):
    """Squares and slopes of known noise, some of them clipped: found within 10 %, its offset within 30 %."""
    random = np.random.default_rng(4)
    signal = np.kron(random.uniform(0.01, 1.1, (16, 24)), np.ones((48, 48)))
    signal += 0.05 * np.linspace(0.0, 1.0, signal.shape[1])
    seen = signal + random.normal(size=signal.shape) * np.sqrt(slope * signal + offset)
    codes = np.rint(BLACK + (WHITE - BLACK) * seen).clip(0, WHITE).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    found = estimated(raw.photosites(tmp_path / "a.dng"))
    assert found is not None
    assert found.slope == pytest.approx(slope, rel=0.1) and found.offset == pytest.approx(offset, rel=0.3)


def test_no_noise_is_made_up_of_a_picture_without_flat_places(dng, tmp_path):
    assert estimated([np.full((100, 100), 0.5)]) is None
    codes = np.random.default_rng(0).integers(600, 9000, (40, 60, 3)).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    assert raw.photosites(tmp_path / "a.dng") == []
