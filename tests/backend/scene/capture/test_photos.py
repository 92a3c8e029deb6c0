# SPDX-License-Identifier: GPL-3.0-or-later
"""What EXIF says, exposures from it and from files, and one clear message for what is missing."""

import json
import os
import struct
import sys
import unicodedata
import warnings
from datetime import datetime
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from PIL import ExifTags, Image, ImageOps

from physhdr.backend.scene import pictures
from physhdr.backend.scene.capture.exposures import exposures_from_exif, exposures_from_file
from physhdr.backend.scene.capture.photos import find_photos, natural_order
from physhdr.backend.scene.source import is_white
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
    photo = find_photos(tmp_path).photos[0]
    assert (photo.width, photo.height, photo.iso) == (30, 20, 200)
    assert photo.shutter == pytest.approx(1 / 60, rel=1e-3) and photo.f_number == pytest.approx(5.6)
    assert photo.taken == datetime(2026, 5, 1, 12, 0, 0, 250_000)
    assert photo.focal_pixels == pytest.approx(28 / 36 * 30)  # film is 36 mm wide


def test_exposure_is_time_times_iso_over_aperture_squared(room, tmp_path):
    """A stop is a stop, whichever of the three it comes from."""
    for name, seconds, iso, f_number in [("a", 0.1, 100, 8.0), ("b", 0.2, 100, 8.0), ("c", 0.1, 200, 8.0)]:
        room.write_photo(tmp_path / f"{name}.jpg", GREY, seconds, NOON, iso, f_number)
    room.write_photo(tmp_path / "d.jpg", GREY, 0.1, NOON, 100, 4.0)
    found = exposures_from_exif(find_photos(tmp_path).photos)
    assert found.seconds == pytest.approx({"a.jpg": 0.1, "b.jpg": 0.2, "c.jpg": 0.2, "d.jpg": 0.4})
    assert "ISO 100" in found.meaning and "f/8" in found.meaning


def test_apex_values_stand_in_and_a_manual_lens_cancels(room, tmp_path):
    for name, speed in (("a", 3), ("b", 1)):
        room.write_photo(tmp_path / f"{name}.jpg", GREY, iso=400, ShutterSpeedValue=float(speed))
    found = exposures_from_exif(find_photos(tmp_path).photos)
    assert found.seconds == pytest.approx({"a.jpg": 4 * 2.0**-3, "b.jpg": 4 * 2.0**-1})
    assert "one aperture that EXIF does not tell" in found.meaning


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_a_photo_lies_upright_as_its_tag_says(room, tmp_path, suffix):
    pixels = GREY.copy()
    pixels[0, :, 0] = 255  # the top edge as stored
    room.write_photo(tmp_path / f"a.{suffix}", pixels, 1.0, Orientation=6)  # turn by 90° clockwise to show it
    photo = find_photos(tmp_path).photos[0]
    upright = np.asarray(photo.decode())
    assert (photo.width, photo.height) == (20, 30) == upright.shape[1::-1]
    assert (upright[:, -1, 0] == 255).all() and (upright[:, 0, 0] == 90).all()


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_photos_and_masks_lie_upright_as_pillow_turns_them(room, tmp_path, suffix, orientation):
    """A TIFF once: Pillow turns it on its own."""
    random = np.random.default_rng(orientation)
    (tmp_path / "masks").mkdir()
    for path in (tmp_path / f"a.{suffix}", tmp_path / "masks" / "a.png"):
        pixels = random.integers(0, 256, (4, 6, 3), np.uint8)
        room.write_photo(path, pixels, Orientation=orientation)
    photo = find_photos(tmp_path).photos[0]
    with Image.open(photo.path) as picture:
        upright = ImageOps.exif_transpose(picture)
        np.testing.assert_array_equal(photo.decode(), upright)
    assert (photo.width, photo.height) == upright.size and photo.orientation == orientation
    with Image.open(tmp_path / "masks" / "a.png") as picture:
        shades = np.asarray(ImageOps.exif_transpose(picture)).max(axis=2)
        np.testing.assert_array_equal(photo.keep(), shades >= 128)


