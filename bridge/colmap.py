# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's camera models (its ``src/colmap/sensor/models.h``): what the numbers of a camera are; and which of
the sparse models in a data set's folder is read.
"""

import struct
from pathlib import Path
from typing import NamedTuple

from .errors import BadValueError, PhysHDRError
from .regular import read_text, regular_file

#: At the beginning of ``images.bin``: how many pictures; and what each takes at least.
_COUNT, _IMAGE = struct.Struct("<Q"), struct.Struct("<i7di")
#: Bytes of ``images.txt`` that are looked at; that of ten thousand pictures has some 1e9.
_LARGEST = 1 << 34


class CameraModel(NamedTuple):
    """How many numbers a camera of this model has: focal lengths first, then the principal point's two where
    there are focal lengths (a panorama has none), then what bends lines."""

    name: str
    numbers: int
    focal_lengths: int


#: By the numbers that binary files have.
MODELS = dict(
    enumerate(
        (
            CameraModel("SIMPLE_PINHOLE", 3, 1),
            CameraModel("PINHOLE", 4, 2),
            CameraModel("SIMPLE_RADIAL", 4, 1),
            CameraModel("RADIAL", 5, 1),
            CameraModel("OPENCV", 8, 2),
            CameraModel("OPENCV_FISHEYE", 8, 2),
            CameraModel("FULL_OPENCV", 12, 2),
            CameraModel("FOV", 5, 2),
            CameraModel("SIMPLE_RADIAL_FISHEYE", 4, 1),
            CameraModel("RADIAL_FISHEYE", 5, 1),
            CameraModel("THIN_PRISM_FISHEYE", 12, 2),
            CameraModel("RAD_TAN_THIN_PRISM_FISHEYE", 16, 2),
            CameraModel("SIMPLE_DIVISION", 4, 1),
            CameraModel("DIVISION", 5, 2),
            CameraModel("SIMPLE_FISHEYE", 3, 1),
            CameraModel("FISHEYE", 4, 2),
            CameraModel("EUCM", 6, 2),
            CameraModel("EQUIRECTANGULAR", 2, 0),
        )
    )
)
#: By the names that text files have.
BY_NAME = {model.name: model for model in MODELS.values()}
#: The model of panoramas.
ALL_AROUND = "EQUIRECTANGULAR"


def panorama(whose: str) -> BadValueError:
    """The error for ``whose`` pictures that show everything around, which no pinhole camera does."""
    return BadValueError(
        f"{whose} takes 360° panoramas ({ALL_AROUND}), which no pinhole camera does",
        "Cut them into views of 90° first, six to a cube, and find the cameras of those.",
    )


def find_model(root: Path) -> Path | None:
    """The folder of COLMAP's files: of ``sparse/0``, ``sparse/1`` … that with the most pictures; or None.

    COLMAP makes a model of each part of the pictures that hangs together, in any order. Without any it is
    ``sparse`` itself, as ``image_undistorter`` has it.
    """
    found = models_in(root / "sparse")
    if len(found) < 2:
        return next(iter(found), None)
    return max(found, key=picture_count)  # the first of equals


def models_in(sparse: Path) -> list[Path]:
    """The models in a folder by their numbers, or the folder itself where it is one and holds none."""
    try:
        numbers = sorted((int(path.name), path) for path in sparse.iterdir() if path.name.isdecimal())
    except OSError:
        return []
    found = [path for _, path in numbers if _is_model(path)]
    return found or [sparse] * _is_model(sparse)


def _is_model(folder: Path) -> bool:
    return any((folder / f"images.{kind}").exists() for kind in ("bin", "txt"))


def picture_count(model: Path) -> int:
    """How many pictures a model says that it has; 0 where it is damaged, which its reader then says."""
    path = model / "images.bin"
    try:
        if not path.exists():
            return _count_in_text(model / "images.txt")
        with open(regular_file(path), "rb") as file:
            (count,) = _COUNT.unpack(file.read(_COUNT.size))
        return min(count, path.stat().st_size // _IMAGE.size)
    except (PhysHDRError, OSError, struct.error):
        return 0


def _count_in_text(path: Path) -> int:
    lines = (line for line in read_text(path, "", _LARGEST).split("\n") if not line.lstrip().startswith("#"))
    count = 0
    for line in lines:
        if line.strip():
            next(lines, None)  # its observations, of which there may be none
            count += 1
    return count
