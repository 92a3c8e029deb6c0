# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of many kinds as another program wrote them, and what hides a part of them."""

import io
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image, ImageOps

from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.encoding import SRGB, LogEncoding
from physhdr.backend.scene.lens import Lens, Reduced
from physhdr.backend.scene.pictures import picture_size, read_radiance, write_exr
from physhdr.backend.scene.resize import Reduction
from physhdr.backend.scene.scene import PictureCache, View
from physhdr.backend.scene.source import Decoded, PictureSource, turned
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileDamagedError

RNG = np.random.default_rng(1)
DEEP = RNG.integers(0, 65536, (12, 16, 3), dtype=np.uint16)
FLAT = RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8)
LIGHT = np.exp(RNG.uniform(-3.0, 4.0, (12, 16, 3))).astype(np.float32)
LOG = LogEncoding(20.0)


def opencv(path, pixels, *options):
    assert cv2.imwrite(str(path), pixels[..., ::-1], options)
    return path


@pytest.mark.parametrize(
    ("name", "pixels", "options"),
    [
        ("a.png", DEEP, ()),
        ("a.tif", DEEP, (cv2.IMWRITE_TIFF_COMPRESSION, 5)),  # LZW
        ("b.tif", DEEP, (cv2.IMWRITE_TIFF_COMPRESSION, 1)),
        ("c.tif", FLAT, (cv2.IMWRITE_TIFF_COMPRESSION, 8)),  # deflate
        ("d.png", FLAT, ()),
    ],
)
def test_integers_are_read_as_they_are(tmp_path, name, pixels, options):
    path = opencv(tmp_path / name, pixels, *options)
    read = PictureSource(path).read()
    assert read.codes.dtype == pixels.dtype and np.array_equal(read.codes, pixels) and read.mask is None
    assert picture_size(path) == (16, 12)


def test_grey_of_16_bits_becomes_colour(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), DEEP[..., 0])
    read = PictureSource(tmp_path / "grey.png").read().codes
    assert np.array_equal(read, np.repeat(DEEP[..., :1], 3, axis=2))


@pytest.mark.parametrize(("name", "within"), [("a.hdr", 1 / 128), ("a.tif", 2e-4), ("a.exr", 2e-4)])
def test_radiance_is_read_within_what_its_format_keeps(tmp_path, name, within):
    """.hdr shares an exponent over the channels of a pixel; our own codes have steps of 0.026 % at least."""
    if name.endswith("exr"):
        write_exr(tmp_path / name, LIGHT)
    else:
        opencv(tmp_path / name, LIGHT)
    raw = read_radiance(tmp_path / name).pixels
    assert (np.abs(raw - LIGHT) <= within * LIGHT.max(axis=2, keepdims=True)).all()
    read = PictureSource(tmp_path / name, encoding=LOG).read().codes
    assert (np.abs(LOG.exposed(read) - raw) <= 1.5e-4 * raw + 3e-7 * LOG.scale).all()
    assert picture_size(tmp_path / name) == (16, 12)


STRAIGHT = pycolmap.Camera(model="SIMPLE_RADIAL", width=16, height=12, params=[20.0, 8.0, 6.0, 0.0])


@pytest.mark.parametrize(
    "lens",
    [None, Reduced(Reduction(2.0)), Lens(STRAIGHT, 8, 6, 10.0, 10.0, 4.0, 3.0, over=2)],
    ids=["no lens", "others have one", "a lens"],
)
def test_radiance_is_averaged_and_not_its_logarithm(tmp_path, lens):
    opencv(tmp_path / "a.tif", LIGHT)
    source = PictureSource(tmp_path / "a.tif", encoding=LOG, lens=lens)
    read = source.read(Reduction(2.0, done=lens is not None)).codes
    mean = LIGHT.reshape(6, 2, 8, 2, 3).mean(axis=(1, 3))
    assert np.abs(LOG.exposed(read) / mean - 1.0).max() < 3e-3


def test_linear_integers_become_codes_of_the_srgb_curve(tmp_path):
    """Averaged while linear; white stays white, exactly."""
    deep = DEEP.copy()
    deep[:4] = 65535
    opencv(tmp_path / "raw.png", deep)
    read = PictureSource(tmp_path / "raw.png", encoding=SRGB).read(Reduction(2.0)).codes
    mean = (deep / 65535.0).reshape(6, 2, 8, 2, 3).mean(axis=(1, 3))
    expected = np.where(mean <= 0.0031308, 12.92 * mean, 1.055 * mean ** (1 / 2.4) - 0.055) * 65535.0
    assert np.abs(read - expected).max() <= 6.0  # half a linear code before the curve, whose slope is 12.9
    assert (read[:2] == 65535).all()


def test_nan_and_wrong_kinds_are_refused(tmp_path):
    bad = LIGHT.copy()
    bad[3, 4] = np.nan
    opencv(tmp_path / "nan.tif", bad)
    opencv(tmp_path / "light.hdr", LIGHT)
    with pytest.raises(BadValueError, match="row 3, column 4"):
        PictureSource(tmp_path / "nan.tif", encoding=LOG).read()
    with pytest.raises(DataMismatchError, match="holds radiance"):
        PictureSource(tmp_path / "light.hdr").read()
    cut = (tmp_path / "light.hdr").read_bytes()[:150]
    (tmp_path / "cut.hdr").write_bytes(cut)
    with pytest.raises(FileDamagedError):
        PictureSource(tmp_path / "cut.hdr", encoding=LOG).read()