def test_a_photo_whose_tags_cannot_be_written_again_is_sound(tmp_path):
    """A resolution in letters, as Pillow reads it and cannot write it: EXIF made by hand."""
    entries = [(0x0112, 3, 1, struct.pack("<HH", 6, 0)), (0x011A, 2, 3, b"72\0\0")]
    directory = b"".join(struct.pack("<HHI", *entry[:3]) + entry[3] for entry in entries)
    exif = b"Exif\0\0II*\0" + struct.pack("<IH", 8, len(entries)) + directory + bytes(4)
    pixels = np.repeat(np.repeat(GREY[:2, :3], 8, axis=0), 8, axis=1)
    pixels[:8] = 250  # the top as stored: at the right, when it is turned by 90° clockwise
    (tmp_path / "masks").mkdir()
    for path in (tmp_path / "a.jpg", tmp_path / "masks" / "a.png"):
        Image.fromarray(pixels).save(path, exif=exif)
    photo = find_photos(tmp_path).photos[0]
    wanted = np.full((24, 16), 90)
    wanted[:, 8:] = 250
    np.testing.assert_allclose(np.asarray(photo.decode())[..., 1], wanted, atol=2)
    np.testing.assert_array_equal(photo.keep(), wanted > 128)


def write_deep(path, codes, orientation):
    """A photo of 16 bits a channel by another program's writer, half a second long, as raw converters do."""
    spec = OpenImageIO.ImageSpec(codes.shape[1], codes.shape[0], 3, "uint16")
    spec["Orientation"], spec["ExposureTime"] = orientation, 0.5
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec) and writer.write_image(codes)
    writer.close()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_sixteen_bits_are_kept_and_lie_upright(tmp_path, orientation):
    codes = np.random.default_rng(orientation).integers(0, 65536, (4, 6, 3)).astype(np.uint16)
    write_deep(tmp_path / "a.tif", codes, orientation)
    photo = find_photos(tmp_path).photos[0]
    assert photo.deep and photo.shutter == 0.5
    for part, of in ((codes >> 8, photo.codes()[0] >> 8), (codes & 255, photo.codes()[0] & 255)):
        picture = Image.fromarray(part.astype(np.uint8))
        picture.getexif()[ExifTags.Base.Orientation] = orientation
        np.testing.assert_array_equal(np.asarray(ImageOps.exif_transpose(picture)), of)
    assert (photo.width, photo.height) == photo.decode().size == photo.codes()[0].shape[1::-1]
    assert np.abs(np.asarray(photo.decode()) * 257.0 - photo.codes()[0]).max() <= 128.5


