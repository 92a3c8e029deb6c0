# SPDX-License-Identifier: GPL-3.0-or-later
"""A small room with a window in its back wall (+Y), and a garden outside: shell of bathroom and bear."""

import math
import random
from dataclasses import dataclass

import bpy

from . import materials as m
from .props import ball, box, rod, sheet
from .skies import clouded

Collection = bpy.types.Collection
Material = bpy.types.Material

WALL = 0.16  # thickness, metres: the reveal that the sun grazes

#: The sky: soft clouds, brightest near the horizon.
MORNING = clouded(
    [(0.0, (1.0, 0.88, 0.72)), (0.12, (0.82, 0.89, 0.98)), (0.5, (0.28, 0.48, 0.85))],
    clouds=(1.5, 1.42, 1.28),
    cover=(0.46, 0.68),
    scale=4.0,
    flat=2.4,
)


@dataclass(frozen=True, kw_only=True)
class Room:
    """Inner measures in metres: x from −half to half, y from front to back, z from 0 to height."""

    half: float
    back: float
    front: float
    height: float
    #: The hole in the back wall: x0, x1, z0, z1.
    window: tuple[float, float, float, float]
    #: One more in the left wall: y0, y1, z0, z1.
    west: tuple[float, float, float, float] | None = None

    @property
    def window_middle(self) -> tuple[float, float, float]:
        """The middle of the hole, at the outer face of the wall: where a portal belongs."""
        x0, x1, z0, z1 = self.window
        return (x0 + x1) / 2, self.back + WALL + 0.005, (z0 + z1) / 2

    @property
    def window_size(self) -> tuple[float, float]:
        x0, x1, z0, z1 = self.window
        return x1 - x0, z1 - z0


def shell(
    room: Collection, at: Room, floor: Material, back: Material, sides: Material, top: Material
) -> None:
    """Floor, four walls, ceiling. Walls are thick and overlap at the corners: no light leaks in."""
    x0, x1, z0, z1 = at.window
    depth, middle, y = at.back - at.front, (at.back + at.front) / 2, at.back + WALL / 2
    half, height = at.half, at.height
    box(room, "floor", (0, middle, -0.05), (2 * half, depth, 0.1), floor)
    box(room, "ceiling", (0, middle, height + 0.05), (2 * half, depth, 0.1), top)
    for name, (a, b, low, high) in {
        "left": (-half, x0, 0.0, height),
        "right": (x1, half, 0.0, height),
        "below": (x0, x1, 0.0, z0),
        "above": (x0, x1, z1, height),
    }.items():
        box(room, f"wall {name}", ((a + b) / 2, y, (low + high) / 2), (b - a, WALL, high - low), back)
    for side in (-1, 1):
        ends = (at.front - WALL, at.back + WALL)
        y0, y1, z0, z1 = at.west if side < 0 and at.west else (middle, middle, 0.0, height)
        for a, b, low, high in (
            (ends[0], y0, 0.0, height),
            (y1, ends[1], 0.0, height),
            (y0, y1, 0.0, z0),
            (y0, y1, z1, height),
        ):
            if b > a and high > low:
                where = (side * (half + WALL / 2), (a + b) / 2, (low + high) / 2)
                box(room, "wall side", where, (WALL, b - a, high - low), sides)
    box(room, "wall behind", (0, at.front - WALL / 2, height / 2), (2 * half, WALL, height), sides)


def casement(room: Collection, at: Room, paint: Material, rows: int = 2) -> None:
    """A frame with a mullion and muntins, and a sill. No glass: it would only add noise."""
    x0, x1, z0, z1 = at.window
    (cx, _, cz), y = at.window_middle, at.back + 0.09
    for x in (x0 + 0.025, x1 - 0.025):
        box(room, "jamb", (x, y, cz), (0.05, 0.08, z1 - z0), paint, bevel=0.006)
    for z in (z0 + 0.025, z1 - 0.025):
        box(room, "rail", (cx, y, z), (x1 - x0, 0.08, 0.05), paint, bevel=0.006)
    box(room, "mullion", (cx, y, cz), (0.045, 0.06, z1 - z0), paint, bevel=0.006)
    for row in range(1, rows):
        box(room, "muntin", (cx, y, z0 + (z1 - z0) * row / rows), (x1 - x0, 0.04, 0.028), paint)
    box(room, "sill", (cx, at.back - 0.03, z0 - 0.015), (x1 - x0 + 0.14, 0.22, 0.03), paint, bevel=0.008)


def side_casement(room: Collection, at: Room, paint: Material) -> None:
    """The same in the left wall: what matters is the shadow that it throws."""
    if at.west is None:
        return
    y0, y1, z0, z1 = at.west
    cy, cz, x = (y0 + y1) / 2, (z0 + z1) / 2, -at.half - 0.09
    for y in (y0 + 0.025, cy, y1 - 0.025):
        box(room, "side jamb", (x, y, cz), (0.06, 0.05, z1 - z0), paint, bevel=0.006)
    for z in (z0 + 0.025, cz, z1 - 0.025):
        box(room, "side rail", (x, cy, z), (0.05, y1 - y0, 0.04), paint, bevel=0.006)
    box(
        room, "side sill", (-at.half + 0.03, cy, z0 - 0.015), (0.22, y1 - y0 + 0.14, 0.03), paint, bevel=0.008
    )


def garden(room: Collection, at: Room, dice: random.Random) -> None:
    """What the window shows: a hedge, trees, a tiled roof, hills."""
    grass = m.fabric("grass", (0.05, 0.09, 0.02), (0.13, 0.18, 0.05), 0.6)
    near = at.back + 1.0
    sheet(room, "garden", lambda u, v: (-30 + 60 * u, near + 50 * v, -1.0 - v), grass, steps=(6, 6))
    leaves = m.fabric("foliage", (0.03, 0.07, 0.02), (0.14, 0.21, 0.05), 3.0)
    trunk = m.plain("trunk", (0.10, 0.06, 0.04), 0.9)
    cx = at.window_middle[0]
    for index, (dx, y, radius) in enumerate(
        ((-2.6, 10.0, 1.3), (0.4, 14.0, 1.6), (2.9, 11.0, 1.4), (5.6, 17.0, 2.2), (-7.0, 17.0, 2.4))
    ):
        x, top = 2.6 * cx + dx, dice.uniform(0.7, 1.3)
        ball(room, f"tree {index}", (x, y, top), radius, leaves, 4, 0.26 * radius, seed=index * 1.7)
        rod(room, f"trunk {index}", (x, y, -1.6), (x, y, top), 0.16, trunk)
    tiles = m.plaster("roof", (0.26, 0.10, 0.06), 0.5)
    x = 4.0 * cx + 1.0
    box(room, "house", (x, 27.0, 0.2), (8.0, 5.0, 3.6), m.bricks("bricks"))
    for side in (-1, 1):
        tilt = (-side * math.radians(38.0), 0.0, 0.0)
        box(room, "roof", (x, 27.0 + side * 1.35, 2.95), (8.8, 3.4, 0.18), tiles, tilt)
    hill = m.fabric("hill", (0.10, 0.14, 0.12), (0.20, 0.24, 0.20), 0.25)

    def hills(u: float, v: float) -> tuple[float, float, float]:
        x = -70 + 140 * u
        ridge = 4.0 + 1.6 * math.sin(0.11 * x + 0.7) + 0.8 * math.sin(0.31 * x)
        return x, 55 + 10 * v, -3.0 + (ridge + 3.0) * v

    sheet(room, "hills", hills, hill, steps=(48, 3))
