# SPDX-License-Identifier: GPL-3.0-or-later
"""The cube that Blender starts with, which stands where the origin of a capture is."""

import bpy

from . import originals

NAME, SIZE, CORNERS = "Cube", 2.0, 8


def hide(scene: bpy.types.Scene) -> str:
    """Hide it in views and renders, where nobody has touched it; its name, empty where there is none.

    What a data set of the scene was rendered from stays: then it is the subject.
    """
    cube = scene.objects.get(NAME)
    if cube is None or cube.hide_render or not is_untouched(cube) or cube in originals.of_models(scene):
        return ""
    cube.hide_render = True
    cube.hide_set(True)
    return cube.name


def is_untouched(cube: bpy.types.Object) -> bool:
    """Whether an object is as Blender's startup file has it."""
    mesh = cube.data
    return (
        isinstance(mesh, bpy.types.Mesh)
        and len(mesh.vertices) == CORNERS
        and all(cube.dimensions[axis] == SIZE for axis in range(3))
        and cube.matrix_world.is_identity
        and not (cube.modifiers or cube.constraints or cube.children or cube.animation_data)
        and cube.library is None
    )