def test_sixteen_bits_of_a_png_are_kept_and_a_damaged_one_is_named(tmp_path):
    codes = np.random.default_rng(0).integers(0, 65536, (40, 60, 3)).astype(np.uint16)
    for name in ("a.png", "b.tif"):
        write_deep(tmp_path / name, codes, 1)
    for photo in find_photos(tmp_path).photos:
        np.testing.assert_array_equal(photo.codes()[0], codes)
        whole = photo.path.read_bytes()
        photo.path.write_bytes(whole[: len(whole) // 2])
        message = refused(photo.codes)
        assert photo.name in message and "Copy it again" in message


def test_names_in_natural_order():
    assert sorted(["p10", "p9", "P1", "p"], key=natural_order) == ["p", "P1", "p9", "p10"]
    assert sorted(["5²1", "5", "10"], key=natural_order) == ["5", "5²1", "10"]  # ² is a digit, but no number


@pytest.mark.parametrize("export", [".png", ".tif", ".jpeg"])
def test_what_a_program_exported_of_a_photo_is_no_second_photo(room, tmp_path, export):
    """Of photos and as many exports, the photos; of many and a few, the many."""
    camera, few = tmp_path / "camera", tmp_path / "few"
    for folder in (camera, few):
        folder.mkdir()
        for number in range(3):
            exposed = GREY, 1 / (60 << number), NOON
            room.write_photo(folder / f"DSC_{number}{export}", *exposed)
            if folder is camera or number == 1:
                room.write_photo(folder / f"DSC_{number}.JPG", *exposed)
    found = find_photos(camera)
    assert [photo.name for photo in found.photos] == ["DSC_0.JPG", "DSC_1.JPG", "DSC_2.JPG"]
    assert found.notes == [f"3 photos are there as .JPG and as {export}: the .JPG files are used"]
    found = find_photos(few)
    assert [photo.name for photo in found.photos] == [f"DSC_{number}{export}" for number in range(3)]
    assert found.notes == [f"1 photos are there as {export} and as .JPG: the {export} files are used"]


def test_a_picture_that_is_no_export_does_not_outweigh_the_photos(room, tmp_path):
    """IMG_0 … IMG_2 as JPG and PNG, and a chart: the PNGs tell no exposure."""
    for number in range(3):
        room.write_photo(tmp_path / f"IMG_{number}.JPG", GREY, 1 / (60 << number), NOON)
        Image.fromarray(GREY).save(tmp_path / f"IMG_{number}.png")
    Image.fromarray(GREY).save(tmp_path / "chart.png")
    found = find_photos(tmp_path)
    assert found.notes == ["3 photos are there as .JPG and as .png: the .JPG files are used"]
    assert {f"IMG_{number}.JPG" for number in range(3)} <= {photo.name for photo in found.photos}


def test_a_damaged_photo_gives_way_to_what_was_exported_of_it(room, tmp_path):
    for number in range(3):
        room.write_photo(tmp_path / f"IMG_{number}.jpg", GREY, 1 / (60 << number), NOON)
    room.write_photo(tmp_path / "IMG_1.tif", GREY, 1 / 120, NOON)
    (tmp_path / "IMG_1.jpg").write_bytes((tmp_path / "IMG_1.jpg").read_bytes()[:30])
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["IMG_0.jpg", "IMG_1.tif", "IMG_2.jpg"]
    assert found.notes == [
        "1 photos are there as .tif and as .jpg: the .tif files are used, for IMG_1.jpg cannot be read"
    ]
    assert not found.skipped and not found.damaged


def test_a_fraction_of_a_second_that_is_no_number_is_left_aside(room, tmp_path):
    path = tmp_path / "a.jpg"
    room.write_photo(path, GREY, 1.0, NOON, SubsecTimeOriginal="@7")
    whole = path.read_bytes()
    assert whole.count(b"@7") == 1
    path.write_bytes(whole.replace(b"@7", b"\xb27"))  # Latin-1's ²
    assert find_photos(tmp_path).photos[0].taken == NOON


def test_digital_zoom_is_another_lens(room, tmp_path):
    """Phones tell it by the focal length on film, by the ratio (0: not used), or by both."""
    tags = {
        "a": {"FocalLengthIn35mmFilm": 24},
        "b": {"FocalLengthIn35mmFilm": 24, "DigitalZoomRatio": 0},
        "c": {"FocalLengthIn35mmFilm": 24, "DigitalZoomRatio": 1},
        "d": {"FocalLengthIn35mmFilm": 48},
        "e": {"FocalLengthIn35mmFilm": 24, "DigitalZoomRatio": 2},
        "f": {"FocalLengthIn35mmFilm": 48, "DigitalZoomRatio": 2},
    }
    for name, more in tags.items():
        room.write_photo(tmp_path / f"{name}.jpg", GREY, 1.0, FocalLength=6.8, **more)
    a, b, c, *zoomed = [photo.lens for photo in find_photos(tmp_path).photos]
    assert a == b == c and len({a, *zoomed}) == 4


def test_exposures_from_files(room, tmp_path):
    for name in ("a", "b"):
        room.write_photo(tmp_path / f"{name}.jpg", GREY)
    photos = find_photos(tmp_path).photos
    (tmp_path / "e.json").write_text(json.dumps({"a.jpg": 0.5, "b": 2, "elsewhere.jpg": 9}))
    (tmp_path / "e.csv").write_text("name,seconds\na.jpg,1/2\nb.jpg, 2\n")
    for file in ("e.json", "e.csv"):
        assert exposures_from_file(tmp_path / file, photos).seconds == {"a.jpg": 0.5, "b.jpg": 2.0}


@pytest.mark.parametrize(
    "text",
    [
        "Datei;Sekunden\na.jpg;0,5\nb.jpg;2\n",  # Excel's CSV where decimals have a comma
        "Datei\tSekunden\r\na.jpg\t0,5\r\n\r\nb.jpg\t2,0\r\n",
        "a.jpg\t1/2\nb.jpg\t2.0\n",
        'name;seconds;note\n"a.jpg";"0,5";lamp, window\nb.jpg;2;\n',
        '"a.jpg",0.5,"lamp; window"\nb.jpg, 2\n',
        "a.jpg;0,5\nb.jpg;2\nmoon, stars.jpg;9,5\n",
    ],
)
def test_tables_of_exposures_as_spreadsheets_write_them(room, tmp_path, text):
    for name in ("a", "b", "moon, stars") if "moon" in text else ("a", "b"):
        room.write_photo(tmp_path / f"{name}.jpg", GREY)
    (tmp_path / "e.csv").write_bytes(text.encode())
    found = exposures_from_file(tmp_path / "e.csv", find_photos(tmp_path).photos)
    assert found.seconds.pop("moon, stars.jpg", 9.5) == 9.5
    assert found.seconds == {"a.jpg": 0.5, "b.jpg": 2.0}


def test_names_in_files_of_exposures_may_be_spelled_in_another_way(room, tmp_path):
    """By a system that tells no case, or that spells ü by two characters; what is the same goes before."""
    nfd, nfc = (unicodedata.normalize(form, "Küche.jpg") for form in ("NFD", "NFC"))
    for name in ("a.jpg", "B.jpg", nfd):
        room.write_photo(tmp_path / name, GREY)
    table = {"A.JPG": 9, "a.jpg": 0.5, "b": 2, nfc: 4}
    (tmp_path / "e.json").write_text(json.dumps(table))
    found = exposures_from_file(tmp_path / "e.json", find_photos(tmp_path).photos)
    assert found.seconds == {"a.jpg": 0.5, "B.jpg": 2.0, nfd: 4.0}


def test_an_exposure_may_be_told_twice_in_two_ways(room, tmp_path):
    """As of two cards that hold the same photo; 1/2 is 0.5."""
    room.write_photo(tmp_path / "a.jpg", GREY)
    (tmp_path / "e.csv").write_text("a.jpg,0.5\na.jpg,1/2\na.jpg,0.50\n")
    found = exposures_from_file(tmp_path / "e.csv", find_photos(tmp_path).photos)
    assert found.seconds == {"a.jpg": 0.5}


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
        (
            "e.csv",
            "SourceFile,ISO,ExposureTime\na.jpg,100,1/60\nb.jpg,100,1/4\n",
            "its column 3 holds numbers",
        ),
        (
            "e.csv",
            "name,EV100,seconds\na.jpg,3,1/60\nb.jpg,2,1/4\n",
            "two columns are wanted, name and seconds",
        ),
        ("e.csv", "a.jpg,0,5\nb.jpg,1,5\n", "its column 3 holds numbers, too"),
        (
            "e.csv",
            "name,1/s\na.jpg,60\nb.jpg,4\n",
            "its second column is called '1/s', and seconds are wanted",
        ),
        ("e.csv", "a.jpg,1\nb.jpg,2\na.jpg,4\n", "'a.jpg' has two exposures, 1 and 4"),
    ],
)
def test_bad_files_of_exposures(room, tmp_path, name, text, words):
    for photo in ("a", "b"):
        room.write_photo(tmp_path / f"{photo}.jpg", GREY)
    (tmp_path / name).write_text(text)
    assert words in refused(exposures_from_file, tmp_path / name, find_photos(tmp_path).photos)


