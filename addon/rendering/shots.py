# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's camera and its keyframes as a video's frames, with the look of the model that is filmed.

The trainer's pictures are of the capture's own world: where the model stands in the scene is taken out of the
camera. Markers that bind cameras cut, lens and shift are followed.
"""

from collections.abc import Callable

import bpy
import numpy as np

from ...bridge.errors import BadValueError
from ...bridge.shots import Shot, Shots
from .. import similarity
from ..blender import render_size, world_of
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
    before = scene.frame_current, scene.frame_subframe
    frames: list[Shot] = []
    numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    size = render_size(scene, percentage)
    capture = origin.key_of(data)
    try:
        for done, number in enumerate(numbers, 1):
            scene.frame_set(number)
            depsgraph = context.evaluated_depsgraph_get()
            frames.append(_shot(scene, depsgraph, target, capture, lights, size))
            show(done, len(numbers))
    finally:
        scene.frame_set(before[0], subframe=before[1])
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
