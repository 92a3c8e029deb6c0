# SPDX-License-Identifier: GPL-3.0-or-later
"""What hangs and burns in ``sponza``: banners and curtains, a creeper, lanterns, braziers."""

import math
import random

import bpy
from mathutils import Vector

from . import materials as m
from . import materials_stone as stone
from . import materials_upholstery as soft
from .lighting import Lighting
from .props import ball, lathe, rod, sheet
from .shapes import leaf, scatter, turned
from .sponza_colonnade import HALF_X, HALF_Y, RAIL, STOREY
from .tubes import tube

Collection = bpy.types.Collection

LANTERN_RADIANCE = 3000.0
FLAME_RADIANCE = 3000.0
LAMP_COLOUR = (1.0, 0.66, 0.34)
FIRE_COLOUR = (1.0, 0.48, 0.15)

GOLD, CREAM = (0.62, 0.40, 0.09), (0.66, 0.58, 0.42)
RED, BLUE, GREEN = (0.42, 0.028, 0.025), (0.025, 0.06, 0.24), (0.03, 0.17, 0.08)


def _hang(
    room: Collection,
    name: str,
    at: tuple[float, float, float],
    turn: float,
    size: tuple[float, float],
    cloth,
    folds: float,
) -> None:
    """A banner over the gallery's rail, its face toward −Y before it is turned."""
    wide, long = size

    def surface(u: float, v: float) -> tuple[float, float, float]:
        x = (u - 0.5) * wide * (1.0 - 0.05 * v)
        deep = 0.05 * math.sin(math.tau * folds * u + 0.4 * math.sin(4.0 * v)) * min(1.0, 2.0 * v)
        if v < 0.14:  # on the rail
            return x, -0.24 + (0.14 - v) * 3.2, 0.012 + 0.002 * math.sin(40 * u)
        below = (v - 0.14) / 0.86
        bulge = 0.20 * math.exp(-(((below - 0.42) / 0.2) ** 2))  # over the cornice
        off = min(0.24 + 1.2 * below, 0.33)
        return x, -off - bulge - deep, -below * long + 0.03 * math.sin(math.pi * u)

    with turned(room, name, at, turn):
        sheet(room, name, surface, cloth, steps=(48, 40))


def drapes(room: Collection) -> None:
    cloths = {
        "red": stone.drape("red drape", RED, GOLD, (0.50, 0.10, 0.04)),
        "blue": stone.drape("blue drape", BLUE, GOLD, (0.05, 0.13, 0.36)),
        "green": stone.drape("green drape", GREEN, CREAM, (0.08, 0.26, 0.12)),
    }
    left, right = math.pi / 2, -math.pi / 2
    size = (1.25, 1.95)
    for name, x, y, turn in (
        ("red", -HALF_X, 2.0, left),
        ("blue", -HALF_X, 4.0, left),
        ("green", -HALF_X, 0.0, left),
        ("green", HALF_X, 4.0, right),
        ("red", HALF_X, 2.0, right),
        ("blue", HALF_X, 0.0, right),
        ("red", -1.0, HALF_Y, 0.0),
        ("blue", 1.0, HALF_Y, 0.0),
    ):
        _hang(room, f"{name} banner", (x, y, RAIL), turn, size, cloths[name], 3.0 + 0.3 * y)
    brass = m.plain("curtain brass", (0.72, 0.48, 0.18), 0.3, 1.0)
    for name, x, y, turn, s in (
        ("red", -HALF_X, 5.0, left, 1),
        ("blue", HALF_X, 5.0, right, -1),
        ("green", HALF_X, 1.0, right, 1),
    ):
        with turned(room, f"{name} curtain", (x, y, 0.0), turn):
            rod(room, "curtain pole", (-0.8, 0.0, 2.62), (0.8, 0.0, 2.62), 0.02, brass)

            def tied(u: float, v: float, s: int = s) -> tuple[float, float, float]:
                waist = 1.0 - 0.72 * math.exp(-(((v - 0.62) / 0.22) ** 2))
                x = s * (0.75 - (1.0 - u) * 1.45 * (waist if v > 0.0 else 1.0) * (1.0 - 0.35 * v))
                return x, 0.07 * math.sin(math.tau * 6.0 * u) * (0.4 + 0.6 * waist), 2.60 - 2.5 * v

            sheet(room, "curtain", tied, cloths[name], steps=(70, 40))
            tube(
                room,
                "tie",
                [(s * (0.75 - 0.30 * k / 6), -0.09 if 0 < k < 6 else 0.0, 1.08 - 0.02 * k) for k in range(7)],
                0.02,
                brass,
            )


