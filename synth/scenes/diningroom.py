# SPDX-License-Identifier: GPL-3.0-or-later
"""``diningroom``: a table laid for six in the evening, 4.6 × 4.9 × 2.75 m.

Left wall (−X): a French window with low sun that rakes over the cloth. Back wall (+Y): a sideboard under a
mirror, a tall clock. Ambient light is sky, sun and a soft fill behind the camera; the lamps are two groups,
the bare bulbs of the chandelier and the candles.
"""

import math
import random

import bpy

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import diningroom_furniture as furniture
from . import diningroom_table as table
from . import materials as m
from . import materials_table as mt
from .forms import ring
from .lighting import Lighting
from .props import ball, box, lathe, rod, sheet
from .skies import clouded
from .tubes import bent_tube

WEST, EAST, BACK, FRONT, HEIGHT = -2.2, 2.4, 2.1, -2.8, 2.75
WINDOW = (0.0, 1.5, 0.06, 2.2)  # y0, y1, z0, z1 in the west wall
TABLE = (-0.15, 0.5)  # x, y of its middle

BULB_RADIANCE = 420.0
BULB_COLOUR = (1.0, 0.70, 0.40)
FLAME_RADIANCE = 400.0
FLAME_COLOUR = (1.0, 0.56, 0.18)
SKY_RADIANCE = 20.0  # at the horizon; W / m² / sr, any unit does
SUN_IRRADIANCE = 75.0
FILL_POWER = 40.0  # watts

