# SPDX-License-Identifier: GPL-3.0-or-later
"""``interior``: a living room in the late afternoon, 4.2 × 4.4 × 2.5 m.

Back wall (+Y): a window with low sun, sofa below it, bookshelf to the right. A bare bulb hangs over the
slatted chair. Ambient light is sky, sun and a soft fill behind the camera; the lamps are two groups, the
hanging bulb and the bulb of the standing lamp.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import interior_furniture as furniture
from . import materials as m
from .lighting import Lighting
from .props import ball, box, rod, sheet
from .skies import clouded

WIDTH, BACK, FRONT, HEIGHT = 4.2, 1.8, -2.6, 2.5
WINDOW = (-1.45, -0.15, 0.92, 2.12)  # x0, x1, z0, z1

BULB_RADIANCE = 200.0
BULB_COLOUR = (1.0, 0.72, 0.42)
SKY_RADIANCE = 10.0  # at the horizon; W / m² / sr, any unit does
SUN_IRRADIANCE = 20.0
FILL_POWER = 22.0  # watts

#: Soft clouds, brightest near the horizon.
SKY = clouded(
    [(0.0, (1.0, 0.86, 0.68)), (0.10, (0.85, 0.90, 0.98)), (0.5, (0.30, 0.50, 0.85))],
    clouds=(1.55, 1.42, 1.25),
    cover=(0.45, 0.68),
    scale=4.5,
    flat=2.6,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(7)  # the design is fixed; --seed moves noise, not furniture
    _shell(room)
    _window(room)
    _outside(room, dice)
    furniture.furnish(room, dice)
    lighting = Lighting(scene)
    _light(room, lighting)
    hints = CameraHints(
        centre=(0.0, -2.1, 1.35),
        target=(0.05, 0.9, 0.98),
        extent=(1.5, 0.8),
        angle_x=math.radians(62.0),
        orbit_radius=2.9,
        orbit_arc=math.radians(50.0),
        elevation=(math.radians(-2.0), math.radians(22.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _shell(room: bpy.types.Collection) -> None:
    """Floor, walls with a hole for the window, ceiling with beams, skirting."""
    half, wall = WIDTH / 2, 0.12
    depth, middle = BACK - FRONT, (BACK + FRONT) / 2
    box(room, "floor", (0, middle, -0.05), (WIDTH, depth, 0.1), m.floorboards("floorboards"))
    paper = m.wallpaper("wallpaper", (0.50, 0.47, 0.36), (0.40, 0.43, 0.36), (0.20, 0.25, 0.20))
    x0, x1, z0, z1 = WINDOW
    y = BACK + wall / 2
    pieces = {
        "left": ((x0 - half) / 2, HEIGHT / 2, x0 + half, HEIGHT),
        "right": ((x1 + half) / 2, HEIGHT / 2, half - x1, HEIGHT),
        "below": ((x0 + x1) / 2, z0 / 2, x1 - x0, z0),
        "above": ((x0 + x1) / 2, (z1 + HEIGHT) / 2, x1 - x0, HEIGHT - z1),
    }
    for name, (x, z, sx, sz) in pieces.items():
        box(room, f"wall {name}", (x, y, z), (sx, wall, sz), paper)
    green = m.plaster("green plaster", (0.36, 0.42, 0.36))
    warm = m.plaster("warm plaster", (0.56, 0.44, 0.32))
    box(room, "wall west", (-half - wall / 2, middle, HEIGHT / 2), (wall, depth + 2 * wall, HEIGHT), green)
    box(room, "wall east", (half + wall / 2, middle, HEIGHT / 2), (wall, depth + 2 * wall, HEIGHT), warm)
    box(room, "wall behind", (0, FRONT - wall / 2, HEIGHT / 2), (WIDTH, wall, HEIGHT), green)
    box(
        room,
        "ceiling",
        (0, middle, HEIGHT + 0.05),
        (WIDTH, depth, 0.1),
        m.plaster("ceiling", (0.72, 0.70, 0.66), 0.15),
    )
    beam = m.wood("beam", (0.07, 0.035, 0.018), (0.17, 0.09, 0.045), "X")
    for index, at in enumerate((-1.4, -0.2, 1.0)):
        box(room, f"beam {index}", (0, at, HEIGHT - 0.07), (WIDTH, 0.13, 0.14), beam, bevel=0.012)
    skirting = m.plain("skirting", (0.62, 0.60, 0.55), 0.4)
    box(room, "skirting back", (0, BACK - 0.012, 0.06), (WIDTH, 0.024, 0.12), skirting)
    for side in (-1, 1):
        box(room, f"skirting {side}", (side * (half - 0.012), middle, 0.06), (0.024, depth, 0.12), skirting)


def _window(room: bpy.types.Collection) -> None:
    """Frame, muntins, sill, a rod with two gathered curtains. No glass: it would only add noise."""
    x0, x1, z0, z1 = WINDOW
    white = m.plain("window paint", (0.72, 0.71, 0.67), 0.35)
    cx, cz, y = (x0 + x1) / 2, (z0 + z1) / 2, BACK + 0.05
    for x in (x0 + 0.025, x1 - 0.025):
        box(room, "jamb", (x, y, cz), (0.05, 0.1, z1 - z0), white, bevel=0.006)
    for z in (z0 + 0.025, z1 - 0.025):
        box(room, "head", (cx, y, z), (x1 - x0, 0.1, 0.05), white, bevel=0.006)
    box(room, "mullion", (cx, y, cz), (0.05, 0.06, z1 - z0), white, bevel=0.006)
    for z in (z0 + (z1 - z0) * 0.62,):
        box(room, "muntin", (cx, y, z), (x1 - x0, 0.04, 0.035), white)
    box(room, "sill", (cx, BACK - 0.06, z0 - 0.02), (x1 - x0 + 0.16, 0.24, 0.04), white, bevel=0.01)
    brass = m.plain("brass", (0.75, 0.52, 0.20), 0.25, 1.0)
    rod(room, "curtain rod", (x0 - 0.35, BACK - 0.11, 2.26), (x1 + 0.35, BACK - 0.11, 2.26), 0.014, brass)
    for x in (x0 - 0.36, x1 + 0.36):
        ball(room, "finial", (x, BACK - 0.11, 2.26), 0.028, brass, 2)
    linen = m.curtain("curtain", (0.62, 0.30, 0.16), (0.75, 0.62, 0.40))
    for x_from, x_to in ((x0 - 0.30, x0 + 0.16), (x1 - 0.16, x1 + 0.30)):

        def gathered(u: float, v: float, a: float = x_from, b: float = x_to) -> tuple[float, float, float]:
            waist = 1.0 - 0.18 * math.sin(math.pi * v) * (0.5 + 0.5 * math.sin(3.0 * u))
            depth = 0.035 * math.sin(2.0 * math.pi * 5.5 * u) * (0.45 + 0.55 * (1.0 - v))
            x = (a + b) / 2 + (u - 0.5) * (b - a) * waist
            return x, BACK - 0.11 + depth, 2.25 - v * 1.95 + 0.004 * math.sin(40 * u)

        sheet(room, "curtain", gathered, linen, steps=(66, 24))


def _outside(room: bpy.types.Collection, dice: random.Random) -> None:
    """What the window shows: a garden, trees, a brick house with a roof, hills."""
    grass = m.fabric("grass", (0.05, 0.09, 0.02), (0.13, 0.18, 0.05), 0.6)
    sheet(room, "garden", lambda u, v: (-30 + 60 * u, 2.6 + 50 * v, -1.0 - 1.0 * v), grass, steps=(8, 8))
    hedge = m.fabric("hedge", (0.03, 0.07, 0.02), (0.13, 0.20, 0.05), 3.0)
    trunk = m.plain("trunk", (0.10, 0.06, 0.04), 0.9)
    for index, (x, y, radius) in enumerate(
        (
            (-6.2, 13.0, 1.5),
            (-3.3, 15.5, 1.7),
            (2.6, 14.0, 1.6),
            (4.8, 20.0, 2.3),
            (-10.0, 20.0, 2.6),
            (-0.4, 24.0, 2.0),
        )
    ):
        top = dice.uniform(1.2, 1.9)
        ball(room, f"tree {index}", (x, y, top), radius, hedge, 4, 0.28 * radius, seed=index * 1.7)
        rod(room, f"trunk {index}", (x, y, -1.6), (x, y, top), 0.16, trunk)
    wall, roof = m.bricks("bricks"), m.plaster("roof", (0.22, 0.10, 0.07), 0.5)
    house = (-2.2, 30.0)
    box(room, "house", (house[0] + 3.5, house[1], 0.4), (7.0, 5.0, 4.4), wall)
    for side in (-1, 1):
        box(
            room,
            "roof",
            (house[0] + 3.5, house[1] + side * 1.35, 3.55),
            (7.8, 3.4, 0.18),
            roof,
            rotation=(-side * math.radians(38.0), 0.0, 0.0),
        )
    dark = m.plain("pane", (0.03, 0.04, 0.06), 0.2)
    for x in (0.2, 2.0, 3.8):
        box(room, "pane", (x, house[1] - 2.5, 1.2), (0.8, 0.1, 1.3), dark)
    hill = m.fabric("hill", (0.10, 0.14, 0.12), (0.20, 0.24, 0.20), 0.25)

    def hills(u: float, v: float) -> tuple[float, float, float]:
        x = -70 + 140 * u
        ridge = 4.0 + 1.6 * math.sin(0.11 * x + 0.7) + 0.8 * math.sin(0.31 * x)
        return x, 55 + 10 * v, -3.0 + (ridge + 3.0) * v

    sheet(room, "hills", hills, hill, steps=(60, 4))


def _light(room: bpy.types.Collection, lighting: Lighting) -> None:
    """Sky and low sun through the window, a soft fill (the rest of the flat), two bulbs."""
    x0, x1, z0, z1 = WINDOW
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.portal(((x0 + x1) / 2, BACK + 0.125, (z0 + z1) / 2), (0.0, -1.0, 0.0), (x1 - x0, z1 - z0))
    lighting.sun((0.34, -0.78, -0.62), SUN_IRRADIANCE)  # a patch on the rug and the table
    lighting.area(
        "fill", (-0.2, FRONT + 0.05, 1.75), (0.0, 1.0, -0.15), (2.4, 1.2), FILL_POWER, (0.80, 0.90, 1.0)
    )
    metal = m.plain("socket", (0.05, 0.045, 0.04), 0.3, 1.0)
    for name, (x, y, z), radius, up in (
        ("pendant", (0.72, -0.05, 1.72), 0.045, True),
        ("standing", (0.34, 1.42, 1.38), 0.035, False),
    ):
        lighting.bulb(name, name, (x, y, z), radius, BULB_RADIANCE, BULB_COLOUR)
        sign = 1.0 if up else -1.0
        rod(room, f"socket {name}", (x, y, z + sign * 0.04), (x, y, z + sign * 0.11), 0.022, metal)
        if up:
            rod(room, "cord", (x, y, z + 0.1), (x, y, HEIGHT), 0.008, metal, sides=8)
        else:
            rod(
                room,
                "pole",
                (x, y, 0.02),
                (x, y, z - 0.1),
                0.014,
                m.plain("pole", (0.6, 0.42, 0.18), 0.3, 1.0),
            )
            rod(room, "foot", (x, y, 0.0), (x, y, 0.03), 0.15, metal, sides=24)