def test_missing_exif_is_named_with_the_remedy(room, tmp_path):
    room.write_photo(tmp_path / "a.jpg", GREY, 1.0, iso=100)
    room.write_photo(tmp_path / "b.jpg", GREY)
    message = refused(exposures_from_exif, find_photos(tmp_path).photos)
    assert "1 of 2 photos do not state its exposure time" in message
    assert "b.jpg" in message and "--exposures" in message
    room.write_photo(tmp_path / "b.jpg", GREY, 1.0)
    assert "ISO" in refused(exposures_from_exif, find_photos(tmp_path).photos)


def test_folders_without_photos(room, tmp_path):
    assert "does not exist" in refused(find_photos, tmp_path / "nowhere")
    assert "holds no photos" in refused(find_photos, tmp_path)
    (tmp_path / "ev0").mkdir()
    assert "only folders (ev0)" in refused(find_photos, tmp_path)
    (tmp_path / "a.mp4").write_bytes(b"video")
    message = refused(find_photos, tmp_path)
    assert "but 1 videos" in message and "ffmpeg -i a.mp4" in message


def test_what_is_no_photo_is_skipped_and_named(room, tmp_path):
    """One damaged file, one for printers, a video, a note: the others are used."""
    for name in ("a", "b"):
        room.write_photo(tmp_path / f"{name}.jpg", GREY)
    (tmp_path / "c.jpg").write_bytes(b"no picture")
    Image.new("CMYK", (30, 20)).save(tmp_path / "d.jpg")
    (tmp_path / "e.MOV").write_bytes(b"video")
    (tmp_path / "._a.jpg").write_bytes(b"what macOS leaves on other systems' disks")
    (tmp_path / "notes.txt").write_text("mine")
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["a.jpg", "b.jpg"]
    why = {each.name: each.why for each in found.skipped}
    assert list(why) == ["c.jpg", "d.jpg", "e.MOV"]
    assert (
        "not a readable photo" in why["c.jpg"]
        and "CMYK" in why["d.jpg"]
        and "Save it again as JPEG" in why["d.jpg"]
        and "ffmpeg -i e.MOV" in why["e.MOV"]
    )
    for name in ("a", "b"):
        (tmp_path / f"{name}.jpg").unlink()
    assert "c.jpg is not a readable photo" in refused(find_photos, tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_names_that_are_not_utf_8_are_refused(room, tmp_path):
    """As Latin-1 in an old archive spells them: JSON could not name them in the data set."""
    room.write_photo(tmp_path / "a.jpg", GREY)
    for k, name in enumerate((b"K\xfcche.jpg", b"T\xfcr.mp4")):
        (tmp_path / os.fsdecode(name)).write_bytes((tmp_path / "a.jpg").read_bytes())
        message = refused(find_photos, tmp_path)
        assert ("K\\udcfcche.jpg" in message) and ("2 files" in message) == (k == 1)
        assert "not UTF-8" in message and "Rename" in message and message.encode("utf-8")


def test_a_photo_of_more_pixels_than_are_read_has_a_remedy(room, tmp_path):
    room.write_photo(tmp_path / "a.jpg", GREY)
    path = tmp_path / "a.jpg"
    content = path.read_bytes()
    start = content.index(b"\xff\xc0\x00\x11\x08") + 5
    path.write_bytes(content[:start] + struct.pack(">HH", 10_000, 20_000) + content[start + 4 :])
    message = refused(find_photos, tmp_path)
    assert "a.jpg has more pixels than are read" in message
    assert "178 million pixels at most, or make them smaller" in message


def test_a_photo_of_many_pixels_is_no_suspect(room, tmp_path, monkeypatch):
    """Pillow warns of an attack from 89 million pixels on, once for each time it opens one."""
    (tmp_path / "masks").mkdir()
    for path in (tmp_path / "a.jpg", tmp_path / "masks" / "a.png"):
        room.write_photo(path, GREY)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 400)  # of 600
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        photo = find_photos(tmp_path).photos[0]
        photo.check_mask()
        assert photo.codes()[0].shape == (20, 30, 3)


