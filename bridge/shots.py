# SPDX-License-Identifier: GPL-3.0-or-later
"""The frames of a video as a file: for each a camera, an exposure and the lights' levels.

Blender writes it from the scene's camera and its keyframes, ``physhdr render --camera`` reads it. JSON, in
the terms of ``transforms.json``: ``transform_matrix`` is camera to world in the capture's own space, OpenGL
axes.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from .atomic import atomic_path
from .errors import BadValueError, FileDamagedError
from .limits import EV_MAX, FOCAL_LENGTH, PRINCIPAL_POINT, is_number
from .regular import read_json_object

FORMAT, VERSION = "physhdr-shots", 1
#: So many frames a file may have: an hour at 60 a second.
MOST_FRAMES = 216_000
AGAIN = "Let Blender's panel write it again (Video…)."


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame. ``camera_to_world`` ``[4, 4]`` float64, rigid, looks down −Z; ``fx, fy, cx, cy`` pixels.

    ``exposure_ev``: stops from the video's exposure. ``levels``: of the model's lights, in their order; those
    that are not given are at 1.
    """

    camera_to_world: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    exposure_ev: float = 0.0
    levels: tuple[float, ...] = ()

    def is_like(self, other: "Shot") -> bool:
        """Whether both give the same picture."""
        return _row(self) == _row(other)


@dataclass(frozen=True, eq=False)
class Shots:
    """The frames of a video: ``width`` by ``height`` pixels, ``fps`` a second."""

    width: int
    height: int
    fps: float
    frames: Sequence[Shot]


def write_shots(path: Path, shots: Shots) -> None:
    """Write the file, atomically; raises ``OutputError``."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "w": shots.width,
        "h": shots.height,
        "fps": shots.fps,
        "frames": [_row(shot) for shot in shots.frames],
    }
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")


def read_shots(path: Path, fewest: int = 2) -> Shots:
    """Read the file, of ``fewest`` frames or more.

    Raises ``FileMissingError``, ``FileDamagedError`` or ``BadValueError`` that names it.
    """
    content = read_json_object(Path(path), AGAIN)
    if content.get("format") != FORMAT or content.get("version") != VERSION:
        raise FileDamagedError(f"{path} is not a {FORMAT} file of version {VERSION}", AGAIN)
    width, height, fps = content.get("w"), content.get("h"), content.get("fps")
    if not (_is_size(width) and _is_size(height) and is_number(fps) and 0.0 < fps <= 240.0):
        raise BadValueError(f"{path}: w, h and fps must be above 0, fps at most 240", AGAIN)
    frames = content.get("frames")
    if not isinstance(frames, list) or not fewest <= len(frames) <= MOST_FRAMES:
        raise BadValueError(f"{path}: it must have from {fewest} to {MOST_FRAMES} frames", AGAIN)
    return Shots(width, height, float(fps), [_shot(path, i, row) for i, row in enumerate(frames)])


def _row(shot: Shot) -> dict[str, Any]:
    return {
        "transform_matrix": np.asarray(shot.camera_to_world, float).tolist(),
        "fl_x": shot.fx,
        "fl_y": shot.fy,
        "cx": shot.cx,
        "cy": shot.cy,
        "exposure_ev": shot.exposure_ev,
        "levels": list(shot.levels),
    }


def _shot(path: Path, index: int, row: Any) -> Shot:
    try:
        pose = np.array(row["transform_matrix"], np.float64)
        numbers = [row[name] for name in ("fl_x", "fl_y", "cx", "cy")]
        numbers += [row.get("exposure_ev", 0.0), *row.get("levels", [])]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise BadValueError(f"{path}: frame {index} has no camera or is not a frame at all", AGAIN) from None
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not all(map(is_number, numbers)):
        raise BadValueError(f"{path}: frame {index} holds something that is not a number", AGAIN)
    fx, fy, cx, cy, exposure_ev, *levels = map(float, numbers)
    for focal in (fx, fy):
        FOCAL_LENGTH.check(focal, f"{path}: the focal length of frame {index}")
    for centre in (cx, cy):
        PRINCIPAL_POINT.check(centre, f"{path}: the principal point of frame {index}")
    if not all(level >= 0.0 for level in levels):
        raise BadValueError(f"{path}: frame {index} has a level below 0", AGAIN)
    if abs(exposure_ev) > EV_MAX:
        raise BadValueError(
            f"{path}: frame {index} has an exposure of {exposure_ev:g} EV: at most ±{EV_MAX:g}", AGAIN
        )
    return Shot(pose, fx, fy, cx, cy, exposure_ev, tuple(levels))


def _is_size(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value <= 20_000
