# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw files come out as what went in: DNGs that tifffile writes, read by LibRaw."""

import sys
from contextlib import contextmanager

import numpy as np
import pycolmap
import pytest
from PIL import Image

from physhdr.backend.scene.capture import raw
from physhdr.backend.scene.capture.brackets import find_brackets
from physhdr.backend.scene.capture.data_set import write_data_set
from physhdr.backend.scene.capture.exposures import exposures_from_exif
from physhdr.backend.scene.capture.noise import Noise, estimated
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.backend.scene.capture.structure import RegisteredPose, Structure
from physhdr.backend.scene.lens import make_lens
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


@pytest.fixture
def full_at(monkeypatch):
    """A function after which files tell where the sensor is full, as some cameras' do and no DNG does."""
    opened = raw.opened

    class Told:
        def __init__(self, file, levels):
            self.file, self.camera_white_level_per_channel = file, levels

        def __getattr__(self, name):
            return getattr(self.file, name)

    def told(*levels):
        @contextmanager
        def reopened(path):
            with opened(path) as file:
                yield Told(file, list(levels))

        monkeypatch.setattr(raw, "opened", reopened)

    return told


@pytest.mark.parametrize("is_mosaic", [True, False])
def test_a_sensor_that_is_full_below_the_white_level(dng, tmp_path, full_at, is_mosaic):
    """It is white there, not magenta; the divisor stays; nonsense that a file tells is passed over."""
    codes = np.full((40, 60, 3), 5000, np.uint16)
    codes[:, :20] = 15300
    codes[:, 20:30, 0] = 15300
    seen = dng.mosaic(codes) if is_mosaic else codes
    dng.write_dng(tmp_path / "a.dng", seen, 2048, 16383, (1 / 2, 1.0, 1 / 1.43))
    balance = find_photos(tmp_path).photos[0].white_balance
    green = 65535 * (15300 - 2048) / (16383 - 2048)
    before = raw.develop(tmp_path / "a.dng", balance)
    for levels in ((), (16383,) * 4, (20000,) * 4, (0,) * 4, (1000,) * 4, (3825,) * 4):
        full_at(*levels)
        found = raw.develop(tmp_path / "a.dng", balance)
        np.testing.assert_array_equal(found.picture, before.picture)
    np.testing.assert_allclose(before.picture[20, 10] * 65535, [65535, green, 65535], atol=1.0)
    full_at(15300, 15300, 15300, 0 if not is_mosaic else 15300)
    for half, (white, red, grey) in ((False, (10, 25, 50)), (True, (5, 12, 25))):
        found = raw.develop(tmp_path / "a.dng", balance, half)
        row = found.picture[found.picture.shape[0] // 2]
        assert (np.rint(65535 * row[white]) == 65535).all()
        partly = found.partly[found.picture.shape[0] // 2]
        assert (partly[white], partly[red], partly[grey]) == (False, True, False)
        unclipped = (5000 - 2048) / (16383 - 2048) * np.array(balance)
        np.testing.assert_allclose(row[grey], unclipped, atol=2e-5)


def test_of_a_hand_held_bracket_the_shortest_exposure_that_was_placed_is_compared(dng, tmp_path):
    """Of two photos that clip red alone the longer one is masked, though each is a pose by itself."""
    codes = np.full((40, 60, 3), 5000, np.uint16)
    codes[:10, :20, 0] = 16000
    photos, names = tmp_path / "photos", ("a_0", "a_1", "b_0", "b_1")
    photos.mkdir()
    for name, seconds in zip(names, (0.01, 0.04, 0.01, 0.04), strict=True):
        dng.write_dng(photos / f"{name}.dng", codes, BLACK, WHITE, seconds=seconds, iso=100)
    found = find_photos(photos).photos
    brackets = find_brackets(found, exposures_from_exif(found).seconds).apart()
    camera = pycolmap.Camera(model="PINHOLE", width=60, height=40, params=[50, 50, 30, 20])
    pose = RegisteredPose(1, np.eye(3), np.zeros(3), np.zeros((0, 2)), np.zeros(0, np.int64))
    registered = {number: pose for number in (0, 1, 3)}  # of place b the shorter one was not placed
    structure = Structure({1: camera}, registered, np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0))
    out = tmp_path / "out"
    out.mkdir()
    write_data_set(out, brackets, structure, {1: make_lens(camera, 1.0)}, 0, {})
    assert len(list((out / "images").iterdir())) == 3
    (mask,) = (out / "masks").iterdir()
    assert mask.name == "train_001_0.png"
    with Image.open(mask) as picture:
        keep = np.asarray(picture)
    assert not keep[:10, :20].any() and keep[12:].all() and keep[:, 22:].all()  # and what they reach


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


def test_the_noise_of_a_sensor_that_is_full_below_the_white_level(dng, tmp_path, full_at):
    """What it cuts off varies too little, and is no less noisy for that."""
    random, slope, offset, full = np.random.default_rng(5), 2e-4, 2e-6, 0.924
    signal = np.kron(random.uniform(0.01, 1.1, (16, 24)), np.ones((48, 48)))
    seen = signal + random.normal(size=signal.shape) * np.sqrt(slope * signal + offset)
    codes = np.rint(BLACK + (WHITE - BLACK) * seen.clip(max=full)).clip(0).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    full_at(*[int(codes.max())] * 4)
    found = estimated(raw.photosites(tmp_path / "a.dng"))
    assert found is not None and found.slope == pytest.approx(slope, rel=0.05)


def test_no_noise_is_made_up_of_a_picture_without_flat_places(dng, tmp_path):
    assert estimated([np.full((100, 100), 0.5)]) is None
    codes = np.random.default_rng(0).integers(600, 9000, (40, 60, 3)).astype(np.uint16)
    dng.write_dng(tmp_path / "a.dng", codes, BLACK, WHITE)
    assert raw.photosites(tmp_path / "a.dng") == []
