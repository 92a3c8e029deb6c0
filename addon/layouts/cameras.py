# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a data set of any layout: where each picture was taken, and through what. No bpy."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...bridge import data_set
from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.layouts import looked_for
from ...bridge.layouts.checks import rigid_pose
from ...bridge.layouts.transforms import frames_of
from ...bridge.limits import is_number
from ...bridge.regular import read_json_object
from .views import COPY_AGAIN, View, read_views


@dataclass(frozen=True, eq=False)
class Pose:
    """``camera_to_world``: ``[4, 4]`` in Blender's axes; ``angle_x``: radians; ``name``: the frame's file."""

    camera_to_world: np.ndarray
    angle_x: float
    name: str


@dataclass(frozen=True, eq=False)
class Frame:
    """A camera of a data set: name and split as of its ``View``; the rest as of a ``Pinhole``."""

    name: str
    split: str
    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class Frames:
    """The cameras of a data set, and sentences about what they do not show."""

    frames: tuple[Frame, ...]
    notes: tuple[str, ...] = field(default=())


def read_pose(path: Path, index: int) -> Pose:
    """Pose ``index`` of a transforms file. Raises the errors of ``bridge.errors`` with the path."""
    if not path.exists():
        raise FileMissingError(f"there is no camera file {path}", "Give a transforms_*.json.")
    content = read_json_object(path, "Make the data set again.")
    frames, angle_x = frames_of(path, content), content.get("camera_angle_x")
    if not 0 <= index < len(frames):
        raise BadValueError(f"{path} has no camera {index}", f"Choose one from 0 to {len(frames) - 1}.")
    name, entry = frames[index]
    if not is_number(angle_x) or not 0.0 < angle_x < np.pi:
        raise BadValueError(
            f"{path}: 'camera_angle_x' is {angle_x!r:.80}, not an angle in (0, π)",
            "Fix the file or make the data set again.",
        )
    return Pose(rigid_pose(path, entry.get("transform_matrix"), str(index)), float(angle_x), name)


def read_frames(root: Path) -> Frames:
    """The cameras of the data set in a folder, in the order of splits and then of the files.

    Raises ``FileMissingError`` where the folder has no known layout, or no camera; and what ``read_views``
    raises.
    """
    views = _views(root)
    frames = tuple(Frame(view.name, view.split, *view.camera) for view in views if view.camera is not None)
    if not frames:
        raise FileMissingError(f"{root} has no camera whose picture's size is known", COPY_AGAIN)
    notes = []
    if bent := sum(view.is_bent for view in views):
        whose = "The lens bends" if bent == len(views) else f"The lenses of {bent} cameras bend"
        notes.append(
            f"{whose} straight lines, Blender's cameras do not: they show a little more or less than photos."
        )
    if unsized := len(views) - len(frames):
        notes.append(f"Ignoring {unsized} cameras: nothing states the size of their pictures.")
    return Frames(frames, tuple(notes))


def camera_places(root: Path) -> np.ndarray:
    """``[N, 3]`` float64: where the cameras of a data set were, without lit and validation views.

    Raises as ``read_frames``.
    """
    apart = (data_set.LIT, data_set.VALIDATION)
    places = [view.camera_to_world[:3, 3] for view in _views(root, seen=True) if view.split not in apart]
    if not places:
        raise FileMissingError(f"{root} has no cameras", "Choose the data set that the model was made of.")
    return np.array(places).reshape(-1, 3)


def _views(root: Path, seen: bool = False) -> tuple[View, ...]:
    found = read_views(root)
    if found is None:
        raise FileMissingError(
            f"{root} is not a data set: looked for {looked_for()}",
            "Choose the folder that the model was trained from.",
        )
    return found.seen if seen else found.views
