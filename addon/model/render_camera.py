# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera that renders, as a model's nodes see it: by it some of the model is left out (``cleaning``)."""

import bpy
import mathutils
import numpy as np

from ..blender import render_size
from .cleaning import EVEN, Place, RenderCamera


def render_camera(target: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> RenderCamera | None:
    """The scene's active camera in the space of the model ``target``; None where the scene has none."""
    scene = depsgraph.scene
    if scene is None or scene.camera is None:
        return None
    camera = scene.camera.evaluated_get(depsgraph)
    lens = camera.data
    if not isinstance(lens, bpy.types.Camera):
        return None
    placed = target.evaluated_get(depsgraph).matrix_world
    pose = placed.inverted_safe() @ camera.matrix_world
    axes = pose.to_3x3().transposed()
    right, up, back = (_place(axis.normalized()) for axis in axes)
    sides = sorted(abs(side) for side in placed.to_scale())
    render, (width, height) = scene.render, render_size(scene)
    projection = camera.calc_matrix_camera(
        depsgraph,
        x=width,
        y=height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    return RenderCamera(
        place=_place(pose.translation),
        right=right,
        up=up,
        back=back,
        projection=tuple(np.array(projection).reshape(-1).tolist()),
        is_orthographic=lens.type == "ORTHO",
        unit=axes[0].length / camera.matrix_world.to_3x3().transposed()[0].length,
        is_even=sides[2] <= sides[0] * EVEN,
    )


def _place(vector: mathutils.Vector) -> Place:
    return vector.x, vector.y, vector.z
