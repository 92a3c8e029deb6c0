# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene as Blender evaluates it for renders: other subdivisions, modifiers, particles than views show."""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import bpy

from . import settings
from .interrupts import held
from .progress import quiet

T = TypeVar("T")

_ENGINE = "PHYSHDR_LOOK"
#: A render that hands over the scene and makes no picture: nothing of the user's comes behind it.
_SETTINGS: list[tuple[str, Any]] = [
    ("render.engine", _ENGINE),
    ("render.use_border", False),
    ("render.use_compositing", False),
    ("render.use_sequencer", False),
    ("render.use_freestyle", False),
    ("render.use_multiview", False),
    ("render.use_persistent_data", False),
]
#: Pixels of its shorter side: Blender refuses a few.
_SIDE = 16


def look(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, at: Callable[[bpy.types.Depsgraph], T]) -> T:
    """What ``at`` returns of a layer as it is rendered. The scene must have a camera.

    Only render engines are given that, and only while they render. Raises what ``at`` raises.
    """
    found: list[T] = []
    failed: list[BaseException] = []

    class Look(bpy.types.RenderEngine):
        bl_idname = _ENGINE
        bl_label = "PhysHDR"

        def render(self, depsgraph: bpy.types.Depsgraph | None) -> None:
            assert depsgraph is not None
            try:
                found.append(at(depsgraph))
            except BaseException as error:  # noqa: BLE001 (Blender would print it and continue; raised below)
                failed.append(error)

    bpy.utils.register_class(Look)
    shorter = min(scene.render.resolution_x, scene.render.resolution_y)
    size = ("render.resolution_percentage", math.ceil(100 * _SIDE / shorter))
    try:
        with settings.applied(scene, [*_SETTINGS, size], None), quiet(), held():
            bpy.ops.render.render(write_still=False, scene=scene.name, layer=layer.name)
    finally:
        bpy.utils.unregister_class(Look)
    if failed:
        raise failed[0]
    if not found:  # Blender took the CTRL-C for itself
        raise KeyboardInterrupt
    return found[0]
