# SPDX-License-Identifier: GPL-3.0-or-later
"""``desk``: a desk seen close, sun through a blind, a computer at work and a lamp left on.

The desk stands against the wall y = ``WALL``, a window to the left of its monitor and a pin board to the
right. Ambient is sky and sun; ``screen`` is the monitor's picture, ``lamp`` the bare bulb.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import desk_things as things
from . import materials as m
from . import materials_desk as md
from .lighting import Lighting
from .props import ball, box, repeated, rod, sheet
from .skies import clouded

LEFT, RIGHT, FRONT, WALL, HEIGHT = -1.7, 1.7, -2.4, 0.46, 2.5
WINDOW = (-1.12, -0.20, 1.00, 2.00)  # x0, x1, z0, z1
TILT = math.radians(16.0)  # of the slats, the outer edge up: sun and looks at the sky come between them
TOP = things.TOP

SKY_RADIANCE = 7.0  # at the horizon; W / m² / sr, any unit does
SUN_IRRADIANCE = 26.0

#: Warm and brightest near the horizon, with soft clouds.
SKY = clouded(
    [(0.0, (1.0, 0.88, 0.70)), (0.12, (0.78, 0.87, 0.97)), (0.55, (0.26, 0.46, 0.86))],
    clouds=(1.6, 1.46, 1.28),
    cover=(0.45, 0.66),
    scale=5.0,
    flat=2.4,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(5)  # the design is fixed; --seed moves noise, not furniture
    lighting = Lighting(scene)
    _shell(room)
    _window(room)
    _outside(room, dice)
    _desk(room)
    _things(room, lighting, assets, dice)
    _light(lighting)
    hints = CameraHints(
        centre=(0.05, -1.18, 1.28),
        target=(0.02, 0.12, 1.02),
        extent=(0.66, 0.36),
        angle_x=math.radians(56.0),
        orbit_radius=1.25,
        orbit_arc=math.radians(56.0),
        elevation=(math.radians(6.0), math.radians(34.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _things(room: bpy.types.Collection, lighting: Lighting, assets: Assets, dice: random.Random) -> None:
    things.computer(room, lighting, (0.05, 0.20, TOP))
    things.lamp(room, lighting, (0.58, 0.22, TOP))
    things.papers(room, dice)
    things.pens(room, (-0.29, 0.08, TOP), dice)
    things.books(room, (-0.68, 0.25, TOP), dice)
    things.armillary(room, (0.43, 0.06, TOP))
    things.pin_board(room, (0.64, WALL - 0.012, 1.36), (0.66, 0.56), dice)
    things.wall_clock(room, (0.10, WALL, 1.56))
    things.ivy(room, (0.70, WALL - 0.10, 1.80), dice)
    cup, pot = (0.38, -0.12, TOP), (-0.62, 0.05, TOP)
    assets.place("mug", room, cup, (0.13, 0.13, 0.10), 0.0, lambda: things.mug(room, cup))
    assets.place("pot plant", room, pot, (0.36, 0.36, 0.42), 0.0, lambda: things.plants(room, pot, dice))


def _shell(room: bpy.types.Collection) -> None:
    """Floor, plastered walls with a hole for the window, ceiling, a shelf of books behind the cameras."""
    wall = 0.12
    cx, cy = (LEFT + RIGHT) / 2, (FRONT + WALL) / 2
    wide, deep = RIGHT - LEFT, WALL - FRONT
    box(room, "floor", (cx, cy, -0.05), (wide, deep, 0.1), m.floorboards("floorboards"))
    box(
        room,
        "ceiling",
        (cx, cy, HEIGHT + 0.05),
        (wide, deep, 0.1),
        m.plaster("ceiling", (0.5, 0.48, 0.44), 0.15),
    )
    paint = m.plaster("wall paint", (0.17, 0.25, 0.27), 0.28)
    x0, x1, z0, z1 = WINDOW
    for name, a, b, low, high in (
        ("left", LEFT, x0, 0.0, HEIGHT),
        ("right", x1, RIGHT, 0.0, HEIGHT),
        ("below", x0, x1, 0.0, z0),
        ("above", x0, x1, z1, HEIGHT),
    ):
        box(
            room,
            f"wall {name}",
            ((a + b) / 2, WALL + wall / 2, (low + high) / 2),
            (b - a, wall, high - low),
            paint,
        )
    warm = m.plaster("warm plaster", (0.34, 0.24, 0.17))
    for side, x in (("west", LEFT - wall / 2), ("east", RIGHT + wall / 2)):
        box(room, f"wall {side}", (x, cy, HEIGHT / 2), (wall, deep + 2 * wall, HEIGHT), warm)
    box(room, "wall behind", (cx, FRONT - wall / 2, HEIGHT / 2), (wide, wall, HEIGHT), warm)
    oak = m.wood("shelf oak", (0.12, 0.06, 0.03), (0.28, 0.15, 0.07), "X")
    for z in (0.5, 0.95, 1.4, 1.85):
        box(room, "shelf", (0.2, FRONT + 0.15, z), (1.8, 0.28, 0.03), oak)
        row = m.banded(f"shelf books {z}", [(0.3, 0.06, 0.04), (0.06, 0.12, 0.2), (0.45, 0.38, 0.24)])
        box(room, "shelf books", (0.1, FRONT + 0.13, z + 0.14), (1.3, 0.2, 0.24), row)


def _window(room: bpy.types.Collection) -> None:
    """Frame, sill and a wooden blind: one slat repeated, its tapes, cord and rails. No glass: only noise."""
    x0, x1, z0, z1 = WINDOW
    white = m.plain("window paint", (0.66, 0.64, 0.58), 0.35)
    cx, cz, y = (x0 + x1) / 2, (z0 + z1) / 2, WALL + 0.08
    for x in (x0 + 0.025, x1 - 0.025):
        box(room, "jamb", (x, y, cz), (0.05, 0.08, z1 - z0), white, bevel=0.005)
    for z in (z0 + 0.025, z1 - 0.025):
        box(room, "head", (cx, y, z), (x1 - x0, 0.08, 0.05), white, bevel=0.005)
    box(room, "mullion", (cx, y, cz), (0.04, 0.05, z1 - z0), white, bevel=0.004)
    box(room, "sill", (cx, WALL - 0.03, z0 - 0.018), (x1 - x0 + 0.10, 0.20, 0.036), white, bevel=0.008)
    cane = m.wood("slats", (0.34, 0.20, 0.09), (0.56, 0.38, 0.20), "X", 9.0)
    front = WALL + 0.005
    step, wide = 0.092, x1 - x0 - 0.02
    box(room, "blind rail", (cx, front, z1 - 0.02), (wide, 0.06, 0.045), cane, bevel=0.006)
    slat = box(room, "slat", (cx, front, z1 - 0.085), (wide, 0.080, 0.004), cane, (TILT, 0.0, 0.0))
    drop = repeated(slat, 9, (0.0, -step * math.sin(TILT), -step * math.cos(TILT)))
    drop.name = "slats"
    tape = m.plain("tape", (0.50, 0.42, 0.30), 0.9)
    for x in (x0 + 0.16, x1 - 0.16):
        box(room, "tape", (x, front - 0.034, cz), (0.022, 0.001, z1 - z0 - 0.06), tape)
    rod(
        room,
        "blind cord",
        (x1 - 0.06, front - 0.045, z1 - 0.04),
        (x1 - 0.06, front - 0.045, 1.22),
        0.002,
        tape,
        sides=6,
    )
    ball(room, "blind cord end", (x1 - 0.06, front - 0.045, 1.21), 0.012, cane, 2)


def _outside(room: bpy.types.Collection, dice: random.Random) -> None:
    """Roofs of a town and trees, seen between the slats."""
    tile = m.bricks("town bricks")
    roof = m.plaster("town roof", (0.24, 0.11, 0.08), 0.5)
    pale = m.plaster("town plaster", (0.55, 0.47, 0.36), 0.2)
    for k in range(7):
        x, y, high = -26.0 + 5.5 * k, dice.uniform(22.0, 34.0), dice.uniform(3.0, 6.0)
        box(room, f"house {k}", (x, y, -8.0 + high), (4.6, 4.0, 2 * high), pale if k % 2 else tile)
        for side in (-1, 1):
            lean = (-side * math.radians(36.0), 0.0, 0.0)
            box(room, "roof", (x, y + side * 1.1, -7.1 + 2 * high), (5.0, 3.0, 0.2), roof, lean)
    crown = m.fabric("crown", (0.03, 0.07, 0.02), (0.15, 0.22, 0.06), 2.0)
    for k, (x, y, z) in enumerate(((-5.5, 9.0, -0.6), (-2.0, 11.0, -1.0), (-9.0, 12.0, -0.2))):
        ball(room, f"tree {k}", (x, y, z), 1.7, crown, 4, 0.4, seed=1.1 * k)
    grass = m.fabric("town ground", (0.06, 0.08, 0.03), (0.16, 0.17, 0.08), 0.3)
    sheet(room, "ground", lambda u, v: (-80 + 160 * u, 3.0 + 120 * v, -8.0), grass, steps=(8, 8))


def _desk(room: bpy.types.Collection) -> None:
    """An oak top on a drawer chest and two legs, a leather pad on it."""
    oak = m.wood("desk oak", (0.15, 0.07, 0.032), (0.31, 0.16, 0.072), "X", 4.0, 0.34)
    x0, x1, y0, y1 = -0.98, 1.02, -0.42, 0.42
    box(
        room,
        "desk top",
        ((x0 + x1) / 2, (y0 + y1) / 2, TOP - 0.018),
        (x1 - x0, y1 - y0, 0.036),
        oak,
        bevel=0.006,
    )
    box(room, "desk apron", ((x0 + x1) / 2, y0 + 0.05, TOP - 0.085), (x1 - x0 - 0.1, 0.02, 0.10), oak)
    for k in range(3):
        z = 0.57 - 0.20 * k
        box(room, "drawer", (0.74, y0 + 0.04, z), (0.42, 0.03, 0.18), oak, bevel=0.006)
        brass = m.plain(f"drawer pull {k}", (0.75, 0.52, 0.2), 0.25, 1.0)
        rod(room, "drawer pull", (0.68, y0 + 0.008, z), (0.80, y0 + 0.008, z), 0.008, brass)
    box(room, "chest", (0.74, 0.02, 0.36), (0.44, 0.74, 0.68), oak)
    for y in (y0 + 0.06, y1 - 0.06):
        box(room, "desk leg", (x0 + 0.07, y, TOP / 2 - 0.02), (0.06, 0.06, TOP - 0.04), oak, bevel=0.005)
    box(
        room,
        "desk pad",
        (0.06, -0.15, TOP + 0.002),
        (0.74, 0.40, 0.004),
        md.leather("pad leather", (0.018, 0.055, 0.04)),
    )


def _light(lighting: Lighting) -> None:
    """Sky and sun through the blind. Few lights, so that each has many samples."""
    x0, x1, z0, z1 = WINDOW
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.portal(((x0 + x1) / 2, WALL + 0.125, (z0 + z1) / 2), (0.0, -1.0, 0.0), (x1 - x0, z1 - z0))
    lighting.sun((0.44, -0.62, -0.62), SUN_IRRADIANCE, angle=0.5)
