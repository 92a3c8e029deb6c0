# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's camera models (its ``src/colmap/sensor/models.h``): what the numbers of a camera are."""

from typing import NamedTuple


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
