# SPDX-License-Identifier: GPL-3.0-or-later
"""Where captures stand: what the scene remembers of each, and the models and cameras of it, with what the
models' limits are measured from.

What is remembered is where models of a capture (``model.origin``) are put when they are imported, and where
the live preview shows it.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import bpy
import mathutils
import numpy as np

from ...bridge.errors import DataMismatchError
from .. import similarity
from ..blender import animated_paths, cloud_of, put_at, to_matrix, world_of
from ..model import nodes
from ..model.attributes import CAPTURE, TURN
from ..model.look import models_among
from ..model.origin import capture_of
from ..settings import SETTINGS

if TYPE_CHECKING:
    from ..settings import PHYSHDR_Capture, PHYSHDR_Settings

#: Custom property that marks a camera of a data set (``dataset_cameras``): its frame's name.
FRAME = "physhdr_frame"
#: An object's transform, as animation names it.
TRANSFORM = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
#: What a model's limits are measured from, and which types of objects are there for that alone: a camera or
#: a figure is the scene's, and stays.
LIMITS = {nodes.CROP_BOX: ("EMPTY", "MESH"), nodes.DISTANCE_FROM: ("EMPTY",)}


def settings_of(scene: bpy.types.Scene) -> "PHYSHDR_Settings":
    return getattr(scene, SETTINGS)


def matrix_of(scene: bpy.types.Scene, capture: str) -> np.ndarray:
    """``[4, 4]`` float64: where the scene remembers a capture's world to stand; the identity where it does
    not."""
    found = settings_of(scene).captures.get(capture)
    return _square(found.matrix) @ _about_x(-found.turn) if found else np.eye(4)


def models_of(scene: bpy.types.Scene, capture: str) -> Iterator[bpy.types.Object]:
    """The scene's models of a capture; not those that are linked from another file."""
    for target in models_among(scene.objects):
        if target.library is None and capture_of(target) == capture:
            yield target


def cameras_of(scene: bpy.types.Scene, capture: str) -> Iterator[bpy.types.Object]:
    """The scene's cameras that came from a capture's data set; not those linked from another file."""
    for camera in scene.objects:
        is_ours = camera.type == "CAMERA" and camera.library is None and FRAME in camera
        if is_ours and str(camera.get(CAPTURE, "")) == capture:
            yield camera


