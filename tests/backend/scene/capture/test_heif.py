# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos in HEIC and AVIF: what is stored comes out, upright and in sRGB's primaries."""

import struct
import sys
from datetime import datetime

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms, ImageOps, TiffImagePlugin

from physhdr.backend.scene.capture import heif
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.backend.scene.pictures import kind_of, write_png
from physhdr.bridge.errors import FileDamagedError, PhysHDRError

SHAPE = (40, 60, 3)


def noise(bits=8, seed=0):
    return (
        np.random.default_rng(seed).integers(0, 1 << bits, SHAPE).astype(np.uint16 if bits > 8 else np.uint8)
    )


def smooth(height=160, width=240):
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x * 255 // width, y * 255 // height, (x + y) // 2 % 256], axis=2).astype(np.uint8)


def exif(orientation=1, seconds=1 / 60):
    """As a phone writes it."""
    tags = Image.Exif()
    tags[ExifTags.Base.Make], tags[ExifTags.Base.Model] = "Apple", "iPhone"
    tags[ExifTags.Base.Orientation] = orientation
    inner = tags.get_ifd(ExifTags.IFD.Exif)
    inner[ExifTags.Base.ExposureTime] = TiffImagePlugin.IFDRational(round(seconds * 1e6), 1_000_000)
    inner[ExifTags.Base.ISOSpeedRatings] = 64
    inner[ExifTags.Base.FNumber] = TiffImagePlugin.IFDRational(18, 10)
    inner[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    inner[ExifTags.Base.DateTimeOriginal] = "2026:05:01 12:00:00"
    inner[ExifTags.Base.SubsecTimeOriginal] = "250"
    return tags.tobytes()


def the_photo(folder):
    found = find_photos(folder)
    assert not found.skipped
    (photo,) = found.photos
    return photo


def why(folder):
    """What is said of the one photo that cannot be read."""
    with pytest.raises(PhysHDRError) as caught:
        find_photos(folder)
    assert caught.value.hint
    return str(caught.value)


def edited(path, box, at, value):
    content = bytearray(path.read_bytes())
    start = content.index(box) + 4
    content[start + at : start + at + len(value)] = value
    path.write_bytes(content)


# ---- codes, exposure, the way up ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.heic", "a.HIF", "a.jpg"])
def test_eight_bits_and_exif_come_out_whatever_the_file_is_called(heic, tmp_path, name):
    heic.write_heic(tmp_path / name, noise(), exif=exif(), others=[255 - noise()])
    photo = the_photo(tmp_path)
    codes, keep = photo.codes()
    assert codes.dtype == np.uint8 and keep is None and not photo.deep
    np.testing.assert_array_equal(codes, noise())  # the primary one, which is the second in the file
    np.testing.assert_array_equal(np.asarray(photo.decode()), noise())
    assert photo.shutter == pytest.approx(1 / 60, rel=1e-4)
    assert (photo.iso, photo.f_number, photo.focal_35mm) == (64, 1.8, 26)
    assert photo.camera == "Apple iPhone" and photo.taken == datetime(2026, 5, 1, 12, 0, 0, 250_000)


@pytest.mark.parametrize("bits", [10, 12])
def test_more_bits_span_all_codes_and_white_stays_white(heic, tmp_path, bits):
    stored = noise(bits)
    stored[0, 0], stored[0, 1] = 0, (1 << bits) - 1
    heic.write_heic(tmp_path / "a.hif", stored, bits)
    photo = the_photo(tmp_path)
    codes, _ = photo.codes()
    assert photo.deep and codes.dtype == np.uint16
    assert codes[0, 0].tolist() == [0] * 3 and codes[0, 1].tolist() == [65535] * 3
    np.testing.assert_array_equal(np.rint(codes / 65535 * ((1 << bits) - 1)), stored)  # each code is one
    assert np.abs(codes / 65535 - stored / ((1 << bits) - 1)).max() <= 0.5 / 65535
    assert np.abs(np.asarray(photo.decode()) / 255 - codes / 65535).max() <= 0.51 / 255


def test_grey_of_ten_bits(tmp_path):
    import pillow_heif

    stored = noise(10)[..., 0]
    file = pillow_heif.from_bytes("I;16", (60, 40), (stored << 6).astype("<u2").tobytes())
    file.save(tmp_path / "a.heic", quality=-1)
    codes, _ = the_photo(tmp_path).codes()
    assert codes.shape == SHAPE and (codes == codes[..., :1]).all()
    np.testing.assert_array_equal(np.rint(codes[..., 0] / 65535 * 1023), stored)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_it_lies_upright_once_as_a_jpeg_of_the_same_orientation_does(heic, tmp_path, orientation):
    """The file says it twice, in EXIF and as its own turn; Pillow turns a PNG with that EXIF."""
    (tmp_path / "heic").mkdir()
    (tmp_path / "png").mkdir()
    heic.write_heic(tmp_path / "heic" / "a.heic", noise(), exif=exif(orientation))
    Image.fromarray(noise()).save(tmp_path / "png" / "a.png", exif=exif(orientation))
    ours, theirs = the_photo(tmp_path / "heic"), the_photo(tmp_path / "png")
    with Image.open(tmp_path / "png" / "a.png") as picture:
        upright = np.asarray(ImageOps.exif_transpose(picture))
    np.testing.assert_array_equal(ours.codes()[0], upright)
    assert (ours.width, ours.height) == (theirs.width, theirs.height) == upright.shape[1::-1]
    assert ours.lens == theirs.lens


def test_an_orientation_in_exif_alone_counts_for_nothing(heic, tmp_path):
    """ISO/IEC 23008-12: a HEIF is turned by its own properties, and by nothing else."""
    path = heic.write_heic(tmp_path / "a.heic", noise(), exif=exif(1))
    tag = struct.pack(">HHI", ExifTags.Base.Orientation, 3, 1)
    content = path.read_bytes()
    order = ">" if tag in content else "<"
    tag = struct.pack(f"{order}HHI", ExifTags.Base.Orientation, 3, 1)
    at = content.index(tag) + len(tag)
    path.write_bytes(content[:at] + struct.pack(f"{order}H", 6) + content[at + 2 :])
    np.testing.assert_array_equal(the_photo(tmp_path).codes()[0], noise())


def test_tiles_are_one_picture(heic, tmp_path):
    heic.write_heic(tmp_path / "a.heic", smooth(), tile_size=64)
    np.testing.assert_array_equal(the_photo(tmp_path).codes()[0], smooth())


# ---- colours -----------------------------------------------------------------------------------------------


def display_p3():
    """LittleCMS's own making of the profile, for it and for us the same bytes."""
    from physhdr.backend.scene.icc import read_profile

    raw = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    columns = {
        b"rXYZ": (0.51512, 0.24120, -0.00105),
        b"gXYZ": (0.29198, 0.69225, 0.04189),
        b"bXYZ": (0.15710, 0.06657, 0.78407),
    }
    changed = bytearray(raw)
    for k in range(struct.unpack_from(">I", raw, 128)[0]):
        name, at, _ = struct.unpack_from(">4sII", raw, 132 + 12 * k)
        if name in columns:
            struct.pack_into(">3i", changed, at + 8, *(round(x * 65536) for x in columns[name]))
    assert not read_profile(bytes(changed)).is_srgb
    return bytes(changed)


def test_an_icc_profile_does_what_it_does_to_a_png(heic, tmp_path):
    for folder in ("heic", "png"):
        (tmp_path / folder).mkdir()
    heic.write_heic(tmp_path / "heic" / "a.heic", noise(), icc_profile=display_p3())
    Image.fromarray(noise()).save(tmp_path / "png" / "a.png", icc_profile=display_p3())
    ours, theirs = the_photo(tmp_path / "heic"), the_photo(tmp_path / "png")
    assert np.abs(ours.codes()[0].astype(int) - noise()).max() > 20
    np.testing.assert_array_equal(ours.codes()[0], theirs.codes()[0])
    np.testing.assert_array_equal(np.asarray(ours.decode()), np.asarray(theirs.decode()))
    assert "1 of 1 photos have the colour profile" in find_photos(tmp_path / "heic").notes[-1]
    odd = display_p3().replace(b"rXYZ", b"qXYZ")
    heic.write_heic(tmp_path / "heic" / "a.heic", noise(), icc_profile=odd)
    (warning,) = find_photos(tmp_path / "heic").warnings
    assert "treating 1 of 1 photos as sRGB" in warning and "it has no rXYZ" in warning


def test_code_points_say_the_same_as_the_profile(heic, tmp_path):
    for folder, told in (("nclx", {"nclx": (12, 13)}), ("icc", {"icc_profile": display_p3()})):
        (tmp_path / folder).mkdir()
        heic.write_heic(tmp_path / folder / "a.heic", noise(), **told)
    ours, theirs = (the_photo(tmp_path / folder).codes()[0].astype(int) for folder in ("nclx", "icc"))
    assert np.abs(ours - theirs).max() <= 1 and (ours != theirs).mean() < 0.02


@pytest.mark.parametrize("bits", [8, 10])
def test_pq_is_converted_at_sixteen_bits(heic, tmp_path, bits):
    """Codes of ST 2084 for 0, 1, 100 and 1000 cd/m², which are sRGB's of 0, 0.001, 0.1 and 1."""
    stored = np.zeros(SHAPE)
    stored[:, :20], stored[:, 20:40], stored[:, 40:] = 0.149946, 0.508078, 0.751827
    heic.write_heic(tmp_path / "a.hif", np.rint(stored * ((1 << bits) - 1)), bits, nclx=(9, 16))
    photo = the_photo(tmp_path)
    codes, _ = photo.codes()
    assert photo.deep and codes.dtype == np.uint16 and photo.profile.name == "BT.2020 with PQ"
    linear = ((codes[0, (0, 20, 40), 0] / 65535 + 0.055) / 1.055) ** 2.4
    linear[0] = codes[0, 0, 0] / 65535 / 12.92
    step = {8: 0.05, 10: 0.012}[bits]  # half a code of that many bits, relative
    np.testing.assert_allclose(linear, (0.001, 0.1, 1.0), rtol=step)


def test_colours_that_are_not_known_are_named(heic, tmp_path):
    heic.write_heic(tmp_path / "a.heic", noise(), nclx=(10, 8))
    message = why(tmp_path)
    assert "a.heic" in message and "the primaries 10" in message and "Convert it to sRGB" in message


# ---- what cannot be read -----------------------------------------------------------------------------------


@pytest.mark.parametrize("tile_size", [0, 64])
@pytest.mark.parametrize("share", [0.999, 0.9, 0.5, 0.02])
def test_a_truncated_one_is_skipped_and_named(room, heic, tmp_path, tile_size, share):
    """libheif draws a picture in tiles of which the last are missing, and says nothing."""
    room.write_photo(tmp_path / "b.jpg", smooth())
    path = heic.write_heic(tmp_path / "a.heic", smooth(), tile_size=tile_size)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["b.jpg"]
    assert [each.name for each in found.skipped] == [each.name for each in found.damaged] == ["a.heic"]
    assert found.skipped[0].why.startswith("is not a readable photo (")


def test_one_whose_end_was_never_copied_is_skipped(room, heic, tmp_path):
    room.write_photo(tmp_path / "b.jpg", smooth())
    path = heic.write_heic(tmp_path / "a.heic", smooth(), tile_size=64)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2].ljust(len(whole), b"\0"))
    assert "a part of it is empty" in find_photos(tmp_path).skipped[0].why


