# SPDX-License-Identifier: GPL-3.0-or-later
"""``chair``: an armchair by the fire in the corner of a panelled room, afternoon sun from the left.

Cameras look at the corner of the left wall (−X, the window) and the back wall (+Y, the fireplace with a round
mirror over it). Ambient is sky and sun; ``lamp`` is the bare bulb behind the chair, ``fire`` the fire
with the candle of its mantelpiece.
"""

import math
import random

import bpy
from mathutils import Vector

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import chair_things as things
from . import materials as m
from . import materials_fireside as hearth
from .armchair import SIZE, armchair
from .fireside import BREAST, fireplace
from .lighting import Lighting
from .props import ball, box, rod, sheet
from .skies import clouded

LEFT, RIGHT, FRONT, BACK, HEIGHT = -1.9, 2.4, -2.8, 1.6, 2.55
WINDOW = (-1.25, 0.62, 0.86, 2.12)  # y0, y1, z0, z1
SECOND = (-2.62, -1.72, 0.86, 2.12)  # beside the cameras, for the sun on the rug

SKY_RADIANCE = 4.5  # at the horizon; W / m² / sr, any unit does
SUN_IRRADIANCE = 24.0

#: Soft clouds, warm and brightest near the horizon.
SKY = clouded(
    [(0.0, (1.0, 0.88, 0.70)), (0.12, (0.80, 0.88, 0.97)), (0.55, (0.26, 0.46, 0.86))],
    clouds=(1.6, 1.46, 1.28),
    cover=(0.45, 0.66),
    scale=5.0,
    flat=2.4,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(11)  # the design is fixed; --seed moves noise, not furniture
    lighting = Lighting(scene)
    paper = hearth.damask("damask", (0.035, 0.072, 0.078), (0.10, 0.135, 0.10), (0.15, 0.165, 0.10))
    _shell(room, paper)
    _window(room)
    _outside(room)
    fireplace(room, lighting, paper, BACK, HEIGHT)
    _furnish(room, lighting, assets, dice)
    _light(lighting)
    hints = CameraHints(
        centre=(1.3, -1.7, 1.25),
        target=(-0.50, 0.5, 0.82),
        extent=(1.4, 0.8),
        angle_x=math.radians(55.0),
        orbit_radius=2.6,
        orbit_arc=math.radians(48.0),
        elevation=(math.radians(0.0), math.radians(22.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _furnish(room: bpy.types.Collection, lighting: Lighting, assets: Assets, dice: random.Random) -> None:
    box(room, "rug", (-0.40, 0.0, 0.008), (2.1, 1.5, 0.016), m.rug("rug"), (0.0, 0.0, 0.22))
    foot, turn = (-0.92, 0.40, 0.016), math.radians(26.0)
    assets.place("armchair", room, foot, SIZE, turn, lambda: armchair(room, foot, turn))
    corner = (-1.50, 1.20, 0.0)
    assets.place("plant", room, corner, (0.9, 0.9, 1.7), 0.0, lambda: things.plant(room, corner, dice))
    things.standing_lamp(room, lighting, (-0.66, 1.12, 0.0))
    table = (-0.24, 0.70, 0.0)
    assets.place(
        "side table", room, table, (0.53, 0.53, 0.56), 0.0, lambda: things.side_table(room, table), fill=True
    )
    things.pouf(room, (-1.12, -0.42, 0.016))
    things.log_basket(room, (0.82, 0.98, 0.0), dice)


def _shell(room: bpy.types.Collection, paper: bpy.types.Material) -> None:
    """Floor, papered walls above painted panels, a hole for the window, ceiling, cornice, a door behind."""
    wall = 0.14
    cx, cy = (LEFT + RIGHT) / 2, (FRONT + BACK) / 2
    wide, deep = RIGHT - LEFT, BACK - FRONT
    box(room, "floor", (cx, cy, -0.05), (wide, deep, 0.1), m.floorboards("floorboards"))
    box(
        room,
        "ceiling",
        (cx, cy, HEIGHT + 0.05),
        (wide, deep, 0.1),
        m.plaster("ceiling", (0.55, 0.51, 0.44), 0.15),
    )
    box(room, "wall back", (cx, BACK + wall / 2, HEIGHT / 2), (wide + 2 * wall, wall, HEIGHT), paper)
    box(room, "wall front", (cx, FRONT - wall / 2, HEIGHT / 2), (wide + 2 * wall, wall, HEIGHT), paper)
    plaster = m.plaster("warm plaster", (0.42, 0.30, 0.20))
    box(room, "wall right", (RIGHT + wall / 2, cy, HEIGHT / 2), (wall, deep, HEIGHT), plaster)
    y0, y1, z0, z1 = WINDOW
    first, last = SECOND[:2]
    left = m.plaster("green plaster", (0.085, 0.13, 0.115))
    for name, a, b, low, high in (
        ("before", FRONT, first, z0, z1),
        ("between", last, y0, z0, z1),
        ("after", y1, BACK, z0, z1),
        ("below", FRONT, BACK, 0.0, z0),
        ("above", FRONT, BACK, z1, HEIGHT),
    ):
        centre = (LEFT - wall / 2, (a + b) / 2, (low + high) / 2)
        box(room, f"wall left {name}", centre, (wall, b - a, high - low), left)
    paint = m.plain("panel paint", (0.10, 0.155, 0.145), 0.4)
    for start, end, inward in (
        ((LEFT, FRONT, 0), (LEFT, BACK, 0), (1, 0, 0)),
        ((LEFT, BACK, 0), (BREAST[0], BACK, 0), (0, -1, 0)),
        ((BREAST[1], BACK, 0), (RIGHT, BACK, 0), (0, -1, 0)),
    ):
        things.panelling(room, Vector(start), Vector(end), Vector(inward), paint)
    white = m.plain("cornice", (0.60, 0.56, 0.48), 0.6)
    for y in (BACK, FRONT):
        box(room, "cornice", (cx, y, HEIGHT), (wide, 0.16, 0.12), white, (0, 0, 0), 0.03)
    for x in (LEFT, RIGHT):
        box(room, "cornice", (x, cy, HEIGHT), (0.16, deep, 0.12), white, (0, 0, 0), 0.03)
    _behind(room)


def _behind(room: bpy.types.Collection) -> None:
    """What the mirror shows: a door and a painting on the wall behind the cameras."""
    oak = m.wood("door oak", (0.14, 0.07, 0.03), (0.34, 0.19, 0.09), "Z")
    box(room, "door", (-1.25, FRONT + 0.025, 1.02), (0.86, 0.05, 2.04), oak, bevel=0.006)
    for z, tall in ((0.55, 0.75), (1.45, 0.85)):
        for x in (-1.45, -1.05):
            box(room, "door field", (x, FRONT + 0.055, z), (0.28, 0.02, tall), oak, bevel=0.01)
    ball(
        room, "door knob", (-0.90, FRONT + 0.09, 1.0), 0.032, m.plain("knob", (0.75, 0.52, 0.2), 0.25, 1.0), 3
    )
    box(room, "canvas", (0.1, FRONT + 0.02, 1.6), (1.0, 0.03, 0.7), m.painting("canvas", "landscape"))


def _window(room: bpy.types.Collection) -> None:
    """Frames with muntins and deep sills. No glass: it would only add noise."""
    for opening in (WINDOW, SECOND):
        _frame(room, opening)
    things.curtains(room, LEFT, WINDOW)


def _frame(room: bpy.types.Collection, opening: tuple[float, float, float, float]) -> None:
    y0, y1, z0, z1 = opening
    white = m.plain("window paint", (0.66, 0.64, 0.58), 0.35)
    x, cy, cz = LEFT - 0.07, (y0 + y1) / 2, (z0 + z1) / 2
    for y in (y0 + 0.025, y1 - 0.025):
        box(room, "jamb", (x, y, cz), (0.1, 0.05, z1 - z0), white, bevel=0.006)
    for z in (z0 + 0.025, z1 - 0.025):
        box(room, "head", (x, cy, z), (0.1, y1 - y0, 0.05), white, bevel=0.006)
    panes = round((y1 - y0) / 0.46)
    for y in (y0 + (y1 - y0) * k / panes for k in range(1, panes)):
        box(room, "mullion", (x, y, cz), (0.04, 0.04, z1 - z0), white, bevel=0.004)
    for z in (z0 + (z1 - z0) * 0.36, z0 + (z1 - z0) * 0.70):
        box(room, "muntin", (x, cy, z), (0.035, y1 - y0, 0.03), white)
    box(room, "sill", (LEFT + 0.03, cy, z0 - 0.02), (0.24, y1 - y0 + 0.1, 0.045), white, bevel=0.012)


def _outside(room: bpy.types.Collection) -> None:
    """A garden: lawn, a hedge, trees, hills."""
    grass = m.fabric("grass", (0.05, 0.09, 0.02), (0.13, 0.18, 0.05), 0.6)
    sheet(room, "garden", lambda u, v: (-2.6 - 55 * u, -30 + 75 * v, -0.8 - 1.2 * u), grass, steps=(8, 8))
    crown = m.fabric("crown", (0.03, 0.07, 0.02), (0.14, 0.20, 0.05), 2.5)
    trunk = m.plain("trunk", (0.10, 0.06, 0.04), 0.9)
    for index, (x, y, z, radius) in enumerate(
        (
            (-9.5, 5.6, 1.0, 1.5),
            (-12.0, 8.8, 1.6, 1.9),
            (-15.0, 6.0, 1.3, 2.2),
            (-13.0, 12.5, 1.8, 2.3),
            (-19.0, 11.0, 1.5, 2.6),
        )
    ):
        ball(room, f"tree {index}", (x, y, z), radius, crown, 4, 0.26 * radius, seed=1.3 * index)
        rod(room, f"trunk {index}", (x, y, -1.8), (x, y, z), 0.16, trunk)
    hill = m.fabric("hill", (0.10, 0.14, 0.12), (0.20, 0.24, 0.20), 0.25)
    sheet(
        room, "hills",
        lambda u, v: (-55 - 8 * v, -30 + 110 * u, v * (6.5 + 1.6 * math.sin(9 * u) + math.sin(31 * u)) - 3),
        hill, steps=(60, 4),
    )  # fmt: skip


def _light(lighting: Lighting) -> None:
    """Sky and sun through the windows. Few lights, so that each has many samples."""
    lighting.sky(SKY, SKY_RADIANCE)
    y0, y1, z0, z1 = SECOND[0], *WINDOW[1:]  # one portal over both: little of it is wall
    lighting.portal((LEFT - 0.145, (y0 + y1) / 2, (z0 + z1) / 2), (1.0, 0.0, 0.0), (y1 - y0, z1 - z0))
    lighting.sun((0.50, 0.60, -0.50), SUN_IRRADIANCE, angle=0.6)
