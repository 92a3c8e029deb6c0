# SPDX-License-Identifier: GPL-3.0-or-later
"""HDR-NeRF-Real's cameras and exposures: LLFF's table of poses with one more column."""

from pathlib import Path

import numpy as np

from ..axes import camera_to_world_from_llff
from ..errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError
from ..limits import EXPOSURE, FOCAL_LENGTH, LARGEST_SIDE, check_position
from ..regular import damaged_where_it_fails, regular_file
from .checks import is_rotation
from .picture_files import bracket_name
from .transforms import Pinhole

POSES_FILE, PICTURES = "poses_bounds_exps.npy", "input_images"
#: Of a row: 3 × 5 numbers of the pose, two bounds, and the exposure.
COLUMNS = 18
COPY_AGAIN = "Copy the data set again."


def picture_names(folder: Path) -> dict[tuple[int, int], str]:
    """``{(pose, place in the bracket): file name}`` in the order of names, which is that of the rows.

    Raises ``FileMissingError`` without pictures, ``DataMismatchError`` for a name of another form.
    """
    if not folder.is_dir():
        raise FileMissingError(f"{folder} is missing", COPY_AGAIN)
    names: dict[tuple[int, int], str] = {}
    for path in sorted(folder.iterdir()):
        # macOS leaves ._003_1.jpg beside 003_1.jpg on other systems' disks.
        if path.suffix.lower() not in (".jpg", ".jpeg", ".png") or path.name.startswith("."):
            continue
        parts = bracket_name(path.name)
        if parts is None or not parts[0].isdigit():
            raise DataMismatchError(
                f"{path} is not named <pose>_<exposure>, as 003_1.jpg", "Rename it, or move it away."
            )
        if (key := (int(parts[0]), parts[1])) in names:
            raise DataMismatchError(f"{path} and {names[key]} are the same exposure of one pose", COPY_AGAIN)
        names[key] = path.name
    if not names:
        raise FileMissingError(f"{folder} holds no pictures", COPY_AGAIN)
    return names


def read_rows(path: Path, folder: Path, names: dict[tuple[int, int], str]) -> np.ndarray:
    """``[pictures, 18]`` float64, finite, a row for each of the ``names`` in ``folder``.

    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``.
    """
    regular_file(path, COPY_AGAIN)
    with damaged_where_it_fails(f"{path} is not a readable array", COPY_AGAIN):
        # Mapped, not read: a header that claims more than the file holds is refused, nothing is allocated.
        rows = np.array(np.load(path, mmap_mode="r", allow_pickle=False), dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        raise FileDamagedError(
            f"{path} has the shape {rows.shape}, not one row of {COLUMNS} a picture", COPY_AGAIN
        )
    if len(rows) != len(names):
        raise DataMismatchError(
            f"{path} has {len(rows)} rows, {folder.name}/ has {len(names)} pictures",
            "There must be a row for each picture, in the order of names: copy what is missing again.",
        )
    if not np.isfinite(rows).all():
        row = int(np.argwhere(~np.isfinite(rows))[0][0])
        raise BadValueError(f"{path}: row {row} holds NaN or infinity", COPY_AGAIN)
    for row, seconds in enumerate(rows[:, 17].tolist()):
        EXPOSURE.check(seconds, f"{path}: the exposure of row {row}")
    return rows


def middle_row(names: dict[tuple[int, int], str], rows: np.ndarray, number: int) -> np.ndarray:
    """``[18]``: that of the middle picture of a pose's bracket, whose camera is the pose's."""
    of_pose = [row for row, (pose, _) in zip(rows, names, strict=True) if pose == number]
    return of_pose[len(of_pose) // 2]


def pinhole_of(path: Path, number: int, row: np.ndarray) -> Pinhole:
    """The camera of a row, at the size that the row states; raises ``BadValueError``."""
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    pose = camera_to_world_from_llff(matrix[:, :4])
    if not is_rotation(pose[:3, :3]):
        raise BadValueError(f"{path}: pose {number} is not a rotation: {pose[:3, :3].tolist()}", COPY_AGAIN)
    check_position(pose[:3, 3], f"{path}: the camera of pose {number}")
    if not (1.0 <= width <= LARGEST_SIDE and 1.0 <= height <= LARGEST_SIDE and focal in FOCAL_LENGTH):
        raise BadValueError(
            f"{path}: pose {number} has {width:g}×{height:g} pixels, focal length {focal:g}", COPY_AGAIN
        )
    return Pinhole(pose, round(width), round(height), focal, focal, 0.5 * round(width), 0.5 * round(height))
