# SPDX-License-Identifier: GPL-3.0-or-later
"""``dog``: a hound on a braided rug before a stone fireplace, in a cottage 4.2 × 4.6 × 2.45 m.

Back wall (+Y): left a window with autumn sun that falls on the dog, right the fireplace with live coals.
Ambient light is sky, sun and a soft fill behind the camera; the lamps are two groups, the fire and the bare
bulb on the side table.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import dog_hearth as hearth
from . import dog_room as things
from . import materials as m
from . import materials_hearth as mh
from .dog_animal import dog
from .forms import standing
from .lighting import Lighting
from .props import ball, box, rod, sheet
from .skies import clouded

WEST, EAST, BACK, FRONT, HEIGHT = -2.1, 2.1, 1.8, -2.8, 2.45
WINDOW = (-1.72, -0.62, 0.72, 1.98)  # x0, x1, z0, z1
CHIMNEY = 0.62  # x of its middle

BULB_RADIANCE = 400.0
BULB_COLOUR = (1.0, 0.72, 0.42)
SKY_RADIANCE = 22.0  # at the horizon; W / m² / sr, any unit does
SUN_IRRADIANCE = 64.0
FILL_POWER = 70.0  # watts
COAL_RADIANCE, FLAME_RADIANCE, FIRE_POWER = 120.0, 110.0, 450.0

#: A clear autumn day with some high cloud.
SKY = clouded(
    [(0.0, (1.0, 0.88, 0.72)), (0.12, (0.80, 0.88, 1.0)), (0.5, (0.28, 0.47, 0.85))],
    clouds=(1.5, 1.4, 1.25),
    cover=(0.48, 0.70),
    scale=4.0,
    flat=3.0,
    distortion=0.4,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(23)  # the design is fixed; --seed moves noise, not furniture
    _shell(room, dice)
    _window(room)
    _outside(room, dice)
    lighting = Lighting(scene)
    _daylight(lighting)
    hearth.fireplace(room, lighting, dice, (CHIMNEY, BACK), (COAL_RADIANCE, FLAME_RADIANCE, FIRE_POWER))
    lies = standing((0.06, 0.10, 0.032), math.radians(-48.0))
    assets.place(
        "dog", room, lies.translation, (0.5, 1.2, 0.62), math.radians(-48.0), lambda: dog(room, lies)
    )
    things.furnish(room, assets, dice)
    things.lamp(room, lighting, (1.42, 0.98, 0.0), BULB_RADIANCE, BULB_COLOUR)
    hints = CameraHints(
        centre=(-0.40, -2.25, 1.12),
        target=(0.08, 0.36, 0.54),
        extent=(1.5, 0.8),
        angle_x=math.radians(55.0),
        orbit_radius=2.55,
        orbit_arc=math.radians(42.0),
        elevation=(math.radians(3.0), math.radians(26.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _shell(room: bpy.types.Collection, dice: random.Random) -> None:
    """Floor, walls with a hole for the window, painted boards below, beams above."""
    wall = 0.14
    width, depth, cy = EAST - WEST, BACK - FRONT, (BACK + FRONT) / 2
    box(room, "floor", (0, cy, -0.05), (width, depth, 0.1), m.floorboards("floorboards"))
    lime = m.plaster("lime plaster", (0.50, 0.43, 0.33), 0.3)
    x0, x1, z0, z1 = WINDOW
    y = BACK + wall / 2
    for name, (a, b, low, high) in {
        "left": (WEST - wall, x0, 0.0, HEIGHT),
        "right": (x1, EAST + wall, 0.0, HEIGHT),
        "below": (x0, x1, 0.0, z0),
        "above": (x0, x1, z1, HEIGHT),
    }.items():
        box(room, f"wall {name}", ((a + b) / 2, y, (low + high) / 2), (b - a, wall, high - low), lime)
    for name, x in (("west", WEST - wall / 2), ("east", EAST + wall / 2)):
        box(room, f"wall {name}", (x, cy, HEIGHT / 2), (wall, depth, HEIGHT), lime)
    box(room, "wall front", (0, FRONT - wall / 2, HEIGHT / 2), (width + 2 * wall, wall, HEIGHT), lime)
    ceiling = m.plaster("ceiling", (0.62, 0.58, 0.50), 0.2)
    box(room, "ceiling", (0, cy, HEIGHT + 0.05), (width + 0.3, depth + 0.3, 0.1), ceiling)
    beam = m.wood("beam", (0.05, 0.026, 0.014), (0.14, 0.075, 0.04), "Y")
    for index, x in enumerate((-1.5, -0.5, 0.5, 1.5)):
        box(room, f"beam {index}", (x, cy, HEIGHT - 0.07), (0.13, depth, 0.14), beam, bevel=0.012)
    sage = mh.boards("sage boards", (0.15, 0.22, 0.17), (0.32, 0.27, 0.19))
    rail = 0.70
    count = 28
    for k in range(count):
        x = WEST + width * (k + 0.5) / count
        if abs(x - CHIMNEY) < 0.6:
            continue
        thick = 0.018 + dice.uniform(0.0, 0.003)
        box(
            room,
            "board",
            (x, BACK - thick / 2, rail / 2),
            (width / count - 0.006, thick, rail),
            sage,
            bevel=0.004,
        )
    for k in range(30):
        y = FRONT + depth * (k + 0.5) / 30
        for x in (WEST + 0.009, EAST - 0.009):
            box(room, "board", (x, y, rail / 2), (0.018, depth / 30 - 0.006, rail), sage, bevel=0.004)
    box(room, "dado", (0, BACK - 0.02, rail + 0.015), (width, 0.04, 0.035), sage, bevel=0.008)
    box(room, "skirting", (0, BACK - 0.022, 0.06), (width, 0.026, 0.12), sage, bevel=0.006)


def _window(room: bpy.types.Collection) -> None:
    """Small panes, a deep sill with pots, checked curtains. No glass: it would only add noise."""
    x0, x1, z0, z1 = WINDOW
    white = m.plain("window paint", (0.66, 0.63, 0.55), 0.4)
    cx, cz, y = (x0 + x1) / 2, (z0 + z1) / 2, BACK + 0.06
    for x in (x0 + 0.03, x1 - 0.03):
        box(room, "jamb", (x, y, cz), (0.06, 0.12, z1 - z0), white, bevel=0.006)
    for z in (z0 + 0.03, z1 - 0.03):
        box(room, "head", (cx, y, z), (x1 - x0, 0.12, 0.06), white, bevel=0.006)
    box(room, "mullion", (cx, y, cz), (0.06, 0.07, z1 - z0), white, bevel=0.006)
    for z in (z0 + (z1 - z0) / 3, z0 + (z1 - z0) * 2 / 3):
        box(room, "muntin", (cx, y, z), (x1 - x0, 0.04, 0.028), white)
    for x in (cx - (x1 - x0) / 4, cx + (x1 - x0) / 4):
        box(room, "muntin", (x, y, cz), (0.028, 0.04, z1 - z0), white)
    oak = m.wood("sill oak", (0.14, 0.07, 0.03), (0.32, 0.18, 0.08), "X")
    box(room, "sill", (cx, BACK - 0.06, z0 - 0.022), (x1 - x0 + 0.18, 0.26, 0.045), oak, bevel=0.01)
    iron = m.plain("curtain iron", (0.03, 0.03, 0.03), 0.4, 0.8)
    rod(room, "curtain rod", (x0 - 0.26, BACK - 0.10, 2.12), (x1 + 0.24, BACK - 0.10, 2.12), 0.012, iron)
    for x in (x0 - 0.27, x1 + 0.25):
        ball(room, "finial", (x, BACK - 0.10, 2.12), 0.025, iron, 2)
    check = m.curtain("check", (0.56, 0.50, 0.38), (0.42, 0.08, 0.05))
    for x_from, x_to in ((x0 - 0.24, x0 + 0.10), (x1 - 0.10, x1 + 0.22)):

        def gathered(u: float, v: float, a: float = x_from, b: float = x_to) -> tuple[float, float, float]:
            depth = 0.03 * math.sin(2.0 * math.pi * 5.0 * u) * (0.6 + 0.4 * v)
            return a + (b - a) * (u + 0.02 * math.sin(9 * v)), BACK - 0.10 + depth, 2.11 - v * 1.47

        sheet(room, "curtain", gathered, check, steps=(60, 14))


def _outside(room: bpy.types.Collection, dice: random.Random) -> None:
    """What the window shows: a picket fence, a meadow, trees in autumn, a barn, hills."""
    grass = m.fabric("meadow", (0.07, 0.08, 0.02), (0.22, 0.19, 0.06), 0.3)
    sheet(room, "meadow", lambda u, v: (-30 + 60 * u, 2.2 + 60 * v, -0.5 - 0.6 * v), grass, steps=(8, 8))
    paint = m.plain("pickets", (0.55, 0.53, 0.47), 0.7)
    for k in range(30):
        box(room, "picket", (-8.2 + 0.32 * k, 7.0, 0.0), (0.18, 0.03, 1.0), paint)
    for z in (-0.1, 0.3):
        box(room, "picket rail", (-3.5, 7.05, z), (10.0, 0.04, 0.07), paint)
    leaves = [
        m.fabric(f"autumn {k}", dark, light, 0.8)
        for k, (dark, light) in enumerate(
            (((0.16, 0.045, 0.01), (0.50, 0.20, 0.03)), ((0.05, 0.06, 0.015), (0.28, 0.22, 0.04)))
        )
    ]
    trunk = m.plain("trunk", (0.08, 0.055, 0.04), 0.9)
    for k in range(9):
        x, y, radius = (
            -16.0 + 2.6 * k + dice.uniform(-0.7, 0.7),
            dice.uniform(15.0, 22.0),
            dice.uniform(1.3, 2.1),
        )
        ball(room, f"tree {k}", (x, y, 1.5), radius, leaves[k % 2], 4, 0.28 * radius, seed=1.7 * k)
        rod(room, f"trunk {k}", (x, y, -1.2), (x, y, 1.2), 0.15, trunk)
    red = m.bricks("barn")
    box(room, "barn", (-9.0, 27.0, 0.9), (6.0, 4.0, 3.6), red)
    roof = m.plaster("barn roof", (0.16, 0.13, 0.12), 0.4)
    for side in (-1, 1):
        box(room, "barn roof", (-9.0, 27.0 + side * 1.1, 3.4), (6.6, 2.9, 0.16), roof, (-side * 0.68, 0, 0))
    hill = m.fabric("hill", (0.12, 0.13, 0.11), (0.24, 0.21, 0.17), 0.2)

    def hills(u: float, v: float) -> tuple[float, float, float]:
        x = -70 + 140 * u
        return x, 60 + 10 * v, -3.0 + (8.0 + 1.8 * math.sin(0.10 * x) + 0.8 * math.sin(0.33 * x + 1)) * v

    sheet(room, "hills", hills, hill, steps=(60, 4))


def _daylight(lighting: Lighting) -> None:
    """Sky and sun through the window, a soft fill (the rest of the cottage)."""
    x0, x1, z0, z1 = WINDOW
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.portal(((x0 + x1) / 2, BACK + 0.13, (z0 + z1) / 2), (0.0, -1.0, 0.0), (x1 - x0, z1 - z0))
    lighting.sun((0.38, -0.70, -0.45), SUN_IRRADIANCE, (1.0, 0.80, 0.56), angle=0.6)  # a patch on rug and dog
    lighting.area(
        "fill", (-0.3, FRONT + 0.06, 1.8), (0.05, 1.0, -0.2), (2.6, 1.1), FILL_POWER, (0.80, 0.89, 1.0)
    )
