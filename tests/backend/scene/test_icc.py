# SPDX-License-Identifier: GPL-3.0-or-later
"""ICC profiles: pictures of other primaries, as phones take them, become sRGB's, as LittleCMS has them."""

import io
import struct

import numpy as np
import OpenImageIO
import pytest
from PIL import ExifTags, Image, ImageCms

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.backend.scene.for_others import How, lay_out
from physhdr.backend.scene.icc import profile_of, read_profile
from physhdr.backend.scene.source import PictureSource
from physhdr.bridge.errors import BadValueError

SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def s15(value):
    return struct.pack(">i", round(value * 65536.0))


def parametric(kind, *numbers):
    return b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + b"".join(map(s15, numbers))


def table(values):
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + np.asarray(values).astype(">u2").tobytes()


GAMMA = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(2.19921875 * 256))

#: Colorants as the files of Apple, Adobe and Kodak (ROMM) have them: XYZ, white adapted to D50.
COLORANTS = {
    "Display P3": ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407)),
    "Adobe RGB (1998)": (
        (0.60974, 0.31111, 0.01947),
        (0.20528, 0.62567, 0.06087),
        (0.14919, 0.06322, 0.74457),
    ),
    "ProPhoto RGB": ((0.79767, 0.28804, 0.0), (0.13518, 0.71188, 0.0), (0.03134, 0.00009, 0.82491)),
    "sRGB": ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410)),
}


def profile(name, curve=None, space=b"RGB ", version=0x04200000):
    """The bytes of a profile, written by ICC.1's words."""
    curve = curve or parametric(3, *SRGB_CURVE)
    text = name.encode("utf-16-be")
    described = b"mluc\0\0\0\0" + struct.pack(">II4sII", 1, 12, b"enUS", len(text), 28) + text
    if version < 0x04000000:
        described = b"desc\0\0\0\0" + struct.pack(">I", len(name) + 1) + name.encode() + b"\0" * 79
    tags = {b"desc": described, b"wtpt": b"XYZ \0\0\0\0" + s15(0.9642) + s15(1.0) + s15(0.8249)}
    for letter, colorant in zip(b"rgb", COLORANTS.get(name, COLORANTS["sRGB"]), strict=True):
        tags[bytes([letter]) + b"XYZ"] = b"XYZ \0\0\0\0" + b"".join(map(s15, colorant))
        tags[bytes([letter]) + b"TRC"] = curve
    listed, content = struct.pack(">I", len(tags)), b""
    for sign, tag in tags.items():
        listed += struct.pack(">4sII", sign, 132 + 12 * len(tags) + len(content), len(tag))
        content += tag + b"\0" * (-len(tag) % 4)
    head = struct.pack(">I4sI4s4s4s12x4s", 0, b"", version, b"mntr", space, b"XYZ ", b"acsp")
    head = head.ljust(68, b"\0") + s15(0.9642) + s15(1.0) + s15(0.8249)
    raw = bytearray(head.ljust(128, b"\0") + listed + content)
    raw[:4] = struct.pack(">I", len(raw))
    return bytes(raw)


def every_colour(steps=33):
    axis = np.rint(np.linspace(0, 255, steps)).astype(np.uint8)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(steps, -1, 3)


def by_littlecms(codes, raw):
    made = ImageCms.profileToProfile(
        Image.fromarray(codes),
        ImageCms.ImageCmsProfile(io.BytesIO(raw)),
        ImageCms.createProfile("sRGB"),
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
        outputMode="RGB",
        flags=ImageCms.Flags.NOOPTIMIZE,
    )
    assert made is not None
    return np.asarray(made)


CURVES = {
    "gamma": GAMMA,
    "identity": table([]),
    "table": table(np.rint(np.linspace(0, 1, 1024) ** 1.8 * 65535)),
    "0": parametric(0, 1.8),
    "1": parametric(1, 2.2, 1 / 1.1, 0.1 / 1.1),
    "2": parametric(2, 2.0, 0.9, 0.05, 0.02),
    "3": parametric(3, *SRGB_CURVE),
    "4": parametric(4, 2.4, 0.94, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.001, 0.002),
}


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("version", [0x02400000, 0x04200000])
@pytest.mark.parametrize("name", ["Display P3", "Adobe RGB (1998)", "ProPhoto RGB"])
def test_codes_are_those_of_littlecms(name, version, curve):
    raw = profile(name, CURVES[curve], version=version)
    read = read_profile(raw)
    assert read.name == name and not read.is_srgb
    codes = every_colour()
    off = np.abs(read.to_srgb(codes).astype(int) - by_littlecms(codes, raw))
    assert off.max() <= 1 and (off > 0).mean() < 0.02


