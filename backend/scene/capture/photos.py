# SPDX-License-Identifier: GPL-3.0-or-later
"""A user's photos: which there are, what their EXIF says, their pixels. Nothing here writes."""

import math
import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps

from ....bridge.errors import DataMismatchError, FileDamagedError, FileMissingError
from ....bridge.regular import damaged_where_it_fails
from ..exif import Tags, exposure_of, positive, tags_of

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
#: What cameras write that is no 8-bit picture; named in the message where nothing else is found.
RAW_SUFFIXES = (".cr2", ".cr3", ".nef", ".arw", ".dng", ".orf", ".raf", ".rw2", ".pef", ".heic", ".heif")
COPY_AGAIN = "Copy it again, or move it away."
#: Pillow's modes of 8 bits a channel that become RGB without loss; alpha is ignored, never composited.
EIGHT_BIT_MODES = ("L", "LA", "P", "RGB", "RGBA", "RGBX")
#: Orientation tags under which width and height change places.
TURNED = (5, 6, 7, 8)
#: The width of 35 mm film in millimetres, to which FocalLengthIn35mmFilm refers.
FILM_WIDTH = 36.0


@dataclass(frozen=True)
class Photo:
    """A photo and what its EXIF says; None where it says nothing.

    ``width, height``: pixels, turned upright. ``taken``: when. ``shutter``: seconds. ``iso``: as is.
    ``f_number``: focal length / aperture. ``focal_35mm``: millimetres on 35 mm film.
    """

    path: Path
    width: int
    height: int
    taken: datetime | None = None
    shutter: float | None = None
    iso: float | None = None
    f_number: float | None = None
    focal_35mm: float | None = None

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def focal_pixels(self) -> float | None:
        """The focal length in pixels that EXIF tells, a first guess for structure from motion."""
        return (
            None if self.focal_35mm is None else self.focal_35mm / FILM_WIDTH * max(self.width, self.height)
        )

    def decode(self) -> Image.Image:
        """The picture as RGB, 8 bits, upright; raises ``FileDamagedError``."""
        unreadable = damaged_where_it_fails(f"{self.path} is not a readable photo", COPY_AGAIN)
        with unreadable, Image.open(self.path, formats=["JPEG", "PNG", "TIFF"]) as picture:
            return ImageOps.exif_transpose(picture).convert("RGB")

    def thumbnail(self, side: int = 256) -> np.ndarray:
        """``[h, w, 3]`` uint8 at most ``side`` wide and high, by picking pixels, so that clipping stays."""
        pixels = np.asarray(self.decode())
        step = max(1, math.ceil(max(pixels.shape[:2]) / side))
        return pixels[::step, ::step]


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """A sort key under which ``img_9`` comes before ``img_10``."""
    parts = re.findall(r"\d+|\D+", name.lower())
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]


def find_photos(folder: Path) -> list[Photo]:
    """Every photo in ``folder`` (not below it), in the order of names, with its EXIF.

    Raises ``FileMissingError`` (no folder, no photos), ``FileDamagedError`` (a file that is no picture or
    has more than 8 bits), ``DataMismatchError`` (sizes differ).
    """
    if not folder.is_dir():
        raise FileMissingError(
            f"the folder of photos {folder} does not exist", "Give the folder they are in."
        )
    files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    paths = [path for path in files if path.suffix.lower() in SUFFIXES]
    if not paths:
        raise FileMissingError(f"{folder} holds no photos{_what_else(folder, files)}", _remedy(files))
    photos = [_read_header(path) for path in sorted(paths, key=lambda path: natural_order(path.name))]
    _require_one_size(photos)
    return photos


def _what_else(folder: Path, files: list[Path]) -> str:
    if any(path.suffix.lower() in RAW_SUFFIXES for path in files):
        return f", but {sum(path.suffix.lower() in RAW_SUFFIXES for path in files)} raw or HEIC files"
    below = [sub.name for sub in sorted(folder.iterdir()) if sub.is_dir()]
    return f" itself, only folders ({', '.join(below[:3])}{' …' if len(below) > 3 else ''})" if below else ""


def _remedy(files: list[Path]) -> str:
    if any(path.suffix.lower() in RAW_SUFFIXES for path in files):
        return (
            "Develop them all with the same settings, without automatic corrections, to JPEG or 8-bit TIFF."
        )
    return "Put all photos, JPEG, PNG or 8-bit TIFF, into one folder and give that."


def _require_one_size(photos: list[Photo]) -> None:
    sizes: dict[tuple[int, int], list[Photo]] = {}
    for photo in photos:
        sizes.setdefault((photo.width, photo.height), []).append(photo)
    if len(sizes) > 1:
        common = max(sizes, key=lambda size: len(sizes[size]))
        odd = next(photo for photo in photos if (photo.width, photo.height) != common)
        found = ", ".join(f"{len(group)} of {w}×{h}" for (w, h), group in sizes.items())
        raise DataMismatchError(
            f"the photos have {len(sizes)} sizes: {found}; {odd.name} is {odd.width}×{odd.height}",
            "One camera with one lens, not zoomed or turned, takes them all: move those that differ away.",
        )


def _read_header(path: Path) -> Photo:
    unreadable = damaged_where_it_fails(f"{path} is not a readable photo", COPY_AGAIN)
    with unreadable, Image.open(path, formats=["JPEG", "PNG", "TIFF"]) as picture:
        if picture.mode not in EIGHT_BIT_MODES:
            raise FileDamagedError(
                f"{path} is not an 8-bit RGB picture (Pillow's mode {picture.mode})",
                "Save it again as JPEG, PNG or TIFF with 8 bits a channel, RGB.",
            )
        width, height = picture.size
        tags = tags_of(picture)
    if tags.get(ExifTags.Base.Orientation) in TURNED:
        width, height = height, width
    exposure = exposure_of(tags)
    return Photo(
        path,
        width,
        height,
        taken=_moment(tags),
        shutter=exposure.time,
        iso=exposure.iso,
        f_number=exposure.f_number,
        focal_35mm=positive(tags, ExifTags.Base.FocalLengthIn35mmFilm),
    )


def _moment(tags: Tags) -> datetime | None:
    try:
        moment = datetime.strptime(
            str(tags[ExifTags.Base.DateTimeOriginal]).strip(" \0"), "%Y:%m:%d %H:%M:%S"
        )
    except (KeyError, ValueError):
        return None
    fraction = str(tags.get(ExifTags.Base.SubsecTimeOriginal, "")).strip(" \0")
    return moment + timedelta(seconds=float(f"0.{fraction}")) if fraction.isdigit() else moment