def test_a_photo_may_have_more_pixels_than_a_picture_of_a_data_set(room, tmp_path, monkeypatch):
    """Backs of 150 million pixels: what is written of their photos is smaller. Pillow's limit holds."""
    room.write_photo(tmp_path / "a.jpg", GREY)
    monkeypatch.setattr(pictures, "MAX_PIXELS", 500)  # of 600
    assert find_photos(tmp_path).photos[0].codes()[0].shape == (20, 30, 3)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 299)
    assert "a.jpg has more pixels than are read" in refused(find_photos, tmp_path)


def test_a_photo_that_ends_too_early_is_found_when_it_is_decoded(room, tmp_path):
    room.write_photo(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 256, (90, 90, 3), np.uint8))
    whole = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) // 2])
    assert "a.jpg is not a readable photo" in refused(find_photos(tmp_path).photos[0].decode)


def test_another_cameras_photos_are_left_out_and_both_ways_up_are_not(room, tmp_path):
    for name in ("a", "b", "c"):
        room.write_photo(tmp_path / f"{name}.jpg", GREY, Orientation=6 if name == "c" else 1)
    pixels = Image.fromarray(GREY)
    exif = Image.Exif()
    exif[271], exif[272] = "Other", "Camera"
    pixels.save(tmp_path / "d.jpg", exif=exif)
    found = find_photos(tmp_path)
    assert [(photo.name, photo.width, photo.height) for photo in found.photos] == [
        ("a.jpg", 30, 20),
        ("b.jpg", 30, 20),
        ("c.jpg", 20, 30),
    ]
    assert [each.name for each in found.skipped] == ["d.jpg"]
    assert "taken by Other Camera, most others by Room" in found.skipped[0].why