def test_sixteen_bits_are_as_fine_as_they_were():
    read = read_profile(profile("Display P3"))
    rng = np.random.default_rng(0)
    codes = rng.integers(0, 65536, (50, 60, 3)).astype(np.uint16)
    made = read.to_srgb(codes)
    assert made.dtype == np.uint16 and made.shape == codes.shape
    # In float64, by the published primaries of P3 and Rec.709, which have one white (SMPTE EG 432-1).
    matrix = np.array(
        [[1.2249402, -0.2249402, 0.0], [-0.0420570, 1.0420570, 0.0], [-0.0196376, -0.0786361, 1.0982736]]
    )
    unit = codes / 65535.0
    linear = np.where(unit <= 0.04045, unit / 12.92, ((unit + 0.055) / 1.055) ** 2.4) @ matrix.T
    linear = linear.clip(0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    inside = (linear > 0.01) & (linear < 1.0)
    assert np.abs(made / 65535.0 - encoded)[inside].max() < 5e-4  # colorants have four digits
    greys = np.arange(65536).repeat(3).reshape(256, 256, 3).astype(np.uint16)
    assert np.abs(read.to_srgb(greys).astype(int) - greys).max() <= 1


@pytest.mark.parametrize("name", ["Display P3", "Adobe RGB (1998)", "ProPhoto RGB"])
def test_what_clipped_clips(name):
    codes = every_colour()
    made = read_profile(profile(name, GAMMA)).to_srgb(codes)
    brightest = codes == codes.max(axis=-1, keepdims=True)
    assert (made[(codes == 255) & brightest] == 255).all()
    assert (made[codes.max(axis=-1) == 0] == 0).all()


@pytest.mark.parametrize("curve", ["3", "gamma"])
def test_srgbs_primaries_are_left_alone_whatever_the_curve(tmp_path, curve):
    raw = profile("sRGB", CURVES[curve])
    assert read_profile(raw).is_srgb
    assert read_profile(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()).is_srgb
    Image.fromarray(every_colour()).save(tmp_path / "a.png", icc_profile=raw)
    assert profile_of(tmp_path / "a.png") == (None, "")


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"nothing", "not an ICC profile"),
        (profile("print", space=b"CMYK"), "'print' does not hold three primaries"),
        (profile("cut")[:180], "three primaries"),
        (profile("odd", b"clut" + bytes(40)), "a curve is of the type 'clut'"),
        (profile("odd", parametric(7, 1.0)), "a curve is of the kind 7"),
        (profile("odd", parametric(1, 1.0, 0.0, 0.0)), "a curve is constant"),
        (profile("Display P3").replace(b"rXYZ", b"qXYZ"), "it has no rXYZ"),
        (profile("Display P3").replace(s15(0.51512), s15(2.0)), "not add up to white"),
    ],
)
def test_other_profiles_are_refused_with_the_reason(raw, words):
    with pytest.raises(BadValueError, match=words):
        read_profile(raw)


def test_damaged_bytes_raise_nothing_else():
    raw, rng = bytearray(profile("Display P3", CURVES["4"])), np.random.default_rng(0)
    for _ in range(2000):
        changed = bytearray(raw)
        for place in rng.integers(0, len(raw), 8):
            changed[place] = rng.integers(0, 256)
        try:
            read = read_profile(bytes(changed[: rng.integers(1, len(raw) + 1)]))
        except BadValueError:
            continue
        read.to_srgb(np.array([[[0, 128, 255]]], np.uint8))


# ---- pictures ----------------------------------------------------------------------------------------------


