# SPDX-License-Identifier: GPL-3.0-or-later
"""What the readers of all layouts check alike: JSON, numbers, poses."""

import math
import re
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from .. import limits
from ..data_set import plain_name
from ..errors import BadValueError, FileDamagedError
from ..regular import read_json_object

#: A rotation's columns may be this far from orthonormal: poses are written with about six digits.
RIGID_TOLERANCE = 1e-3

MAKE_AGAIN = "Make the data set again (only what is missing is rendered), or copy it again."


def read_json(path: Path) -> dict[str, Any]:
    """The object in a file of a data set; raises what ``read_json_object`` raises."""
    return read_json_object(path, MAKE_AGAIN)


def require(path: Path, content: dict[str, Any], key: str, where: str = "") -> Any:
    if key not in content:
        raise FileDamagedError(
            f"{path}{where} has no '{key}'", f"Add it as docs/formats.md says. {MAKE_AGAIN}"
        )
    return content[key]


def number(path: Path, value: Any, what: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return float(value)
    except OverflowError:
        pass  # an integer beyond the range of floats
    raise BadValueError(f"{path}: {what} must be a finite number, got {value!r:.80}", "Fix it in that file.")


def exposure(path: Path, value: Any, whose: str) -> float:
    """Seconds; raises ``BadValueError`` for what is no number or no exposure."""
    what = f"the exposure of '{whose:.80}'"
    return limits.EXPOSURE.check(number(path, value, what), f"{path}: {what}")


def path_inside(root: Path, name: str, origin: Path) -> Path:
    """``root / name``; raises ``BadValueError`` where that would lead out of ``root``, on any system."""
    plain = PurePosixPath(plain_name(name))
    drive = plain.parts and re.match("[A-Za-z]:", plain.parts[0])
    if plain.is_absolute() or ".." in plain.parts or not plain.parts or drive:
        raise BadValueError(
            f"{origin}: the file '{name:.80}' is not in {root}",
            "Name files relative to that folder, without '..'.",
        )
    return root / plain


def rigid_pose(path: Path, matrix: Any, which: str) -> np.ndarray:
    """``[4, 4]`` float64 camera to world, checked to be a rotation and a translation.

    ``matrix``: 4×4, or the first three rows of that.
    """
    remedy = f"Fix 'transform_matrix' of that frame in {path.name}; scale and shear must be removed."
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        pose = np.empty(0)
    if pose.shape == (3, 4):
        pose = np.vstack([pose, (0.0, 0.0, 0.0, 1.0)])
    if pose.shape != (4, 4):
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a 4×4 matrix of numbers", remedy
        )
    if not np.isfinite(pose).all():
        raise BadValueError(f"{path}: frame {which}: 'transform_matrix' holds NaN or infinity", remedy)
    if not (is_rotation(pose[:3, :3]) and np.allclose(pose[3], (0.0, 0.0, 0.0, 1.0), atol=RIGID_TOLERANCE)):
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a rotation and a translation", remedy
        )
    limits.check_position(pose[:3, 3], f"{path}: the camera of frame {which}")
    return pose


def is_rotation(matrix: np.ndarray) -> bool:
    """Whether a finite ``[3, 3]`` matrix is one, to ``RIGID_TOLERANCE``."""
    if np.abs(matrix).max() > 2.0:  # whose squares might overflow
        return False
    orthonormal = np.allclose(matrix.T @ matrix, np.eye(3), atol=RIGID_TOLERANCE)
    return bool(orthonormal and np.linalg.det(matrix) > 0.0)
