# SPDX-License-Identifier: GPL-3.0-or-later
"""What a ray meets first of what is rendered."""

import bpy
from mathutils import Vector

from .blender import evaluated
from .in_render import rendered

SKIPS = 32  # objects that are not rendered, passed through on the way
PAST = 1e-5  # of the way so far, and at least as many metres: how far behind a surface the ray goes on


class Rays:
    """Rays in a view layer as it is now."""

    def __init__(self, scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> None:
        layer.update()
        self.scene, self.depsgraph = scene, evaluated(layer)
        self.rendered = set(rendered(scene, layer))

    def first(
        self, origin: Vector, direction: Vector, distance: float = 1e30
    ) -> tuple[Vector, Vector] | None:
        """Place and normal of the first surface that pictures show; ``None`` where there is none."""
        start, left = origin, distance
        for _ in range(SKIPS):
            hit, place, normal, _, item, _ = self.scene.ray_cast(
                self.depsgraph, start, direction, distance=left
            )
            if not hit:
                return None
            if item.original in self.rendered and _is_seen(item):
                return place, normal
            step = (place - start).length
            step += PAST * max(1.0, step)
            start, left = start + direction * step, left - step
            if left <= 0.0:
                return None
        return None


def _is_seen(item: bpy.types.Object) -> bool:
    """Not what only helps to work: cutters, bounds of volumes, rigs' shapes."""
    return item.visible_camera and item.display_type not in {"BOUNDS", "WIRE"}
