# SPDX-License-Identifier: GPL-3.0-or-later
"""``bathroom``: an old tiled bathroom in the morning, 3.9 × 4.2 × 2.5 m.

Back wall (+Y): a washstand under a mirror between four bare bulbs, to the right a window above a
free-standing bathtub; the sun falls past the tub on the patterned floor. Candles burn on the bath tray. The
washstand is open below: the deep shadow. Three groups: ambient, the bulbs ``vanity`` and ``candles``.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import bathroom_fittings as fittings
from . import materials as m
from . import materials_bathroom as mb
from .lighting import Lighting
from .props import box
from .small_room import MORNING, Room, casement, garden, shell

ROOM = Room(half=1.95, back=1.6, front=-2.6, height=2.5, window=(0.55, 1.45, 1.22, 2.18))
DADO = 1.2  # height of the tiles

BULB_RADIANCE = 230.0
BULB_COLOUR = (1.0, 0.74, 0.46)
FLAME_RADIANCE = 400.0
FLAME_COLOUR = (1.0, 0.55, 0.20)
SKY_RADIANCE = 12.5
SUN_IRRADIANCE = 45.0
FILL_POWER = 14.0  # watts


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(11)  # the design is fixed; --seed moves noise, not furniture
    _walls(room)
    garden(room, ROOM, dice)
    fittings.furnish(room, ROOM, assets, dice)
    lighting = Lighting(scene)
    _light(lighting)
    hints = CameraHints(
        centre=(0.0, -2.05, 1.36),
        target=(0.08, 0.9, 1.02),
        extent=(1.5, 0.8),
        angle_x=math.radians(57.0),
        orbit_radius=2.9,
        orbit_arc=math.radians(48.0),
        elevation=(math.radians(-2.0), math.radians(20.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _walls(room: bpy.types.Collection) -> None:
    green, cream = (0.03, 0.11, 0.09), ((0.62, 0.61, 0.54), (0.50, 0.51, 0.46))
    tiles = mb.tiled_wall("tiled wall", cream, green, (0.46, 0.25, 0.19), DADO)
    floor = mb.patterned_floor("cement tiles", (0.55, 0.52, 0.45), (0.10, 0.13, 0.15), (0.40, 0.14, 0.07))
    shell(room, ROOM, floor, tiles, tiles, m.plaster("ceiling", (0.68, 0.66, 0.62), 0.15))
    middle, depth = (ROOM.back + ROOM.front) / 2, ROOM.back - ROOM.front
    trim = m.plain("trim tile", green, 0.15)
    skirting = m.plain("skirting tile", (0.05, 0.07, 0.07), 0.2)
    for name, z, high, out, material in (
        ("ledge", DADO, 0.035, 0.035, trim),
        ("skirting", 0.06, 0.12, 0.02, skirting),
    ):
        box(room, name, (0, ROOM.back - out / 2, z), (2 * ROOM.half, out, high), material, bevel=0.008)
        for side in (-1, 1):
            x = side * (ROOM.half - out / 2)
            box(room, name, (x, middle, z), (out, depth, high), material, bevel=0.008)
    casement(room, ROOM, m.plain("window paint", (0.66, 0.65, 0.60), 0.35))
    beam = m.wood("beam", (0.10, 0.055, 0.03), (0.22, 0.13, 0.07), "X")
    for y in (-1.3, 0.1, 1.48):
        box(room, "beam", (0, y, ROOM.height - 0.06), (2 * ROOM.half, 0.11, 0.12), beam, bevel=0.01)


def _light(lighting: Lighting) -> None:
    lighting.sky(MORNING, SKY_RADIANCE)
    lighting.portal(ROOM.window_middle, (0.0, -1.0, 0.0), ROOM.window_size)
    lighting.sun((-0.42, -0.55, -0.70), SUN_IRRADIANCE, angle=1.0)  # over the tub on the floor
    lighting.area(
        "fill", (0.2, ROOM.front + 0.05, 1.8), (0.0, 1.0, -0.2), (2.2, 1.1), FILL_POWER, (0.82, 0.91, 1.0)
    )
    for index, at in enumerate(fittings.BULBS):
        lighting.bulb("vanity", f"vanity {index}", at, fittings.BULB_RADIUS, BULB_RADIANCE, BULB_COLOUR)
    for index, at in enumerate(fittings.FLAMES):
        flame = lighting.bulb("candles", f"candle {index}", at, 0.013, FLAME_RADIANCE, FLAME_COLOUR)
        flame.scale = (0.75, 0.75, 1.9)