#: Evening: gold at the horizon, violet-blue above, thin clouds lit from below.
SKY = clouded(
    [(0.0, (1.0, 0.66, 0.36)), (0.12, (0.95, 0.76, 0.58)), (0.5, (0.30, 0.42, 0.72))],
    clouds=(1.7, 1.15, 0.78),
    cover=(0.46, 0.66),
    scale=4.0,
    flat=3.4,
    distortion=0.4,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(11)  # the design is fixed; --seed moves noise, not furniture
    _shell(room)
    _window(room)
    _outside(room, dice)
    lighting = Lighting(scene)
    _daylight(lighting)
    furniture.furnish(room, assets, dice, (*TABLE, 0.0))
    table.lay(room, assets, dice, (*TABLE, 0.0))
    _chandelier(room, lighting, (*TABLE, 1.80))
    table.candles(room, lighting, (*TABLE, 0.0), FLAME_RADIANCE, FLAME_COLOUR)
    hints = CameraHints(
        centre=(1.25, -2.05, 1.52),
        target=(-0.12, 0.75, 1.02),
        extent=(1.5, 0.8),
        angle_x=math.radians(60.0),
        orbit_radius=2.75,
        orbit_arc=math.radians(48.0),
        elevation=(math.radians(2.0), math.radians(24.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _shell(room: bpy.types.Collection) -> None:
    """Floor, walls with a hole for the window, ceiling with a cornice, wainscot."""
    wall = 0.12
    width, depth = EAST - WEST, BACK - FRONT
    cx, cy = (EAST + WEST) / 2, (BACK + FRONT) / 2
    box(room, "floor", (cx, cy, -0.05), (width, depth, 0.1), mt.parquet("parquet"))
    paper = mt.damask("damask", (0.055, 0.13, 0.135), (0.27, 0.25, 0.15), 0.21)
    y0, y1, z0, z1 = WINDOW
    x = WEST - wall / 2
    for name, (a, b, low, high) in {
        "front": (FRONT, y0, 0.0, HEIGHT),
        "back": (y1, BACK, 0.0, HEIGHT),
        "below": (y0, y1, 0.0, z0),
        "above": (y0, y1, z1, HEIGHT),
    }.items():
        box(room, f"wall west {name}", (x, (a + b) / 2, (low + high) / 2), (wall, b - a, high - low), paper)
    box(room, "wall back", (cx, BACK + wall / 2, HEIGHT / 2), (width + 2 * wall, wall, HEIGHT), paper)
    warm = m.plaster("ochre plaster", (0.55, 0.40, 0.22))
    box(room, "wall east", (EAST + wall / 2, cy, HEIGHT / 2), (wall, depth, HEIGHT), warm)
    box(room, "wall front", (cx, FRONT - wall / 2, HEIGHT / 2), (width + 2 * wall, wall, HEIGHT), warm)
    white = m.plaster("ceiling", (0.74, 0.72, 0.67), 0.12)
    box(room, "ceiling", (cx, cy, HEIGHT + 0.05), (width + 0.24, depth + 0.24, 0.1), white)
    paint = m.plain("wainscot paint", (0.60, 0.58, 0.51), 0.4)
    rail = 0.86
    for name, at, size in (
        ("back", (cx, BACK - 0.008, rail / 2), (width, 0.016, rail)),
        ("east", (EAST - 0.008, cy, rail / 2), (0.016, depth, rail)),
        ("west back", (WEST + 0.008, (y1 + 0.06 + BACK) / 2, rail / 2), (0.016, BACK - y1 - 0.06, rail)),
        ("west front", (WEST + 0.008, (y0 - 0.06 + FRONT) / 2, rail / 2), (0.016, y0 - 0.06 - FRONT, rail)),
    ):
        box(room, f"wainscot {name}", at, size, paint)
        for label, z, thick, tall in (("skirting", 0.07, 0.02, 0.14), ("dado", rail, 0.026, 0.045)):
            grown = tuple(s + thick if s < 0.05 else s for s in size[:2])
            box(room, f"{label} {name}", (*at[:2], z), (*grown, tall), paint, bevel=0.006)
    for k in range(6):  # raised panels
        x = WEST + 0.42 + 0.76 * k
        box(room, "panel", (x, BACK - 0.02, 0.49), (0.60, 0.016, 0.52), paint, bevel=0.007)
    for name, at, size in (
        ("back", (cx, BACK - 0.05, HEIGHT - 0.05), (width, 0.1, 0.1)),
        ("west", (WEST + 0.05, cy, HEIGHT - 0.05), (0.1, depth, 0.1)),
        ("east", (EAST - 0.05, cy, HEIGHT - 0.05), (0.1, depth, 0.1)),
    ):
        box(room, f"cornice {name}", at, size, white, bevel=0.03)
        lower = (at[0], at[1], at[2] - 0.075)
        box(
            room,
            f"moulding {name}",
            lower,
            tuple(s * 0.45 if s == 0.1 else s for s in size),
            white,
            bevel=0.01,
        )


def _window(room: bpy.types.Collection) -> None:
    """Two glazed doors, the far one ajar, and curtains. No glass: it would only add noise."""
    y0, y1, z0, z1 = WINDOW
    white = m.plain("window paint", (0.70, 0.69, 0.64), 0.35)
    x, cy, cz = WEST - 0.05, (y0 + y1) / 2, (z0 + z1) / 2
    for y in (y0 + 0.03, y1 - 0.03):
        box(room, "jamb", (x, y, cz), (0.12, 0.06, z1 - z0), white, bevel=0.006)
    box(room, "head", (x, cy, z1 - 0.03), (0.12, y1 - y0, 0.06), white, bevel=0.006)
    box(room, "threshold", (x, cy, z0 - 0.02), (0.16, y1 - y0, 0.04), white, bevel=0.006)
    for side in (-1, 1):  # casing
        box(
            room, "casing", (WEST + 0.01, cy + side * ((y1 - y0) / 2 + 0.04), z1 / 2), (0.03, 0.09, z1), white
        )
    box(room, "casing", (WEST + 0.012, cy, z1 + 0.045), (0.034, y1 - y0 + 0.2, 0.1), white, bevel=0.01)
    half = (y1 - y0) / 2 - 0.06
    for start in (y0 + 0.06, cy):
        mid = start + half / 2
        for y in (start + 0.03, start + half - 0.03):
            box(room, "stile", (x, y, cz), (0.045, 0.06, z1 - z0 - 0.06), white, bevel=0.005)
        for z, tall in ((z0 + 0.14, 0.28), (z1 - 0.10, 0.08)):
            box(room, "door rail", (x, mid, z), (0.045, half, tall), white, bevel=0.005)
        for k in range(1, 4):
            z = z0 + 0.28 + (z1 - z0 - 0.42) * k / 4
            box(room, "muntin", (x, mid, z), (0.03, half - 0.08, 0.028), white)
        box(room, "muntin", (x, mid, cz + 0.1), (0.03, 0.028, z1 - z0 - 0.4), white)
    brass = mt.metal("window brass", (0.75, 0.52, 0.20), 0.25)
    bent_tube(
        room,
        "lever",
        [(x + 0.03, cy - 0.03, 1.05), (x + 0.07, cy - 0.03, 1.05), (x + 0.07, cy - 0.13, 1.04)],
        0.01,
        brass,
    )
    rod(room, "curtain rod", (WEST + 0.10, y0 - 0.42, 2.36), (WEST + 0.10, y1 + 0.40, 2.36), 0.015, brass)
    for y in (y0 - 0.43, y1 + 0.41):
        ball(room, "finial", (WEST + 0.10, y, 2.36), 0.032, brass, 2)
    velvet = m.curtain("velvet", (0.34, 0.045, 0.035), (0.42, 0.11, 0.04))
    for y_from, y_to, phase in ((y0 - 0.38, y0 + 0.12, 0.0), (y1 - 0.06, y1 + 0.36, 1.3)):

        def gathered(
            u: float, v: float, a: float = y_from, b: float = y_to, phase: float = phase
        ) -> tuple[float, float, float]:
            waist = 1.0 - 0.52 * math.exp(-(((v - 0.58) / 0.16) ** 2))
            depth = 0.04 * math.sin(2.0 * math.pi * 6.0 * u + phase) * (0.5 + 0.5 * v) * (0.4 + 0.6 * waist)
            outward = a if phase == 0.0 else b  # tied back toward the wall's side
            y = outward + ((a if phase else b) - outward) * waist * (u if phase == 0.0 else 1.0 - u)
            return WEST + 0.10 + depth, y, 2.35 - v * 2.31

        sheet(room, "curtain", gathered, velvet, steps=(72, 36))
        tie = (y_from + 0.12) if phase == 0.0 else (y_to - 0.12)
        ring(room, "curtain tie", (WEST + 0.10, tie, 1.01), 0.115, 0.013, brass, (0.0, 0.0, 0.0), 24)


def _outside(room: bpy.types.Collection, dice: random.Random) -> None:
    """What the window shows: a terrace with a balustrade, a lawn, poplars, hills."""
    stone = m.plaster("terrace stone", (0.42, 0.36, 0.29), 0.3)
    sheet(room, "terrace", lambda u, v: (WEST - 0.14 - 3.2 * u, -4 + 14 * v, -0.06), stone, steps=(4, 4))
    baluster = [(0.03, 0.0), (0.05, 0.06), (0.075, 0.2), (0.05, 0.36), (0.035, 0.46), (0.06, 0.55)]
    x = WEST - 3.2
    box(room, "balustrade", (x, 3.0, 0.56), (0.22, 14.0, 0.10), stone)
    first = lathe(room, "baluster", (x, -2.0, -0.05), baluster, stone, 10)
    for k in range(1, 46):
        post = first.copy()
        post.location.y += 0.24 * k
        room.objects.link(post)
    grass = m.fabric("grass", (0.05, 0.09, 0.02), (0.15, 0.19, 0.05), 0.5)
    sheet(room, "lawn", lambda u, v: (WEST - 3.0 - 60 * u, -20 + 80 * v, -0.8 - 1.2 * u), grass, steps=(8, 8))
    leaves = m.fabric("poplar", (0.03, 0.07, 0.02), (0.14, 0.20, 0.05), 0.9)
    for index in range(9):
        y = -2.0 + 4.1 * index + dice.uniform(-1.0, 1.0)
        tree = ball(
            room, f"tree {index}", (-19.0 - 2.2 * dice.random(), y, 0.8), 1.2, leaves, 4, 0.3, index * 1.7
        )
        tree.scale = (1.0, 1.0, dice.uniform(1.5, 2.2))
    hill = m.fabric("hill", (0.09, 0.13, 0.12), (0.20, 0.22, 0.19), 0.2)

    def hills(u: float, v: float) -> tuple[float, float, float]:
        y = -40 + 160 * u
        return -70 - 10 * v, y, -3.0 + (8.0 + 2.4 * math.sin(0.09 * y + 0.7) + math.sin(0.31 * y)) * v

    sheet(room, "hills", hills, hill, steps=(60, 4))


def _daylight(lighting: Lighting) -> None:
    """Sky and low sun through the window, a soft fill (the rest of the house)."""
    y0, y1, z0, z1 = WINDOW
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.portal((WEST - 0.13, (y0 + y1) / 2, (z0 + z1) / 2), (1.0, 0.0, 0.0), (y1 - y0, z1 - z0))
    lighting.sun((0.86, -0.30, -0.41), SUN_IRRADIANCE, (1.0, 0.70, 0.42), angle=0.6)
    lighting.area(
        "fill", (0.6, FRONT + 0.06, 1.9), (-0.2, 1.0, -0.2), (2.6, 1.2), FILL_POWER, (0.78, 0.88, 1.0)
    )


def _chandelier(room: bpy.types.Collection, lighting: Lighting, at: tuple[float, float, float]) -> None:
    """Brass, three S-shaped arms with candle sleeves and bare bulbs, on a chain."""
    brass = mt.metal("chandelier brass", (0.72, 0.48, 0.17), 0.24, 0.3)
    sleeve = m.plain("sleeve", (0.66, 0.60, 0.46), 0.5)
    x, y, z = at
    hub = [
        (0.0, -0.16), (0.018, -0.15), (0.03, -0.12), (0.02, -0.09), (0.07, -0.04), (0.075, 0.0), (0.03, 0.05),
        (0.022, 0.12), (0.045, 0.17), (0.02, 0.21), (0.014, 0.30), (0.03, 0.33), (0.0, 0.36),
    ]  # fmt: skip
    lathe(room, "chandelier hub", at, hub, brass, 24)
    top = HEIGHT - 0.02
    for k in range(int((top - z - 0.36) / 0.038)):
        turn = math.pi / 2 * (k % 2)
        link = ring(
            room, "chain link", (x, y, z + 0.38 + 0.038 * k), 0.018, 0.005, brass, (math.pi / 2, 0, turn), 12
        )
        link.scale = (0.7, 1.25, 1.0)
    rose = [(0.20, 0.0), (0.17, -0.03), (0.10, -0.035), (0.06, -0.07), (0.0, -0.08)]
    lathe(room, "ceiling rose", (x, y, HEIGHT), rose, m.plain("rose", (0.72, 0.70, 0.65), 0.6), 32)
    cup = [(0.0, -0.02), (0.02, -0.015), (0.045, 0.012), (0.04, 0.014), (0.0, 0.0)]
    for k in range(3):  # each bulb is one more light to sample: five were 2 dB noisier
        a = 2.0 * math.pi * k / 3 + 0.35
        out = (math.cos(a), math.sin(a))
        path = [(0.05, -0.02), (0.14, -0.10), (0.25, -0.09), (0.33, -0.01), (0.33, 0.03)]
        bent_tube(
            room,
            "arm",
            [(x + r * out[0], y + r * out[1], z + h) for r, h in path],
            [0.012, 0.011, 0.01, 0.01, 0.01],
            brass,
        )
        curl = [(0.06, 0.10), (0.13, 0.12), (0.17, 0.06), (0.13, 0.02), (0.11, 0.06)]
        bent_tube(room, "scroll", [(x + r * out[0], y + r * out[1], z + h) for r, h in curl], 0.007, brass, 8)
        tip = (x + 0.33 * out[0], y + 0.33 * out[1], z + 0.04)
        lathe(room, "drip pan", tip, cup, brass, 20)
        rod(room, "sleeve", tip, (tip[0], tip[1], tip[2] + 0.075), 0.013, sleeve)
        bulb = (tip[0], tip[1], tip[2] + 0.109)
        sphere = lighting.bulb("chandelier", f"{k}", bulb, 0.037, BULB_RADIANCE, BULB_COLOUR)
        sphere.scale = (0.92, 0.92, 1.15)