def limits_of(model: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """The model's crop box, and the middle of its largest distance, where they stand by themselves.

    What hangs on something, or carries something, is where the user wants it by that: on the model it goes
    along.
    """
    modifier = nodes.find_modifier(model)
    if modifier is None:
        return
    for label, types in LIMITS.items():
        found = nodes.get_input(modifier, label) if nodes.has_input(modifier, label) else None
        if found is None or found.type not in types or found.library is not None:
            continue
        if found.parent is None and not found.constraints and not found.children:
            yield found


def place(scene: bpy.types.Scene, target: bpy.types.Object) -> None:
    """Put a model that was just imported where its capture stands, if the scene remembers that.

    The turn that its file's axes want comes first.
    """
    if known := settings_of(scene).captures.get(capture_of(target)):
        target.matrix_world = to_matrix(_square(known.matrix) @ _turn_between(known, target))


def check_at_rest(scene: bpy.types.Scene, capture: str) -> None:
    """Raise ``DataMismatchError`` where something animates the transform of a model or a camera of a capture,
    or of what a model's limits are measured from: the next frame would undo what is set of it."""
    for each in (*models_of(scene, capture), *cameras_of(scene, capture)):
        _check_still(
            each, "Remove its keyframes and drivers, and animate an empty that is its parent instead."
        )
    for each in (limit for model in models_of(scene, capture) for limit in limits_of(model)):
        _check_still(
            each, "Remove its keyframes and drivers, or parent it to the model, to go along with it."
        )


def _check_still(item: bpy.types.Object, hint: str) -> None:
    paths = animated_paths(item)
    if animated := next((path for path in TRANSFORM if path in paths), None):
        raise DataMismatchError(
            f"the {animated.split('_')[0]} of {item.name} is animated, and would go back to that at the next "
            "frame",
            hint,
        )


def move(scene: bpy.types.Scene, target: bpy.types.Object, change: np.ndarray) -> "PHYSHDR_Capture":
    """Let ``change`` ``[4, 4]`` happen to all models and cameras of the target's capture, and remember where
    it is then.

    What hangs on them (a parent's children) goes along, and so does what the models' limits are measured
    from. Raises ``DataMismatchError`` where the target's own matrix is no similarity, and as
    ``check_at_rest``, before anything is moved.
    """
    bpy.context.view_layer.update()  # what a script has just set is in no matrix yet
    capture, now = capture_of(target), np.array(world_of(target), np.float64)
    check_at_rest(scene, capture)
    similarity.scale_of(now)
    kept = remembered(scene, target, now)
    wanted = {each: change @ np.array(world_of(each)) for each in models_of(scene, capture)}
    _put(_limits_after(wanted) | wanted | _cameras_after(scene, capture, change))
    kept.matrix = (change @ now @ np.linalg.inv(_turn_between(kept, target))).reshape(-1)
    return kept


def remembered(scene: bpy.types.Scene, target: bpy.types.Object, now: np.ndarray) -> "PHYSHDR_Capture":
    """The scene's entry of a model's capture, begun where there is none, with where the model stood before
    all settings."""
    capture, captures = capture_of(target), settings_of(scene).captures
    found = captures.get(capture)
    if found is None:
        found = captures.add()
        found.name = capture
        found.original = now.reshape(-1)
        found.turn = cloud_of(target).get(TURN, 0.0)
    return found


def _turn_between(known: "PHYSHDR_Capture", target: bpy.types.Object) -> np.ndarray:
    """``[4, 4]``: from the axes of a model's file to those of the file by which its capture was first set."""
    return _about_x(cloud_of(target).get(TURN, 0.0) - known.turn)


def _about_x(angle: float) -> np.ndarray:
    return np.array(mathutils.Matrix.Rotation(angle, 4, "X"), np.float64)


def _square(numbers: Sequence[float]) -> np.ndarray:
    """``[4, 4]`` float64 of 16 numbers, row by row."""
    return np.array(numbers, np.float64).reshape(4, 4)


def forget(scene: bpy.types.Scene, target: bpy.types.Object) -> None:
    """Put the models of the target's capture back to where they were imported, and remember nothing.

    Raises as ``check_at_rest``, with nothing changed.
    """
    capture, captures = capture_of(target), settings_of(scene).captures
    index = captures.find(capture)
    if index < 0:
        return
    check_at_rest(scene, capture)
    bpy.context.view_layer.update()
    known = captures[index]
    original = _square(known.original)
    back = original @ np.linalg.inv(_square(known.matrix))
    wanted = {each: original @ _turn_between(known, each) for each in models_of(scene, capture)}
    _put(_limits_after(wanted) | wanted | _cameras_after(scene, capture, back))
    captures.remove(index)


def _cameras_after(
    scene: bpy.types.Scene, capture: str, change: np.ndarray
) -> dict[bpy.types.Object, np.ndarray]:
    """``[4, 4]``: where the cameras of a capture are after ``change``."""
    cameras = cameras_of(scene, capture)
    return {each: without_scale(change @ np.array(world_of(each), np.float64)) for each in cameras}


def _limits_after(wanted: dict[bpy.types.Object, np.ndarray]) -> dict[bpy.types.Object, np.ndarray]:
    """``[4, 4]``: where what is hidden of models is measured from, so that it stays the same where they are
    wanted."""
    after = {}
    for model, matrix in wanted.items():
        change = matrix @ np.array(world_of(model).inverted_safe(), np.float64)
        after |= {each: change @ np.array(world_of(each), np.float64) for each in limits_of(model)}
    return after


def without_scale(matrix: np.ndarray) -> np.ndarray:
    """A similarity ``[4, 4]`` at the same place, of scale 1: a camera has no size."""
    rigid = np.array(matrix, np.float64)
    rigid[:3, :3] /= np.cbrt(np.linalg.det(rigid[:3, :3]))
    return rigid


def _put(wanted: dict[bpy.types.Object, np.ndarray]) -> None:
    """Objects where they shall be: parents first, since what hangs on them goes along."""
    by_depth: dict[int, list[bpy.types.Object]] = {}
    for each in wanted:
        by_depth.setdefault(_depth(each), []).append(each)
    for depth in sorted(by_depth):
        for each in by_depth[depth]:
            put_at(each, to_matrix(wanted[each]))
        bpy.context.view_layer.update()


def _depth(item: bpy.types.Object) -> int:
    """How many objects an object hangs on, one on another."""
    return 0 if item.parent is None else 1 + _depth(item.parent)