def test_what_is_no_photo_is_refused(tmp_path):
    for name, content in (("a.heic", b""), ("b.heic", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")):
        (tmp_path / name).write_bytes(content)
    message = why(tmp_path)
    assert "a.heic is not a readable photo" in message and "Copy it again" in message


def test_more_pixels_than_are_read(heic, tmp_path, monkeypatch):
    """By the header, before anything is decoded."""
    heic.write_heic(tmp_path / "a.heic", noise())
    monkeypatch.setattr(heif, "MAX_PIXELS", 2399)
    message = why(tmp_path)
    assert "a.heic has more pixels than are read (60×40)" in message and "make them smaller" in message


@pytest.mark.parametrize("claimed", [(16, 16), (600, 400)])
def test_pixels_of_another_size_than_the_header_says(heic, tmp_path, claimed):
    """Nothing as large as the pixels is made where the header was believed: libheif knows its size, too."""
    path = heic.write_heic(tmp_path / "a.heic", smooth(128, 128))
    edited(path, b"ispe", 4, struct.pack(">II", *claimed))
    photo = the_photo(tmp_path)
    assert (photo.width, photo.height) == claimed
    with pytest.raises(FileDamagedError, match=r"a\.heic is not a readable photo"):
        photo.codes()


def test_a_photo_that_was_replaced_since_it_was_found(heic, tmp_path):
    path = heic.write_heic(tmp_path / "a.heic", noise())
    with pytest.raises(FileDamagedError, match="60×40, not 61×40"):
        heif.read_codes(path, 61, 40)


def test_without_the_library_the_message_says_how_to_get_it(room, heic, tmp_path, monkeypatch):
    room.write_photo(tmp_path / "b.jpg", smooth())
    heic.write_heic(tmp_path / "a.heic", noise())
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    assert "-m pip install pillow-heif" in why(tmp_path)


def test_a_data_set_holds_none(heic, tmp_path):
    path = heic.write_heic(tmp_path / "a.png", noise())
    with pytest.raises(FileDamagedError) as caught:
        kind_of(path)
    assert "a.png is HEIC or AVIF" in str(caught.value) and "physhdr prepare" in str(caught.value)


# ---- AVIF --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("orientation", [1, 6, 7])
def test_an_avif_is_read_by_pillow(tmp_path, orientation):
    """Nearly without loss, with the exposure, the way up and the profile of a PNG of the same codes."""
    for folder, options in (("avif", {"quality": 100, "subsampling": "4:4:4"}), ("png", {})):
        (tmp_path / folder).mkdir()
        Image.fromarray(smooth()).save(
            tmp_path / folder / f"a.{folder}", exif=exif(orientation), icc_profile=display_p3(), **options
        )
    ours, theirs = the_photo(tmp_path / "avif"), the_photo(tmp_path / "png")
    assert (ours.width, ours.height, ours.exif) == (theirs.width, theirs.height, theirs.exif)
    assert ours.camera == "Apple iPhone" and ours.profile is not None
    apart = np.abs(ours.codes()[0].astype(int) - theirs.codes()[0])
    assert apart.mean() < 1.0 and np.percentile(apart, 99) <= 6


def test_an_avif_of_more_bits_is_named_with_the_remedy(room, tmp_path):
    """Pillow writes none, and would read one at 8 bits: the flag is set in a file of eight."""
    room.write_photo(tmp_path / "b.jpg", smooth())
    Image.fromarray(smooth()).save(tmp_path / "a.avif")
    assert len(find_photos(tmp_path).photos) == 2
    flags = (tmp_path / "a.avif").read_bytes().split(b"av1C")[1][2]
    edited(tmp_path / "a.avif", b"av1C", 2, bytes([flags | 0x40]))
    (skipped,) = find_photos(tmp_path).skipped
    assert skipped.name == "a.avif" and "an AVIF of 10 bits" in skipped.why and "16 bits" in skipped.why


def test_an_avifs_code_points_count(tmp_path):
    (tmp_path / "p3").mkdir()
    Image.fromarray(smooth()).save(tmp_path / "p3" / "a.avif")
    plain = the_photo(tmp_path / "p3")
    assert plain.profile is None
    edited(tmp_path / "p3" / "a.avif", b"colrnclx", 4, struct.pack(">H", 12))
    photo = the_photo(tmp_path / "p3")
    assert photo.profile.name == "Display P3"
    np.testing.assert_array_equal(photo.codes()[0], photo.profile.to_srgb(plain.codes()[0]))
    edited(tmp_path / "p3" / "a.avif", b"colrnclx", 6, struct.pack(">H", 16))
    assert "only 8 would be read" in why(tmp_path / "p3")


def test_a_truncated_avif_is_skipped(room, tmp_path):
    room.write_photo(tmp_path / "b.jpg", smooth())
    Image.fromarray(smooth()).save(tmp_path / "a.avif")
    whole = (tmp_path / "a.avif").read_bytes()
    (tmp_path / "a.avif").write_bytes(whole[: len(whole) * 3 // 4])
    assert "it ends after" in find_photos(tmp_path).skipped[0].why


# ---- several files of one photo ----------------------------------------------------------------------------


def test_of_several_files_of_a_photo_one_is_used(room, heic, dng, tmp_path):
    for name in ("a", "b", "c"):
        room.write_photo(tmp_path / f"{name}.jpg", smooth())
    heic.write_heic(tmp_path / "a.heic", smooth())
    Image.fromarray(smooth()).save(tmp_path / "b.avif")
    write_png(tmp_path / "d.png", smooth())
    heic.write_heic(tmp_path / "d.heic", smooth())
    (tmp_path / "a.MOV").write_bytes(b"live")
    found = find_photos(tmp_path)
    assert [photo.name for photo in found.photos] == ["a.heic", "b.jpg", "c.jpg", "d.heic"]
    assert not found.skipped
    assert found.notes == [
        "1 photos are there as HEIC and as JPEG: the HEIC files are used",
        "1 photos are there as AVIF and as HEIC or JPEG: the latter are used",
        "1 photos are there as .heic and as .png: the .heic files are used",
        "1 videos have a photo's name (live photos): they are not looked at",
    ]
    raw = tmp_path / "raw"
    raw.mkdir()
    dng.write_dng(raw / "a.dng", np.full((40, 60), 5000, np.uint16), 512, 16383)
    for name in ("a.heic", "a.jpg", "a.avif"):
        (raw / name).write_bytes(b"not looked at, for there is a raw file")
    found = find_photos(raw)
    assert [photo.name for photo in found.photos] == ["a.dng"] and not found.skipped
    assert "3 photos are there as raw file and as picture" in found.notes[0]
