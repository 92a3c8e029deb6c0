# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's camera and its keyframes as a video's frames, with the look of the model that is filmed.

The trainer's pictures are of the capture's own world: where the model stands in the scene is taken out of the
camera. Markers that bind cameras cut, lens and shift are followed.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import bpy
import numpy as np

from ...bridge.errors import BadValueError
from ...bridge.shots import Shot, Shots
from .. import similarity
from ..blender import animated_paths, render_size, world_of
from ..capture import placement
from ..model import origin
from ..model.look import look_of
from ..model.point_cloud import photographed_ev_of
from ..settings import preview_levels
from ..viewport.camera import from_matrices


def shots_of(
    context: bpy.types.Context,
    target: bpy.types.Object | None,
    data: str,
    lights: tuple[str, ...],
    percentage: float = 100.0,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> Shots:
    """The frames of the scene's animation, at ``percentage`` of the render's size.

    ``target``: the imported model whose place, exposure and levels are filmed; without one the place is the
    scene's for the data set ``data``, and the look that of the live preview, whose model has ``lights``.

    Raises ``BadValueError`` where there is no perspective camera, or nothing moves; ``DataMismatchError``
    where the model is sheared, mirrored or flat.
    """
    scene = context.scene
    frames: list[Shot] = []
    numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    size = render_size(scene, percentage)
    capture = origin.key_of(data)
    with _left_as_it_was(context):
        for done, number in enumerate(numbers, 1):
            scene.frame_set(number)
            depsgraph = context.evaluated_depsgraph_get()
            frames.append(_shot(scene, depsgraph, target, capture, lights, size))
            show(done, len(numbers))
    if len(frames) < 2 or all(frame.is_like(frames[0]) for frame in frames[1:]):
        raise BadValueError(
            f"nothing is animated between frames {scene.frame_start} and {scene.frame_end}",
            "Give the camera, the exposure or a level keyframes, or choose another path.",
        )
    render = scene.render
    return Shots(*size, render.fps / render.fps_base / scene.frame_step, frames)


def _shot(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    target: bpy.types.Object | None,
    capture: str,
    lights: tuple[str, ...],
    size: tuple[int, int],
) -> Shot:
    camera = scene.camera
    if camera is None or not isinstance(camera.data, bpy.types.Camera):
        raise BadValueError("the scene has no camera", "Add one, or choose another path.")
    if camera.data.type != "PERSP":
        raise BadValueError(
            f"the camera {camera.name!r} is not a perspective camera, and the backend draws no other",
            "Set its type to Perspective, or choose another path.",
        )
    evaluated = camera.evaluated_get(depsgraph)
    render = scene.render
    window = evaluated.calc_matrix_camera(
        depsgraph,
        x=size[0],
        y=size[1],
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    # A camera's own scale does nothing to what it sees.
    view = evaluated.matrix_world.normalized().inverted()
    pinhole = from_matrices(view, window, *size)
    if target is None:
        settings = placement.settings_of(scene)
        to_world = placement.matrix_of(scene, capture)
        ev, levels = settings.exposure_ev - settings.photographed_ev, preview_levels(settings, lights)
    else:
        to_world = np.array(world_of(target, depsgraph), np.float64)
        look = look_of(target, depsgraph)
        ev, levels = look.exposure_ev - photographed_ev_of(target), look.lighting_levels
    similarity.scale_of(to_world)  # in a mirrored or sheared capture no camera sees what this one sees
    pose = similarity.into_capture(to_world, pinhole.camera_to_world)
    return Shot(pose, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, float(ev), tuple(map(float, levels)))


# ---- the scene afterwards ----------------------------------------------------------------------------------


@contextmanager
def _left_as_it_was(context: bpy.types.Context) -> Iterator[None]:
    """Put the scene back to its frame, its camera, and the values that the user has set over keyframes.

    Setting a frame gives it a marker's camera and everything that is animated its keyed value. A scene aside
    (as in ``synth.user_camera``) would keep these, but not film what a render does: handlers, simulations
    and drivers that read the scene's frame; and it would evaluate the model a second time.
    """
    scene = context.scene
    frame, subframe, camera = scene.frame_current, scene.frame_subframe, scene.camera
    before = list(_animated_values())
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=subframe)
        if scene.camera != camera:
            scene.camera = camera
        for block, path, value in before:
            if _value(block, path) not in (None, value):
                _set_value(block, path, value)
        context.view_layer.update()


def _animated_values() -> Iterator[tuple[bpy.types.ID, str, Any]]:
    """What is animated in this file, and its value now."""
    for block in bpy.data.user_map():
        if block.library is not None:
            continue
        # A material's nodes have an animation of their own.
        blocks: tuple[Any, ...] = (block, getattr(block, "node_tree", None))
        for each in blocks:
            for path in animated_paths(each) if getattr(each, "animation_data", None) else ():
                if (value := _value(each, path)) is not None:
                    yield each, path, value


def _value(block: bpy.types.ID, path: str) -> Any:
    """A property's value; None where the path leads to nothing that has one."""
    try:
        value: Any = block.path_resolve(path)
    except (ValueError, ReferenceError):  # its bone or modifier is gone; a handler took the block away
        return None
    if isinstance(value, bool | int | float | str | set):
        return value
    return tuple(value) if hasattr(value, "__len__") else None


def _set_value(block: bpy.types.ID, path: str, value: Any) -> None:
    found: Any = block.path_resolve(path, False)
    if custom := re.search(r'\["((?:[^"\\]|\\.)*)"\]$', path):
        found.data[bpy.utils.unescape_identifier(custom[1])] = value
    else:
        setattr(found.data, path.rpartition(".")[2], value)
    block.update_tag()
