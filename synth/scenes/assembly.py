# SPDX-License-Identifier: GPL-3.0-or-later
"""Things made of many parts in axes of their own, and rings."""

import math

import bpy
from mathutils import Quaternion, Vector

from ..blender import Point
from .props import Holder, lathe


class Assembly:
    """Stands in for a collection: what the props link to it goes into ``room`` as a part of one thing.

    Parts are given in the thing's own axes: origin at the middle of its foot, front toward −Y. ``turn``:
    radians about Z; ``lean``: about its own X after that.
    """

    def __init__(self, room: Holder, name: str, foot: Point, turn: float = 0.0, lean: float = 0.0) -> None:
        self.room = room
        self.hub = bpy.data.objects.new(name, None)
        self.hub.location, self.hub.rotation_euler = foot, (lean, 0.0, turn)
        room.objects.link(self.hub)
        self.objects = self

    def link(self, item: bpy.types.Object) -> None:
        self.room.objects.link(item)
        item.parent = self.hub


def ring(
    collection: Holder,
    name: str,
    centre: Point,
    radius: float,
    thick: float,
    material: bpy.types.Material,
    axis: Point = (0.0, 0.0, 1.0),
    sides: int = 48,
) -> bpy.types.Object:
    """A torus about ``axis``: ``radius`` to the middle of a bar of radius ``thick``."""
    angles = [2.0 * math.pi * k / 10 for k in range(11)]
    profile = [(radius + thick * math.cos(a), thick * math.sin(a)) for a in angles]
    item = lathe(collection, name, centre, profile, material, sides)
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = _toward(axis)
    return item


def disk(
    collection: Holder,
    name: str,
    centre: Point,
    radius: float,
    material: bpy.types.Material,
    axis: Point = (0.0, 0.0, 1.0),
    sides: int = 48,
) -> bpy.types.Object:
    """A flat round that looks along ``axis``: mirrors, dials, what fills a cup."""
    item = lathe(collection, name, centre, [(0.0, 0.0), (radius, 0.0)], material, sides)
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = _toward(axis)
    return item


def _toward(axis: Point) -> Quaternion:
    return Vector((0.0, 0.0, 1.0)).rotation_difference(Vector(axis))