def test_pictures_of_everything_around_have_a_remedy(tmp_path):
    """Two to one from nothing that has a lens, or the file says so; a phone's two to one has a lens."""
    wide = Image.new("RGB", (1200, 600))
    wide.save(tmp_path / "pano.jpg")
    message = refused(find_photos, tmp_path)
    assert "360°" in message and "v360=e:flat" in message and "pano.jpg" in message
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    wide.save(tmp_path / "phone.jpg", exif=exif.tobytes())
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["phone.jpg"]
    assert [(each.name, each.why) for each in found.skipped] == [("pano.jpg", "is a 360° picture")]
    xmp = b'<x:xmpmeta xmlns:GPano="g"><a GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
    Image.new("RGB", (1300, 600)).save(tmp_path / "said.jpg", xmp=xmp)
    assert [each.name for each in find_photos(tmp_path).skipped] == ["pano.jpg", "said.jpg"]


def test_masks_beside_or_in_the_folder(room, tmp_path):
    folder = tmp_path / "photos"
    for masks in (folder / "masks", tmp_path / "masks"):
        masks.mkdir(parents=True)
    for name in ("a", "b", "c"):
        room.write_photo(folder / f"{name}.jpg", GREY)
    mask = np.full((20, 30), 255, np.uint8)
    mask[:, :10] = 0
    Image.fromarray(mask).save(folder / "masks" / "a.png")
    Image.fromarray(mask[:10]).save(tmp_path / "masks" / "b.jpg.png")
    message = refused(find_photos, folder)  # before anything else is done with the photos
    assert "b.jpg.png is 30×10, its photo b.jpg is 30×20" in message
    Image.fromarray(mask.T).save(tmp_path / "masks" / "b.jpg.png")
    assert "b.jpg.png is 20×30" in refused(find_photos, folder)
    Image.fromarray(mask[:, ::-1]).save(tmp_path / "masks" / "b.jpg.png")
    a, b, c = find_photos(folder).photos
    np.testing.assert_array_equal(a.keep(), mask > 0)
    np.testing.assert_array_equal(b.keep(), mask[:, ::-1] > 0)
    assert c.keep() is None
    (folder / "masks" / "a.png").write_bytes(b"no picture")
    assert "a.png is not a readable mask" in refused(find_photos, folder)


