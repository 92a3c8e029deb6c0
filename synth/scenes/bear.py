# SPDX-License-Identifier: GPL-3.0-or-later
"""``bear``: a teddy bear on the toy bench of a child's room, 3.4 × 3.6 × 2.4 m.

A low sun comes in by a window at the left and lights his fur. Three groups of lamps: the bare bulb of the
night lamp on a low bookcase (``lamp``), one that hangs above the rug (``pendant``), and on a pile of books a
lamp like the moon (``moon``). The bench and the
toy crate are open and dark inside: the deep shadow. A round mirror, a humming top and a bell shine.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import bear_furniture as furniture
from . import bear_toys as toys
from . import materials as m
from . import materials_nursery as mn
from .lighting import Lighting
from .props import ball, box, repeated, rod
from .small_room import MORNING, WALL, Room, casement, garden, shell, side_casement

WEST = (-0.62, 0.26, 0.95, 2.10)  # the window that the sun comes in by
ROOM = Room(half=1.7, back=1.3, front=-2.3, height=2.4, window=(-1.15, -0.30, 0.98, 1.95), west=WEST)
PANELS = 0.84  # height of the boards on the walls

BULB_RADIANCE = 340.0
BULB_COLOUR = (1.0, 0.70, 0.40)
PENDANT = (0.42, 0.12, 1.72)  # above the rug, in the mirror and in the highest views
MOON_RADIANCE = 4.5
MOON_COLOUR = (1.0, 0.86, 0.62)
SKY_RADIANCE = 4.0
SUN_IRRADIANCE = 19.0
SUNS = 4  # in one place: Cycles picks each light as often, and here the sun is most of the noise
FILL_POWER = 5.0  # watts


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(23)  # the design is fixed; --seed moves noise, not furniture
    _walls(room)
    garden(room, ROOM, dice)
    furniture.furnish(room, ROOM, dice)
    toys.scatter(room, assets, dice)
    lighting = Lighting(scene)
    _light(room, lighting)
    hints = CameraHints(
        centre=(0.0, -1.65, 0.98),
        target=(0.08, 0.80, 0.66),
        extent=(1.25, 0.66),
        angle_x=math.radians(46.0),
        orbit_radius=2.4,
        orbit_arc=math.radians(48.0),
        elevation=(math.radians(-4.0), math.radians(24.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _walls(room: bpy.types.Collection) -> None:
    paper = m.wallpaper("nursery paper", (0.42, 0.47, 0.46), (0.36, 0.42, 0.42), (0.62, 0.50, 0.24))
    shell(
        room, ROOM, m.floorboards("floorboards"), paper, paper, m.plaster("ceiling", (0.68, 0.66, 0.62), 0.12)
    )
    paint = m.plain("panel paint", (0.55, 0.55, 0.50), 0.45)
    depth, middle = ROOM.back - ROOM.front, (ROOM.back + ROOM.front) / 2
    pitch = 0.1
    board = box(
        room,
        "panel back",
        (-ROOM.half + 0.05, ROOM.back - 0.008, PANELS / 2),
        (0.097, 0.016, PANELS),
        paint,
        bevel=0.006,
    )
    repeated(board, round(2 * ROOM.half / pitch), (pitch, 0.0, 0.0))
    for side in (-1, 1):
        x = side * (ROOM.half - 0.008)
        board = box(
            room, "panel side", (x, ROOM.front + 0.05, PANELS / 2), (0.016, 0.097, PANELS), paint, bevel=0.006
        )
        repeated(board, round(depth / pitch), (0.0, pitch, 0.0))
        for z, high, out in ((PANELS, 0.04, 0.04), (0.06, 0.12, 0.028)):
            at = (side * (ROOM.half - out / 2), middle, z)
            box(room, "moulding", at, (out, depth, high), paint, bevel=0.008)
    for z, high, out in ((PANELS, 0.04, 0.04), (0.06, 0.12, 0.028)):
        box(room, "moulding", (0, ROOM.back - out / 2, z), (2 * ROOM.half, out, high), paint, bevel=0.008)
    white = m.plain("window paint", (0.68, 0.67, 0.62), 0.35)
    casement(room, ROOM, white)
    side_casement(room, ROOM, white)


def _light(room: bpy.types.Collection, lighting: Lighting) -> None:
    lighting.sky(MORNING, SKY_RADIANCE)
    lighting.portal(ROOM.window_middle, (0.0, -1.0, 0.0), ROOM.window_size)
    y0, y1, z0, z1 = WEST
    at = (-ROOM.half - WALL - 0.005, (y0 + y1) / 2, (z0 + z1) / 2)
    lighting.portal(at, (1.0, 0.0, 0.0), (z1 - z0, y1 - y0))
    for _ in range(SUNS):  # on the bear, from the window at the left
        lighting.sun((0.80, 0.46, -0.40), SUN_IRRADIANCE / SUNS, angle=1.0)
    lighting.area(
        "fill", (-0.2, ROOM.front + 0.05, 1.7), (0.0, 1.0, -0.2), (2.0, 1.0), FILL_POWER, (0.82, 0.91, 1.0)
    )
    lighting.bulb("lamp", "night lamp", furniture.BULB, furniture.BULB_RADIUS, BULB_RADIANCE, BULB_COLOUR)
    x, y, z = PENDANT
    lighting.bulb("pendant", "pendant", PENDANT, 0.036, BULB_RADIANCE, BULB_COLOUR)
    metal = m.plain("pendant socket", (0.74, 0.50, 0.20), 0.25, 1.0)
    rod(room, "pendant socket", (x, y, z + 0.035), (x, y, z + 0.11), 0.022, metal)
    rod(room, "pendant cord", (x, y, z + 0.1), (x, y, ROOM.height), 0.006, metal, sides=8)
    glow, strength = mn.moon("moon", MOON_COLOUR, MOON_RADIANCE)
    globe = ball(room, "moon", toys.MOON, toys.MOON_RADIUS, glow, 4)
    for ray in ("diffuse", "glossy", "transmission", "shadow"):  # there the light within is seen
        setattr(globe, f"visible_{ray}", False)
    lighting.glow("moon", globe, strength)
    lighting.bulb("moon", "in the moon", toys.MOON, 0.97 * toys.MOON_RADIUS, MOON_RADIANCE, MOON_COLOUR)
