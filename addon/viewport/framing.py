# SPDX-License-Identifier: GPL-3.0-or-later
"""The 3D view where a picture of a capture was taken."""

from collections.abc import Iterator

import bpy
import numpy as np
from mathutils import Matrix

from ..blender import cloud_of, world_of
from ..layouts.cameras import Frame
from ..model.attributes import POSITION
from ..model.point_cloud import read_attribute

#: The larger side of a view shows what a camera of that lens would show on a sensor twice as wide as its own.
HALF_SENSOR = 36.0
#: Millimetres that a view's lens can have.
LENS = (1.0, 250.0)
#: Points that tell how far away what is seen is.
SAMPLED = 10_000


def views(context: bpy.types.Context) -> Iterator[tuple[bpy.types.SpaceView3D, bpy.types.RegionView3D]]:
    """The 3D view that is asked in, or else those of the window."""
    areas = [context.area] if context.area else []
    if not (areas and areas[0].type == "VIEW_3D"):
        areas = [each for each in context.screen.areas if each.type == "VIEW_3D"] if context.screen else []
    for area in areas:
        space = area.spaces.active
        if isinstance(space, bpy.types.SpaceView3D) and space.region_3d is not None:
            yield space, space.region_3d


def look_from(context: bpy.types.Context, place: Frame, target: bpy.types.Object) -> None:
    """Let views show what the camera at ``place``, in the world, saw of ``target``, all of its picture."""
    matrix = np.array(world_of(target), np.float64)
    position = read_attribute(cloud_of(target), POSITION.name)
    seen = position[:: len(position) // SAMPLED + 1] @ matrix[:3, :3].T + matrix[:3, 3]
    away = np.linalg.norm(seen - place.camera_to_world[:3, 3], axis=1)
    for view, region in views(context):
        area = next(each for each in context.screen.areas if each.spaces.active == view)
        window = next(each for each in area.regions if each.type == "WINDOW")
        view.lens = lens_of(place, window.width, window.height)
        region.view_perspective = "PERSP"
        region.view_distance = float(np.median(away)) if len(away) else 1.0  # what one then turns around
        region.view_matrix = Matrix(place.camera_to_world.tolist()).inverted()


def lens_of(place: Frame, width: int, height: int) -> float:
    """The lens, mm, with which a view of that size just shows all of the camera's picture."""
    across, up = 0.5 * place.width / place.fx, 0.5 * place.height / place.fy
    larger = max(across, up * width / height) if width >= height else max(up, across * height / width)
    return min(max(HALF_SENSOR / larger, LENS[0]), LENS[1])
