# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a view's picture comes from, and how it is prepared."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from ...bridge.errors import BadValueError, DataMismatchError
from .color_space import SPACES, Chromaticities, known, space_named
from .encoding import CAMERA, LARGEST, Encoding
from .exif import LYING
from .icc import Profile
from .pictures import Radiance, exr_chromaticities, holds_radiance, read_codes, read_exr, read_radiance
from .resize import Reduction, is_shaped


class Undistortion(Protocol):
    """Removes a lens's distortion from a picture."""

    @property
    def key(self) -> Hashable:
        """Equal for two that do the same."""
        ...

    def picture(self, codes: np.ndarray, radiance: Encoding | None = None) -> np.ndarray:
        """``[H, W, 3]`` uint8 or uint16 as the lens gave it → ``[h, w, 3]`` of the same type.

        ``radiance``: how codes stand for radiance, of which means are taken then.
        """
        ...

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """``[H, W]`` bool → ``[h, w]`` bool: True where everything that contributes to a pixel was True."""
        ...


@dataclass(frozen=True, eq=False)
class Decoded:
    """A picture's ``codes`` ``[H, W, 3]`` uint8 or uint16, and its ``mask`` ``[H, W]`` bool.

    The mask is True where the picture is compared; None: everywhere.
    """

    codes: np.ndarray
    mask: np.ndarray | None = None

    @property
    def nbytes(self) -> int:
        return self.codes.nbytes + (0 if self.mask is None else self.mask.nbytes)


class PictureStore(Protocol):
    """A cache of pictures that took long to make (undistorted ones), at full size, across processes."""

    def load(self, source: "PictureSource") -> Decoded | None:
        """What was saved for this source, if it is still valid."""
        ...

    def save(self, source: "PictureSource", decoded: Decoded) -> None: ...