def write(path, codes, raw):
    """A picture with a profile: a TIFF of 16 bits by OpenImageIO, all others by Pillow."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if codes.dtype == np.uint8:
        Image.fromarray(codes).save(
            path, icc_profile=raw, **({"quality": 100} if path.suffix == ".jpg" else {})
        )
        return
    spec = OpenImageIO.ImageSpec(codes.shape[1], codes.shape[0], 3, "uint16")
    spec.attribute("ICCProfile", OpenImageIO.TypeDesc(f"uint8[{len(raw)}]"), np.frombuffer(raw, np.uint8))
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec) and writer.write_image(codes)
    writer.close()


FLAT = np.full((12, 16, 3), (200, 120, 100), np.uint8)
#: By LittleCMS.
IN_SRGB = (213, 115, 95)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "deep.tif", "deep.png"])
def test_every_kind_of_file_tells_its_profile(tmp_path, name):
    deep = name.startswith("deep")
    write(tmp_path / name, FLAT.astype(np.uint16) * 257 if deep else FLAT, profile("Display P3"))
    found, _ = profile_of(tmp_path / name)
    assert found is not None and found.name == "Display P3"
    read = PictureSource(tmp_path / name, profile=found).read().codes[5, 5]
    np.testing.assert_allclose(read / (257 if deep else 1), IN_SRGB, atol=1)


def test_a_data_set_is_read_in_srgb_and_says_so_once(layouts, tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "data", poses=4)
    for path in (root / "images").iterdir():
        write(path, np.broadcast_to(FLAT[:1, :1], (72, 96, 3)).copy(), profile("Display P3"))
    scene = read_scene(root)
    assert {tuple(view.image(0)[9, 9]) for view in [*scene.train, *scene.test]} == {IN_SRGB}
    told = [message for message in scene.messages if "ICC" in message]
    assert told == ["4 of 4 pictures have the ICC profile 'Display P3': converted to sRGB's primaries"]
    # A picture that became another's is another: what is kept of one is not taken for the other.
    source = scene.train[0].sources[0]
    assert source.key != PictureSource(source.path, source.encoding, alpha=True).key


def test_other_programs_get_what_training_sees(layouts, tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "data", poses=4)
    for path in (root / "images").iterdir():
        write(path, np.broadcast_to(FLAT[:1, :1], (72, 96, 3)).copy(), profile("Display P3"))
    said = lay_out(read_scene(root), tmp_path / "theirs", How(layout="nerfstudio"))
    assert (said.made, said.copied) == (4, 0)
    pictures = [Image.open(path) for path in sorted((tmp_path / "theirs" / "images").iterdir())]
    assert {picture.getpixel((9, 9)) for picture in pictures} == {IN_SRGB}
    assert all("icc_profile" not in picture.info for picture in pictures)


def test_a_profile_that_cannot_be_used_is_told(layouts, tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "data", poses=4)
    write(root / "images/frame_00000.png", FLAT.repeat(6, 0).repeat(6, 1), profile("print", space=b"CMYK"))
    scene = read_scene(root)
    (told,) = (message for message in scene.messages if "ICC" in message)
    assert "'print'" in told and "(1 of 4 pictures): treating them as sRGB" in told


@pytest.mark.parametrize("writer", ["write_syn", "write_gausshdr"])
def test_published_layouts_are_as_their_loaders_have_them(layouts, tmp_path, writer):
    root = getattr(layouts, writer)(tmp_path / "data")
    before = read_scene(root)
    for view, k in before.pictures():
        path = view.image_paths[k]
        with Image.open(path) as picture:
            picture.load()
        picture.save(path, icc_profile=profile("Display P3"))
    after = read_scene(root)
    for view, k in before.pictures():
        again = next(v for v in (*after.train, *after.test) if v.name == view.name)
        np.testing.assert_array_equal(view.image(k), again.image(k))


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "deep.tif"])
def test_photos_that_are_prepared_are_converted(tmp_path, name):
    deep = name.startswith("deep")
    write(tmp_path / name, FLAT.astype(np.uint16) * 257 if deep else FLAT, profile("Display P3"))
    found = find_photos(tmp_path)
    (photo,) = found.photos
    np.testing.assert_allclose(photo.codes()[0][5, 5] / (257 if deep else 1), IN_SRGB, atol=1)
    np.testing.assert_allclose(np.asarray(photo.decode())[5, 5], IN_SRGB, atol=1)
    assert any("'Display P3': converted" in note for note in found.notes)


@pytest.mark.parametrize("name", ["b.jpg", "b.png", "b.avif", "deep.tif"])
def test_a_photo_whose_profile_cannot_be_used_is_told(tmp_path, name):
    """It is taken as sRGB; profiles of grey say nothing of colours."""
    deep = name.startswith("deep")
    write(tmp_path / "a.png", FLAT, profile("sRGB"))
    write(tmp_path / name, FLAT.astype(np.uint16) * 257 if deep else FLAT, profile("look", space=b"Lab "))
    Image.fromarray(FLAT[..., 0]).save(tmp_path / "c.avif", icc_profile=profile("grey", space=b"GRAY"))
    found = find_photos(tmp_path)
    (warning,) = found.warnings
    assert warning.startswith("treating 1 of 3 photos as sRGB: the ICC profile 'look' does not hold")
    assert "Convert the pictures to sRGB" in warning
    assert [photo.profile for photo in found.photos] == [None] * 3


# ---- what EXIF alone says --------------------------------------------------------------------------

SAVING = {".jpg": {"quality": 100, "subsampling": 0}, ".png": {}, ".tif": {}}


def said_by_exif(space, index):
    """A camera's tags, as bytes: ColorSpace, and the interoperability index."""
    tags = Image.Exif()
    tags[ExifTags.IFD.Exif] = {
        ExifTags.Base.ExposureTime: 0.5,
        **({} if space is None else {ExifTags.Base.ColorSpace: space}),
        **({} if index is None else {ExifTags.IFD.Interop: {ExifTags.Base.InteropIndex: index}}),
    }
    return tags.tobytes()