def creeper(room: Collection, dice: random.Random) -> None:
    """Bougainvillea falls from the left and the far gallery: leaves and blossoms strewn along its shoots."""
    green = soft.foliage("creeper", (0.03, 0.10, 0.02), (0.13, 0.26, 0.05))
    pink = soft.foliage("blossom", (0.50, 0.03, 0.16), (0.72, 0.08, 0.30))
    blade, petal = leaf("creeper leaf", 0.10, 0.07, green), leaf("petal", 0.085, 0.075, pink)
    shoot = m.plain("shoot", (0.12, 0.10, 0.05), 0.8)
    for k in range(26):
        if k < 14:
            along = -HALF_X + 0.27, dice.uniform(2.72, 3.42)
        else:
            along = dice.uniform(1.72, 2.6), HALF_Y - 0.27
        side = Vector((1, 0, 0)) if k < 14 else Vector((0, -1, 0))
        start = Vector((*along, RAIL + 0.03)) - side * 0.2
        drop = dice.uniform(0.5, 2.0)
        path = [start, start + side * 0.22 + Vector((0, 0, 0.06))]
        for step in range(1, 7):
            z = -drop * step / 6
            bulge = 0.18 if RAIL + z > STOREY - 0.2 else 0.10
            sway = 0.12 * math.sin(1.3 * step + k)
            path.append(start + side * (0.24 + bulge) + Vector((side.y * sway, side.x * sway, z)))
        host = tube(room, f"creeper {k}", path, 0.012, shoot, 6)
        scatter(host, petal if k % 3 == 0 else blade, 620.0, (0.6, 1.2), 1.2, seed=k)


def lanterns(room: Collection, lighting: Lighting) -> None:
    """Bare bulbs in iron cages on chains, in the aisles and before the far door."""
    iron = m.plain("lantern iron", (0.03, 0.026, 0.022), 0.4, 1.0)
    aisle = HALF_X + 1.1
    for k, (x, y) in enumerate(
        ((-aisle, 1.0), (aisle, 1.0), (-aisle, 5.0), (aisle, 5.0), (-1.0, 8.1), (1.0, 8.1))
    ):
        z = 2.35
        lighting.bulb("lanterns", f"lantern {k}", (x, y, z), 0.06, LANTERN_RADIANCE, LAMP_COLOUR)
        tube(room, "chain", [(x, y, STOREY), (x, y, z + 0.26)], 0.012, iron, 6)
        cap = [(0.0, 0.13), (0.02, 0.12), (0.05, 0.06), (0.14, 0.0), (0.13, -0.01), (0.0, 0.0)]
        lathe(room, "lantern cap", (x, y, z + 0.15), cap, iron, 6)
        lathe(
            room,
            "lantern floor",
            (x, y, z - 0.2),
            [(0.0, 0.0), (0.10, 0.0), (0.11, 0.03), (0.0, 0.03)],
            iron,
            6,
        )
        rod(room, "candle", (x, y, z - 0.18), (x, y, z - 0.055), 0.025, m.plain("wax", CREAM, 0.5))
        for j in range(6):
            a = math.tau * j / 6
            c, s = math.cos(a), math.sin(a)
            tube(
                room,
                "cage",
                [(x + 0.105 * c, y + 0.105 * s, z - 0.18), (x + 0.13 * c, y + 0.13 * s, z + 0.15)],
                0.007,
                iron,
                6,
            )


def braziers(room: Collection, lighting: Lighting, dice: random.Random) -> None:
    """Bronze bowls on three legs, coals and a flame: two before the far arcade, one in the right shade."""
    bronze = stone.patina("brazier bronze", (0.55, 0.34, 0.15), (0.12, 0.22, 0.17), 0.38)
    coal = m.plain("coal", (0.012, 0.011, 0.010), 0.9)
    for k, (x, y) in enumerate(((-1.05, 5.7), (1.05, 5.7), (2.45, 0.35))):
        top = 0.95
        bowl = [
            (0.0, -0.14),
            (0.1, -0.13),
            (0.22, -0.06),
            (0.29, 0.02),
            (0.31, 0.03),
            (0.28, 0.035),
            (0.2, -0.03),
            (0.0, -0.08),
        ]
        lathe(room, "brazier", (x, y, top), bowl, bronze, 36)
        for j in range(3):
            a = 0.4 + math.tau * j / 3
            c, s = math.cos(a), math.sin(a)
            leg = [(0.27, 0.0), (0.2, 0.3), (0.17, 0.55), (0.24, 0.8), (0.26, 0.92)]
            tube(room, "brazier leg", [(x + r * c, y + r * s, z) for r, z in leg], 0.018, bronze)
        for _ in range(14):
            a, r = dice.uniform(0, math.tau), dice.uniform(0.0, 0.2)
            ball(
                room,
                "coal",
                (x + r * math.cos(a), y + r * math.sin(a), top - 0.02),
                dice.uniform(0.035, 0.055),
                coal,
                1,
            )
        flame = lighting.bulb(
            "braziers", f"brazier {k}", (x, y, top + 0.13), 0.085, FLAME_RADIANCE, FIRE_COLOUR
        )
        flame.scale = (0.85, 0.85, 1.6)