def test_masks_of_names_that_are_as_good_as_the_photos(room, tmp_path):
    """Another suffix or case; accents as macOS spells them; and one exactly so goes before."""
    masks, mask = tmp_path / "masks", Image.fromarray(np.zeros((20, 30), np.uint8))
    masks.mkdir()
    photos = ["A_1.JPG", "A_2.jpg", "A_3.jpg", "A_4.jpg", unicodedata.normalize("NFD", "Küche.jpg"), "Z.jpg"]
    for name in photos:
        room.write_photo(tmp_path / name, GREY)
    others = [
        "A_1.PNG",
        "A_2.jpg",
        "a_3.png",
        "A_4.png",
        "a_4.jpg",
        unicodedata.normalize("NFC", "Küche.png"),
    ]
    for name in (*others, "A_5.png", "A_6.png"):
        mask.save(masks / name)
    (masks / "notes.txt").write_text("mine")
    found = find_photos(tmp_path)
    named = {photo.name: photo.mask.name for photo in found.photos if photo.mask is not None}
    assert named == dict(zip(photos, [*others[:4], others[5]], strict=False))
    (warning,) = found.warnings
    assert warning.startswith(f"2 masks in {masks}") and "A_5.png …" in warning


def test_a_folder_of_photos_by_its_shortest_name_has_masks_beside_it(room, tmp_path, monkeypatch):
    """And one that is called masks holds no masks of its own photos."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "masks").mkdir()
    for name in ("photos/a.jpg", "masks/a.png"):
        room.write_photo(tmp_path / name, GREY)
    monkeypatch.chdir(tmp_path / "photos")
    assert find_photos(Path(".")).photos[0].mask == tmp_path / "masks" / "a.png"
    assert find_photos(tmp_path / "masks").photos[0].mask is None


def test_masks_of_sixteen_bits_are_white_from_the_middle_on(room, tmp_path):
    """As masks of eight are; and where there is nothing but 1 and 0, 1 is white."""
    (tmp_path / "masks").mkdir()
    room.write_photo(tmp_path / "a.jpg", GREY)
    shades = np.random.default_rng(0).integers(0, 65536, (20, 30)).astype(np.uint16)
    shades[0, :4] = 0, 3000, 32767, 32768
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6  # turn by 90° clockwise to show it
    for codes in (shades, shades // 32768):
        Image.fromarray(np.rot90(codes).copy()).save(tmp_path / "masks" / "a.png", exif=exif)
        photo = find_photos(tmp_path).photos[0]
        np.testing.assert_array_equal(photo.keep(), shades > 32767)
    whole = photo.mask.read_bytes()
    photo.mask.write_bytes(whole[: len(whole) // 2])
    assert "a.png" in (message := refused(photo.keep)) and "Copy it again" in message


@pytest.mark.parametrize("is_palette", [False, True])
def test_coloured_masks_are_as_white_as_in_a_data_set(room, tmp_path, is_palette):
    """By their brightest channel: red, and the dark red of the first label, which are dark as greys."""
    (tmp_path / "masks").mkdir()
    room.write_photo(tmp_path / "a.jpg", GREY)
    labels = np.zeros((20, 30), np.uint8)
    labels[5:, 10:] = 1
    picture = Image.fromarray(np.stack([255 * labels, 0 * labels, 0 * labels], axis=2))
    if is_palette:
        picture = Image.fromarray(labels).convert("P")
        picture.putpalette([0, 0, 0, 128, 0, 0])
    picture.save(path := tmp_path / "masks" / "a.png")
    keep = find_photos(tmp_path).photos[0].keep()
    np.testing.assert_array_equal(keep, labels == 1)
    np.testing.assert_array_equal(keep, is_white(pictures.read_codes(path)[0].max(axis=2), 255))


# ---- exposures of phones and drones --------------------------------------------------------------------


def exposures_of(folder):
    return exposures_from_exif(find_photos(folder).photos)


def test_apex_time_and_aperture_are_those_of_the_other_tags(room, tmp_path):
    """Tv 5 is 1/32 s, Av 3 is f/2.83: half the area of f/2."""
    room.write_photo(tmp_path / "a.jpg", GREY, iso=100, ShutterSpeedValue=5.0, ApertureValue=3.0)
    room.write_photo(tmp_path / "b.jpg", GREY, 1 / 32, iso=100, f_number=2.0)
    photos = {photo.name: photo for photo in find_photos(tmp_path).photos}
    assert photos["a.jpg"].shutter == 1 / 32 and photos["a.jpg"].f_number == pytest.approx(2.0**1.5)
    seconds = exposures_of(tmp_path).seconds
    assert seconds["b.jpg"] / seconds["a.jpg"] == pytest.approx(2.0, rel=1e-4)


def test_the_exposure_bias_alone_is_relative(room, tmp_path):
    """Tags as drones that bracket leave them after an editor: no time, no ISO, only −2, 0, +2."""
    for name, bias in (("a", -2.0), ("b", 0.0), ("c", 2.0)):
        room.write_photo(tmp_path / f"{name}.jpg", GREY, ExposureBiasValue=bias)
    found = exposures_of(tmp_path)
    assert found.seconds == {"a.jpg": 0.25, "b.jpg": 1.0, "c.jpg": 4.0} and "relative" in found.meaning
    for name in ("a", "c"):  # all at 0 say nothing
        room.write_photo(tmp_path / f"{name}.jpg", GREY, ExposureBiasValue=0.0)
    assert "no photo states its exposure time" in refused(exposures_of, tmp_path)


def test_the_brightness_value_stands_in_for_the_time(room, tmp_path):
    """As a photo with all tags has it: Av + Tv = Bv + Sv, Sv 5 at ISO 100, and one stop more asked for."""
    aperture, time, sensitivity = 4.0, 6.0, 7.0  # f/4, 1/64 s, ISO 400
    brightness = aperture + time - sensitivity
    room.write_photo(tmp_path / "a.jpg", GREY, BrightnessValue=brightness)
    room.write_photo(tmp_path / "b.jpg", GREY, BrightnessValue=brightness, ExposureBiasValue=1.0)
    found = exposures_of(tmp_path)
    assert found.seconds == pytest.approx({"a.jpg": 2.0**-time * 4 / 16, "b.jpg": 2.0**-time * 8 / 16})
    assert "brightness" in found.meaning


def test_an_iso_that_nobody_tells_cancels(room, tmp_path):
    for name, seconds in (("a", 0.1), ("b", 0.4)):
        room.write_photo(tmp_path / f"{name}.jpg", GREY, seconds, f_number=4.0)
    found = exposures_of(tmp_path)
    assert found.seconds == pytest.approx({"a.jpg": 0.1, "b.jpg": 0.4})
    assert "one ISO that EXIF does not tell" in found.meaning
