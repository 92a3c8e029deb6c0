# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a view's picture comes from, and everything that is done to it before anybody looks at it."""

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from ...bridge.errors import DataMismatchError
from .encoding import CAMERA, Encoding
from .pictures import read_picture
from .resize import Reduction


class Undistortion(Protocol):
    """What takes a lens's distortion out of a picture."""

    @property
    def key(self) -> Hashable:
        """Equal where two of them do the same."""
        ...

    def picture(self, codes: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` uint8 or uint16 as the lens gave it → ``[h, w, 3]`` of the same type."""
        ...

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """``[H, W]`` bool → ``[h, w]`` bool: True where everything that a pixel is made of was True."""
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
    """Pictures that took long to make (undistorted ones), at full size, from one process to the next."""

    def load(self, source: "PictureSource") -> Decoded | None:
        """What was saved for this source, if it is still right."""
        ...

    def save(self, source: "PictureSource", decoded: Decoded) -> None: ...


@dataclass(frozen=True, eq=False)
class PictureSource:
    """A picture's file and what is done to it. Frozen; ``key`` says whether two give the same picture.

    ``encoding``: how its codes came of exposure × radiance. ``lens``: what takes the distortion out.
    ``mask_path``: a picture of the same size, whose black (below half) is not compared. ``orientation``:
    EXIF's, 1 to 8, which is obeyed (1: as it is stored). ``store``: where undistorted pictures are kept.
    """

    path: Path
    encoding: Encoding = CAMERA
    lens: Undistortion | None = None
    mask_path: Path | None = None
    orientation: int = 1
    store: PictureStore | None = None

    @cached_property
    def key(self) -> Hashable:
        lens = None if self.lens is None else self.lens.key
        return self.path, self.encoding, lens, self.mask_path, self.orientation

    def read(self, reduction: Reduction | None = None) -> Decoded:
        """The picture, reduced; raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError``.

        In this order: decoded, turned upright, freed of distortion, reduced.
        """
        whole = self._whole()
        if reduction is None or reduction.factor == 1.0:
            return whole
        return Decoded(reduction.picture(whole.codes), whole.mask)

    def _whole(self) -> Decoded:
        """At full size."""
        if self.lens is None:
            return self._upright()
        kept = None if self.store is None else self.store.load(self)
        if kept is not None:
            return kept
        bent = self._upright()
        mask = None if bent.mask is None else self.lens.mask(bent.mask)
        straight = Decoded(self.lens.picture(bent.codes), mask)
        if self.store is not None:
            self.store.save(self, straight)
        return straight

    def _upright(self) -> Decoded:
        codes = turned(read_picture(self.path), self.orientation)
        if self.mask_path is None:
            return Decoded(codes)
        mask = turned(read_picture(self.mask_path), self.orientation).max(axis=2) >= 128
        if mask.shape != codes.shape[:2]:
            raise DataMismatchError(
                f"the mask {self.mask_path} is {mask.shape[1]}×{mask.shape[0]}, its picture "
                f"{self.path} is {codes.shape[1]}×{codes.shape[0]}",
                "Make the mask at the picture's size, or remove it.",
            )
        return Decoded(codes, None if mask.all() else mask)


def plain(paths: Iterable[Path]) -> tuple[PictureSource, ...]:
    """Sources of pictures as a camera left them, with nothing to be done to them."""
    return tuple(PictureSource(path) for path in paths)


def turned(picture: np.ndarray, orientation: int) -> np.ndarray:
    """``[H, W, …]`` turned upright as EXIF's orientation, 1 to 8, says (Exif 2.3, tag 0x0112)."""
    if orientation in (5, 6, 7, 8):  # row 0 is at the left or the right of the scene
        picture = picture.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    return np.ascontiguousarray(picture)
