# SPDX-License-Identifier: GPL-3.0-or-later
"""What EXIF says, exposures from it and from files, and one clear message for what is missing."""

import json
from datetime import datetime

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.scene.capture.exposures import exposures_from_exif, exposures_from_file
from physhdr.backend.scene.capture.photos import find_photos, natural_order
from physhdr.bridge.errors import PhysHDRError

GREY = np.full((20, 30, 3), 90, np.uint8)
NOON = datetime(2026, 5, 1, 12, 0, 0)


def refused(call, *arguments):
    with pytest.raises(PhysHDRError) as caught:
        call(*arguments)
    assert caught.value.hint
    return str(caught.value)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_exif_of_every_kind_of_file(room, tmp_path, suffix):
    room.write_photo(
        tmp_path / f"a{suffix}",
        GREY,
        1 / 60,
        NOON,
        200,
        5.6,
        FocalLengthIn35mmFilm=28,
        SubsecTimeOriginal="25",
    )
    photo = find_photos(tmp_path)[0]
    assert (photo.width, photo.height, photo.iso) == (30, 20, 200)
    assert photo.shutter == pytest.approx(1 / 60, rel=1e-3) and photo.f_number == pytest.approx(5.6)
    assert photo.taken == datetime(2026, 5, 1, 12, 0, 0, 250_000)
    assert photo.focal_pixels == pytest.approx(28 / 36 * 30)  # film is 36 mm wide


def test_exposure_is_time_times_iso_over_aperture_squared(room, tmp_path):
    """A stop is a stop, whichever of the three it comes from."""
    for name, seconds, iso, f_number in [("a", 0.1, 100, 8.0), ("b", 0.2, 100, 8.0), ("c", 0.1, 200, 8.0)]:
        room.write_photo(tmp_path / f"{name}.jpg", GREY, seconds, NOON, iso, f_number)
    room.write_photo(tmp_path / "d.jpg", GREY, 0.1, NOON, 100, 4.0)
    found = exposures_from_exif(find_photos(tmp_path))
    assert found.seconds == pytest.approx({"a.jpg": 0.1, "b.jpg": 0.2, "c.jpg": 0.2, "d.jpg": 0.4})
    assert "ISO 100" in found.meaning and "f/8" in found.meaning


def test_apex_values_stand_in_and_a_manual_lens_cancels(room, tmp_path):
    for name, speed in (("a", 3), ("b", 1)):
        room.write_photo(tmp_path / f"{name}.jpg", GREY, iso=400, ShutterSpeedValue=float(speed))
    found = exposures_from_exif(find_photos(tmp_path))
    assert found.seconds == pytest.approx({"a.jpg": 4 * 2.0**-3, "b.jpg": 4 * 2.0**-1})
    assert "one aperture that EXIF does not tell" in found.meaning


def test_a_photo_lies_upright_as_its_tag_says(room, tmp_path):
    pixels = GREY.copy()
    pixels[0, :, 0] = 255  # the top edge as stored
    room.write_photo(tmp_path / "a.png", pixels, 1.0, Orientation=6)  # turn by 90° clockwise to show it
    photo = find_photos(tmp_path)[0]
    upright = np.asarray(photo.decode())
    assert (photo.width, photo.height) == (20, 30) == upright.shape[1::-1]
    assert (upright[:, -1, 0] == 255).all() and (upright[:, 0, 0] == 90).all()


def test_names_in_natural_order():
    assert sorted(["p10", "p9", "P1", "p"], key=natural_order) == ["p", "P1", "p9", "p10"]


def test_exposures_from_files(room, tmp_path):
    for name in ("a", "b"):
        room.write_photo(tmp_path / f"{name}.jpg", GREY)
    photos = find_photos(tmp_path)
    (tmp_path / "e.json").write_text(json.dumps({"a.jpg": 0.5, "b": 2, "elsewhere.jpg": 9}))
    (tmp_path / "e.csv").write_text("name,seconds\na.jpg,1/2\nb.jpg, 2\n")
    for file in ("e.json", "e.csv"):
        assert exposures_from_file(tmp_path / file, photos).seconds == {"a.jpg": 0.5, "b.jpg": 2.0}


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("e.json", '{"a.jpg": 1}', "no exposure for 1 of 2 photos: b.jpg"),
        ("e.json", '{"a.jpg": 1, "b.jpg": 0}', "gives b.jpg the exposure 0"),
        ("e.json", '{"a.jpg": 1, "b.jpg": "fast"}', "'fast'"),
        ("e.json", '{"a.jpg": 1, "b.jpg": NaN}', "nan"),
        ("e.json", "[1, 2]", "holds a list, not an object"),
        ("e.json", "{", "not valid JSON"),
        ("e.csv", "a.jpg\nb.jpg\n", "line 1 is not 'name,seconds'"),
    ],
)
def test_bad_files_of_exposures(room, tmp_path, name, text, words):
    for photo in ("a", "b"):
        room.write_photo(tmp_path / f"{photo}.jpg", GREY)
    (tmp_path / name).write_text(text)
    assert words in refused(exposures_from_file, tmp_path / name, find_photos(tmp_path))


def test_missing_exif_is_named_with_the_remedy(room, tmp_path):
    room.write_photo(tmp_path / "a.jpg", GREY, 1.0, iso=100)
    room.write_photo(tmp_path / "b.jpg", GREY)
    message = refused(exposures_from_exif, find_photos(tmp_path))
    assert "1 of 2 photos do not tell its exposure time" in message
    assert "b.jpg" in message and "--exposures" in message
    room.write_photo(tmp_path / "b.jpg", GREY, 1.0)
    assert "ISO" in refused(exposures_from_exif, find_photos(tmp_path))


def test_folders_without_photos(room, tmp_path):
    assert "does not exist" in refused(find_photos, tmp_path / "nowhere")
    assert "holds no photos" in refused(find_photos, tmp_path)
    (tmp_path / "ev0").mkdir()
    assert "only folders (ev0)" in refused(find_photos, tmp_path)
    (tmp_path / "a.NEF").write_bytes(b"raw")
    assert "Develop them" in refused(find_photos, tmp_path)


def test_photos_that_cannot_be_used(room, tmp_path):
    room.write_photo(tmp_path / "a.jpg", GREY)
    room.write_photo(tmp_path / "b.jpg", GREY)
    room.write_photo(tmp_path / "c.jpg", GREY[:10])
    message = refused(find_photos, tmp_path)
    assert "2 of 30×20, 1 of 30×10" in message and "c.jpg is 30×10" in message
    (tmp_path / "c.jpg").write_bytes(b"no picture")
    assert "c.jpg is not a readable photo" in refused(find_photos, tmp_path)
    (tmp_path / "c.jpg").unlink()
    Image.fromarray(np.zeros((20, 30), np.uint16)).save(tmp_path / "d.png")
    assert "8-bit" in refused(find_photos, tmp_path)
    (tmp_path / "d.png").unlink()
    (tmp_path / "b.jpg").unlink()
    room.write_photo(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 256, (90, 90, 3), np.uint8))
    whole = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) // 2])
    assert "a.jpg is not a readable photo" in refused(find_photos(tmp_path)[0].decode)