def as_littlecms_has_it(codes):
    """Adobe RGB (1998) by a profile of Adobe's colorants."""
    adobe = ImageCms.ImageCmsProfile(io.BytesIO(profile("Adobe RGB (1998)", GAMMA)))
    srgb = ImageCms.createProfile("sRGB")
    return np.asarray(ImageCms.profileToProfile(Image.fromarray(codes), adobe, srgb))


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_adobe_rgb_without_a_profile_is_converted(tmp_path, suffix):
    codes = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    # Into a TIFF Pillow writes the place of the index as it was elsewhere.
    exif = said_by_exif(2, None) if suffix == ".tif" else said_by_exif(65535, "R03")
    Image.fromarray(codes).save(tmp_path / f"_a{suffix}", exif=exif, **SAVING[suffix])
    with Image.open(tmp_path / f"_a{suffix}") as stored:
        expected = as_littlecms_has_it(np.asarray(stored.convert("RGB"))).astype(int)
    found = find_photos(tmp_path)
    (photo,) = found.photos
    assert np.abs(photo.codes()[0].astype(int) - expected).max() <= 1
    assert photo.shutter == 0.5
    assert any("'Adobe RGB (1998)': converted" in note for note in found.notes)


@pytest.mark.parametrize(
    ("space", "index", "is_adobe"),
    [
        (65535, "R03", True),
        (None, "R03", True),
        (2, None, True),  # not in the standard, but in pictures
        (65535, "R98", False),
        (65535, None, False),
        (1, "R03", False),  # an editor converted it and left the index
        (None, None, False),
    ],
)
def test_only_what_says_adobe_rgb_is(tmp_path, space, index, is_adobe):
    Image.fromarray(FLAT).save(tmp_path / "a.png", exif=said_by_exif(space, index))
    assert (profile_of(tmp_path / "a.png")[0] is not None) == is_adobe


def test_a_profile_goes_before_exif(tmp_path):
    exif = said_by_exif(65535, "R03")
    Image.fromarray(FLAT).save(tmp_path / "a.png", exif=exif, icc_profile=profile("sRGB"))
    assert profile_of(tmp_path / "a.png") == (None, "")
    Image.fromarray(FLAT).save(tmp_path / "b.png", exif=exif, icc_profile=profile("Display P3"))
    found, _ = profile_of(tmp_path / "b.png")
    assert found is not None and found.name == "Display P3"


def test_a_data_set_in_adobe_rgb_says_so(layouts, tmp_path):
    root = layouts.write_nerfstudio(tmp_path / "data", poses=4)
    flat = np.broadcast_to(FLAT[:1, :1], (72, 96, 3)).copy()
    for path in (root / "images").iterdir():
        Image.fromarray(flat).save(path, exif=said_by_exif(65535, "R03"))
    scene = read_scene(root)
    codes = scene.train[0].image(0)[9, 9].astype(int)
    assert np.abs(codes - as_littlecms_has_it(flat)[9, 9]).max() <= 1
    told = [message for message in scene.messages if "according to EXIF" in message]
    assert told == ["4 of 4 pictures are in Adobe RGB (1998) according to EXIF: converted to sRGB's"]