@dataclass(frozen=True, eq=False)
class PictureSource:
    """A picture's file and what is done to it. Frozen; ``key`` says whether two give the same picture.

    ``encoding``: how codes follow from exposure × radiance; ``SRGB`` where integers are linear. ``lens``:
    what removes the distortion. ``mask_path``: a picture of the same size, whose black (below half) is not
    compared. ``orientation``: EXIF's, 1 to 8, which is applied (1: as stored). ``store``: where
    undistorted pictures are cached. ``alpha``: whether pixels that its alpha hides (below half) are not
    compared; else alpha is ignored. ``color_space``: of radiance, by name; empty: as the file says.
    ``profile``: from whose primaries codes are converted to sRGB's.
    """

    path: Path
    encoding: Encoding = CAMERA
    lens: Undistortion | None = None
    mask_path: Path | None = None
    orientation: int = 1
    store: PictureStore | None = None
    alpha: bool = False
    color_space: str = ""
    profile: Profile | None = None

    @cached_property
    def key(self) -> Hashable:
        lens = None if self.lens is None else self.lens.key
        profile = None if self.profile is None else self.profile.key
        key = (self.path, self.encoding, lens, self.mask_path, self.orientation)
        return (*key, self.alpha, self.color_space, profile)

    def read(self, reduction: Reduction | None = None) -> Decoded:
        """The picture, reduced; raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError``.

        ``BadValueError`` for invalid radiance. In this order: decoded (radiance becomes codes, a
        profile's codes sRGB's), turned upright, undistorted, reduced; linear integers become codes at
        the end.
        """
        made = self._whole()
        if reduction is not None and not (reduction.factor == 1.0 or reduction.done):
            mask = None if made.mask is None else reduction.mask(made.mask)
            made = Decoded(reduction.picture(made.codes, self._radiance), mask)
        if self.encoding.is_known and self.encoding.clips and not holds_radiance(self.path):
            linear = made.codes / float(LARGEST[made.codes.dtype])
            made = Decoded(self.encoding.codes(linear), made.mask)
        return made

    @property
    def _radiance(self) -> Encoding | None:
        """How codes stand for radiance; None where they are a camera's."""
        return None if self.encoding.clips or not self.encoding.is_known else self.encoding

    def _whole(self) -> Decoded:
        """At full size."""
        if self.lens is None:
            return self._upright()
        stored = None if self.store is None else self.store.load(self)
        if stored is not None:
            return stored
        bent = self._upright()
        mask = None if bent.mask is None else self.lens.mask(bent.mask)
        straight = Decoded(self.lens.picture(bent.codes, self._radiance), mask)
        if self.store is not None:
            self.store.save(self, straight)
        return straight

    def _upright(self) -> Decoded:
        codes, alpha = self._decoded()
        codes = turned(codes, self.orientation)
        hidden = None if alpha is None else turned(alpha, self.orientation) < 0.5
        if self.mask_path is not None:
            mask = self._mask_beside(codes)
            hidden = ~mask if hidden is None else hidden | ~mask
        return Decoded(codes, None if hidden is None or not hidden.any() else ~hidden)

    def _decoded(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Codes ``[H, W, 3]``, those of radiance by the encoding, and alpha ``[H, W]`` if it counts."""
        if not holds_radiance(self.path):
            if not self.encoding.clips:
                raise DataMismatchError(
                    f"{self.path} held radiance when the data set was opened, and does not now",
                    "Open the data set again.",
                )
            codes, alpha = read_codes(self.path, self.alpha)
            return codes if self.profile is None else self.profile.to_srgb(codes), alpha
        if not self.encoding.is_known:
            raise DataMismatchError(
                f"{self.path} holds radiance, where a camera's picture was expected",
                "Open the data set again.",
            )
        read = read_radiance(self.path)
        space, _ = _space(read, self.color_space)
        codes = self.encoding.codes(linear_rec709(read.pixels, space))
        return codes, read.alpha if self.alpha else None

    def _mask_beside(self, codes: np.ndarray) -> np.ndarray:
        """``[H, W]`` bool of ``mask_path``; raises ``DataMismatchError`` where it is of another size."""
        assert self.mask_path is not None
        shades = turned(read_codes(self.mask_path)[0], self.orientation).max(axis=2)
        mask = is_white(shades, LARGEST[shades.dtype])
        size = codes.shape[1], codes.shape[0]
        if is_shaped(size, (mask.shape[1], mask.shape[0])):
            return _nearest(mask, *size)
        if mask.shape != codes.shape[:2]:
            raise DataMismatchError(
                f"the mask {self.mask_path} is {mask.shape[1]}×{mask.shape[0]}, its picture "
                f"{self.path} is {codes.shape[1]}×{codes.shape[0]}",
                "Make the mask at the picture's size, or remove it.",
            )
        return mask


def is_white(shades: np.ndarray, largest: int) -> np.ndarray:
    """Which pixels of a mask are white: ``largest``, what its files can hold, is halved for that.

    Some programs write 1 and 0 for yes and no: where nothing exceeds 1, 1 is white.
    """
    return shades >= (1 if shades.max(initial=0) <= 1 else (largest + 1) // 2)


def _nearest(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """A mask resized by its nearest pixels."""
    rows = (np.arange(height) + 0.5) * mask.shape[0] / height
    columns = (np.arange(width) + 0.5) * mask.shape[1] / width
    return mask[rows.astype(int)][:, columns.astype(int)]


def radiance_rec709(path: Path, color_space: str = "") -> tuple[np.ndarray, str]:
    """``[H, W, 3]`` float64 Linear Rec.709 of a file of radiance, and a description of its colour space.

    ``color_space``: its name; empty: as the file says. Values below 0 are colours outside Rec.709.
    """
    read = read_radiance(path)
    space, words = _space(read, color_space)
    return linear_rec709(read.pixels, space), words


def exr_rec709(path: Path) -> np.ndarray:
    """``[H, W, 3]`` float32 Linear Rec.709 of an OpenEXR, in whichever colour space its chromaticities are.

    Values below 0 are colours outside Rec.709. Raises what ``read_exr`` raises, and ``BadValueError`` for
    chromaticities of no colour space.
    """
    pixels, stated = read_exr(path), exr_chromaticities(path)
    if stated is None:
        return pixels
    try:
        return linear_rec709(pixels, known(stated)[0]).astype(np.float32)
    except BadValueError as error:
        raise BadValueError(
            f"{path}: {error.message}",
            "Write it again, or remove its attribute 'chromaticities' if it holds Linear Rec.709.",
        ) from error


def _space(read: Radiance, color_space: str) -> tuple[Chromaticities, str]:
    """The primaries of a picture, and a description of their origin."""
    if color_space:
        return space_named(color_space), f"{color_space}, as --color-space says"
    if read.chromaticities is None:
        return SPACES["rec709"], "rec709, because the files state none"
    space, name = known(read.chromaticities)
    return space, f"{name or 'of primaries of their own'}, as the files' chromaticities say"


def linear_rec709(pixels: np.ndarray, space: Chromaticities) -> np.ndarray:
    """``[H, W, 3]`` linear values of a space → Linear Rec.709, float64."""
    matrix = space.to_rec709()
    if np.array_equal(matrix, np.eye(3)):
        return pixels.astype(np.float64)
    return pixels.astype(np.float64) @ matrix.T


def plain(paths: Iterable[Path]) -> tuple[PictureSource, ...]:
    """Sources of pictures as a camera left them."""
    return tuple(PictureSource(path) for path in paths)


def turned(picture: np.ndarray, orientation: int) -> np.ndarray:
    """``[H, W, …]`` turned upright as EXIF's orientation, 1 to 8, says (Exif 2.3, tag 0x0112)."""
    if orientation in LYING:  # row 0 is at the left or the right of the scene
        picture = picture.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return np.ascontiguousarray(picture)
