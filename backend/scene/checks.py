# SPDX-License-Identifier: GPL-3.0-or-later
"""What the readers of all layouts check alike: JSON, numbers, poses."""

import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError

#: A rotation's columns may be this far from orthonormal: poses are written with about six digits.
RIGID_TOLERANCE = 1e-3

MAKE_AGAIN = "Make the data set again (only what is missing is rendered), or copy it again."


def read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileMissingError(f"{path} is missing", MAKE_AGAIN)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise FileDamagedError(
            f"{path} is not valid JSON: line {error.lineno}, column {error.colno}: {error.msg}",
            f"Mend that line. {MAKE_AGAIN}",
        ) from error
    except (ValueError, RecursionError, OSError) as error:  # not UTF-8, a number of thousands of digits
        raise FileDamagedError(f"{path} cannot be read as JSON: {error}", MAKE_AGAIN) from error
    if not isinstance(content, dict):
        raise FileDamagedError(f"{path} holds a {type(content).__name__}, not an object", MAKE_AGAIN)
    return content


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
    raise BadValueError(f"{path}: {what} must be a finite number, got {value!r:.80}", "Mend it in that file.")


def plain_name(name: str) -> str:
    """A path as the data sets write it, without ``./`` and with forward slashes."""
    return name.replace("\\", "/").removeprefix("./")


def path_inside(root: Path, name: str, told_by: Path) -> Path:
    """``root / name``; raises ``BadValueError`` where that would lead out of ``root``."""
    plain = PurePosixPath(plain_name(name))
    if plain.is_absolute() or ".." in plain.parts or not plain.parts or ":" in plain.parts[0]:
        raise BadValueError(
            f"{told_by}: the file '{name}' is not in {root}",
            "Name files relative to that folder, without '..'.",
        )
    return root / plain


def rigid_pose(path: Path, matrix: Any, which: str) -> np.ndarray:
    """``[4, 4]`` float64 camera to world, checked to be a rotation and a translation."""
    remedy = f"Mend 'transform_matrix' of that frame in {path.name}; scale and shear must be removed."
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        pose = np.empty(0)
    if pose.shape != (4, 4):
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a 4×4 matrix of numbers", remedy
        )
    if not np.isfinite(pose).all():
        raise BadValueError(f"{path}: frame {which}: 'transform_matrix' holds NaN or infinity", remedy)
    rotation = pose[:3, :3]
    rigid = (
        np.allclose(rotation.T @ rotation, np.eye(3), atol=RIGID_TOLERANCE)
        and np.linalg.det(rotation) > 0.0
        and np.allclose(pose[3], (0.0, 0.0, 0.0, 1.0), atol=RIGID_TOLERANCE)
    )
    if not rigid:
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a rotation and a translation", remedy
        )
    return pose
