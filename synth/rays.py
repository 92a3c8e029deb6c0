# SPDX-License-Identifier: GPL-3.0-or-later
"""What a ray meets first of what is rendered and of what 3D views show (``in_views.shown``: all of it)."""

from typing import Any

import bpy
from mathutils import Vector

from .blender import evaluated
from .in_render import rendered

SKIPS = 32  # objects that are not rendered, passed through on the way
PAST = 1e-5  # of the way so far, and at least as many metres: how far behind a surface the ray continues


class Rays:
    """Rays in a view layer as it is now."""

    def __init__(self, scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
        layer.update()
        self.scene, self.depsgraph = scene, evaluated(layer)
        self.rendered = set(rendered(scene, layer))
        self._seen: dict[bpy.types.Object, bool] = {}

    def first(
        self, origin: Vector, direction: Vector, nearest: float = 0.0, farthest: float = 1e30
    ) -> tuple[Vector, Vector] | None:
        """Place and normal of the first surface that pictures show; ``None`` where there is none.

        ``direction``: of length 1; ``nearest``, ``farthest``: metres between which the surface must be.
        """
        start, gone = origin, 0.0
        for _ in range(SKIPS):
            hit, place, normal, _, item, _ = self.scene.ray_cast(
                self.depsgraph, start, direction, distance=farthest - gone
            )
            if not hit:
                return None
            met: Any = item.original
            step = (place - start).length
            if self._is_seen(met):
                if gone + step >= nearest:
                    return place, normal
                step = nearest - gone
            else:
                step += PAST * max(1.0, step)
            start, gone = start + direction * step, gone + step
            if gone >= farthest:
                return None
        return None

    def _is_seen(self, item: bpy.types.Object) -> bool:
        if item not in self._seen:
            self._seen[item] = item in self.rendered and item.visible_camera and _has_surface(item)
        return self._seen[item]


def _has_surface(item: bpy.types.Object) -> bool:
    """Whether an object is more than the bounds of a volume."""
    materials = [slot.material for slot in item.material_slots]
    return not materials or not all(map(_is_volume, materials))


def _is_volume(material: bpy.types.Material | None) -> bool:
    if material is None or material.node_tree is None:
        return False
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return False
    return bool(output.inputs["Volume"].is_linked and not output.inputs["Surface"].is_linked)
