# SPDX-License-Identifier: GPL-3.0-or-later
"""Rings and arching leaves."""

import math
import random

import bpy

from ..blender import Point
from . import materials as m
from .props import leaf_blade, sheet

Collection = bpy.types.Collection
Material = bpy.types.Material


def torus(
    room: Collection,
    name: str,
    centre: Point,
    radius: float,
    thick: float,
    material: Material,
    tilt: float = 0.0,
) -> bpy.types.Object:
    """A ring that lies flat, or is tilted about X: ``thick`` is the radius of its body."""

    def surface(u: float, v: float) -> Point:
        a, b = 2.0 * math.pi * u, 2.0 * math.pi * v
        r = radius + thick * math.cos(b)
        return r * math.cos(a), r * math.sin(a), thick * math.sin(b)

    item = sheet(room, name, surface, material, steps=(32, 12))
    item.location, item.rotation_euler = centre, (tilt, 0.0, 0.0)
    return item


def leaf_tuft(
    room: Collection,
    root: Point,
    leaves: int,
    lengths: tuple[float, float],
    width: float,
    rise: float,
    dice: random.Random,
) -> None:
    """Arching leaves from one point: a fern, a spider plant."""
    greens = [
        m.leaf(f"leaf {k}", (0.015, 0.06, 0.015), c)
        for k, c in enumerate([(0.07, 0.20, 0.04), (0.17, 0.32, 0.07)])
    ]
    for k in range(leaves):
        angle = k * 2.399963 + dice.uniform(-0.2, 0.2)  # golden angle
        steep = rise * (0.5 + 0.8 * (1.0 - k / leaves))
        leaf_blade(room, "leaf", root, angle, dice.uniform(*lengths), width, greens[k % 2], steep, 1.25)
