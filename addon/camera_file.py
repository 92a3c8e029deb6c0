# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera poses of a data set (``transforms_*.json``, docs/formats.md), without the trainer's readers."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError
from ..bridge.limits import check_position
from ..bridge.regular import read_json_object


@dataclass(frozen=True, eq=False)
class Pose:
    """``camera_to_world``: ``[4, 4]`` in Blender's axes; ``angle_x``: radians; ``name``: the frame's file."""

    camera_to_world: np.ndarray
    angle_x: float
    name: str


def read_pose(path: Path, index: int) -> Pose:
    """Pose ``index`` of a transforms file. Raises the errors of ``bridge.errors`` with the path."""
    if not path.exists():
        raise FileMissingError(f"there is no camera file {path}", "Give a transforms_*.json.")
    content = read_json_object(path, "Make the data set again.")
    try:
        frames, angle_x = list(content["frames"]), float(content["camera_angle_x"])
        if not 0 <= index < len(frames):
            raise BadValueError(f"{path} has no camera {index}", f"Choose one from 0 to {len(frames) - 1}.")
        matrix = np.array(frames[index]["transform_matrix"], float)
        name = str(frames[index].get("file_path", index))
    except PhysHDRError:
        raise
    except Exception as error:
        raise FileDamagedError(
            f"{path}: camera {index} cannot be read ({type(error).__name__}: {error})",
            "Make the data set again.",
        ) from error
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or not 0.0 < angle_x < np.pi:
        raise BadValueError(
            f"{path}: camera {index} is not a finite 4×4 pose with an angle in (0, π)",
            "Mend the file or make the data set again.",
        )
    check_position(matrix[:3, 3], f"{path}: camera {index}")
    return Pose(matrix, angle_x, name)