# ---- what is hidden --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["8-bit PNG", "16-bit PNG", "16-bit TIFF", "palette"])
def test_what_alpha_hides_is_not_compared(tmp_path, kind):
    """Below half; colours stay as they are stored, never multiplied."""
    alpha = np.zeros((12, 16), np.uint8)
    alpha[3:9, 4:12] = 200
    path = tmp_path / ("a.tif" if "TIFF" in kind else "a.png")
    colours = FLAT if "8" in kind else DEEP
    if kind == "palette":
        indices = Image.fromarray((alpha > 0).astype(np.uint8), "P")
        indices.putpalette([9, 9, 9, 50, 60, 70])
        indices.save(path, transparency=0)
        colours = np.where((alpha > 0)[..., None], [50, 60, 70], 9)
    elif "8" in kind:
        Image.fromarray(np.dstack([FLAT, alpha])).save(path)
    else:
        opencv(path, np.dstack([alpha.astype(np.uint16) * 257, *(DEEP[..., k] for k in (0, 1, 2))]))
    read = PictureSource(path, alpha=True).read()
    assert np.array_equal(read.mask, alpha >= 128)
    assert np.array_equal(read.codes, colours)
    assert PictureSource(path).read().mask is None, "only where it is asked for"


def test_constant_alpha_hides_nothing(tmp_path):
    Image.fromarray(np.dstack([FLAT, np.full((12, 16), 255, np.uint8)])).save(tmp_path / "a.png")
    assert PictureSource(tmp_path / "a.png", alpha=True).read().mask is None


def test_a_mask_beside_and_alpha_both_hide_and_are_reduced(tmp_path):
    alpha, beside = np.full((12, 16), 255, np.uint8), np.full((12, 16), 255, np.uint8)
    alpha[0, 0], beside[11, 15] = 0, 0
    Image.fromarray(np.dstack([FLAT, alpha])).save(tmp_path / "a.png")
    Image.fromarray(beside).save(tmp_path / "m.png")
    source = PictureSource(tmp_path / "a.png", mask_path=tmp_path / "m.png", alpha=True)
    expected = np.ones((12, 16), bool)
    expected[0, 0] = expected[11, 15] = False
    assert np.array_equal(source.read().mask, expected)
    small = source.read(Reduction(2.0)).mask
    assert np.array_equal(small, expected.reshape(6, 2, 8, 2).all(axis=(1, 3)))
    Image.fromarray(beside[:5]).save(tmp_path / "m.png")
    with pytest.raises(DataMismatchError, match="the mask"):
        source.read()


@pytest.mark.parametrize("white", [1, 255, 200])
def test_white_is_what_programs_write_for_yes(tmp_path, white):
    rng = np.random.default_rng(3)
    keep = rng.random((6, 8)) < 0.5
    opencv(tmp_path / "a.png", rng.integers(0, 256, (6, 8, 3), np.uint8))
    Image.fromarray((white * keep).astype(np.uint8)).save(tmp_path / "m.png")
    read = PictureSource(tmp_path / "a.png", mask_path=tmp_path / "m.png").read()
    assert np.array_equal(read.mask, keep)


def test_a_mask_at_half_the_size_hides_as_much(tmp_path):
    Image.fromarray(FLAT).save(tmp_path / "a.png")
    half = np.full((6, 8), 255, np.uint8)
    half[1:3, 4:] = 0
    Image.fromarray(half).save(tmp_path / "m.png")
    read = PictureSource(tmp_path / "a.png", mask_path=tmp_path / "m.png").read()
    assert np.array_equal(read.mask, np.kron(half, np.ones((2, 2))) > 0)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_pillow_turns_them(orientation):
    picture, tags, file = Image.fromarray(FLAT), Image.Exif(), io.BytesIO()
    tags[0x0112] = orientation
    picture.save(file, "PNG", exif=tags)
    upright = np.array(ImageOps.exif_transpose(Image.open(file)))
    assert np.array_equal(turned(FLAT, orientation), upright)


@dataclass(frozen=True)
class Mirror:
    """A lens that mirrors, and hides the first column."""

    key: str = "mirror"

    def picture(self, codes, radiance=None):
        return codes[:, ::-1]

    def mask(self, mask):
        return mask[:, ::-1] & (np.arange(mask.shape[1]) > 0)


def test_a_lens_sees_upright_pictures_and_its_work_is_kept(tmp_path):
    class Store:
        kept: Decoded | None = None

        def load(self, source):
            return self.kept

        def save(self, source, decoded):
            self.kept = decoded

    Image.fromarray(FLAT).save(tmp_path / "a.png")
    Image.fromarray(np.full((12, 16), 255, np.uint8)).save(tmp_path / "m.png")
    store = Store()
    source = PictureSource(tmp_path / "a.png", lens=Mirror(), orientation=6, store=store)
    expected = turned(FLAT, 6)[:, ::-1]
    assert np.array_equal(source.read().codes, expected)
    (tmp_path / "a.png").unlink()
    assert np.array_equal(source.read().codes, expected), "from the store"


def test_the_cache_counts_masks_and_tells_sources_apart(tmp_path):
    alpha = np.full((12, 16), 255, np.uint8)
    alpha[0] = 0
    Image.fromarray(np.dstack([FLAT, alpha])).save(tmp_path / "a.png")
    cache = PictureCache()
    hidden, whole = PictureSource(tmp_path / "a.png", alpha=True), PictureSource(tmp_path / "a.png")
    camera = Camera.from_field_of_view(np.eye(4), 16, 12, 0.9)
    view = View("v", camera, (1.0, 2.0), (hidden, whole), 0, cache=cache)
    assert view.mask(0).sum() == 11 * 16 and view.mask(1) is None and view.image(1) is view.image(1)
    assert cache.bytes_held == 2 * FLAT.nbytes + 12 * 16
    assert not view.mask(0).flags.writeable
    assert view.values(0) == pytest.approx(FLAT / 255.0) and view.image_paths == (tmp_path / "a.png",) * 2
