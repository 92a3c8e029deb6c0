# SPDX-License-Identifier: GPL-3.0-or-later
"""The fireplace of ``dog``: piers of field stone, an oak mantel, a sooty box with coals and small flames."""

import itertools
import math
import random

import bpy
from mathutils import Vector

from ..blender import mesh_of
from . import materials as m
from . import materials_hearth as mh
from . import materials_table as mt
from .forms import copies, ring, standing
from .lighting import Lighting
from .props import ball, box, lathe, rod, sheet
from .tubes import bent_tube

Collection = bpy.types.Collection

OPENING, LINTEL, HEARTH = 0.80, 0.80, 0.07  # width and height of the opening, height of the hearth stone
WIDTH, PROUD = 1.50, 0.46  # of the chimney; PROUD: how far it stands before the wall
SHELF = 1.16


def fireplace(
    room: Collection,
    lighting: Lighting,
    dice: random.Random,
    foot: tuple[float, float],
    power: tuple[float, float, float],
) -> None:
    """Build it against the wall; ``foot``: x of its middle, y of the wall; ``power``: radiance of coals and
    of flames, watts of the light that they throw into the room."""
    x, wall = foot
    front = wall - PROUD
    _masonry(room, dice, x, front, wall)
    _box(room, x, front)
    _fire(room, lighting, dice, (x, front + 0.20), power)
    _mantel(room, dice, x, front)
    _tools(room, x - WIDTH / 2 - 0.06, front - 0.16)
    _logs(room, dice, x + WIDTH / 2 + 0.05, wall)


def _masonry(room: Collection, dice: random.Random, x: float, front: float, wall: float) -> None:
    """Stones one by one about the opening, mortar behind, plastered breast above."""
    stone = mh.stone("field stone", (0.15, 0.13, 0.11), (0.40, 0.36, 0.30))
    mortar = m.plaster("mortar", (0.30, 0.27, 0.22), 0.3)
    pier = (WIDTH - OPENING) / 2
    for s in (-1, 1):
        middle = x + s * (OPENING + pier) / 2
        box(
            room,
            "pier",
            (middle, (front + wall) / 2 + 0.02, SHELF / 2),
            (pier - 0.03, PROUD - 0.02, SHELF),
            mortar,
        )
        z = HEARTH
        while z < SHELF - 0.06:
            tall = min(dice.uniform(0.10, 0.17), SHELF - z)
            cut = dice.uniform(0.3, 0.7) * pier
            edges = [-pier / 2, -pier / 2 + cut, pier / 2] if dice.random() < 0.75 else [-pier / 2, pier / 2]
            for a, b in itertools.pairwise(edges):
                _stone(
                    room, dice, stone, (middle + (a + b) / 2, front + 0.05, z + tall / 2), (b - a, 0.12, tall)
                )
            for y in (front + 0.20, front + 0.37):
                outer = (x + s * (WIDTH / 2 - 0.05), y, z + tall / 2)
                _stone(room, dice, stone, outer, (0.10, 0.17, tall))
            z += tall
    box(
        room,
        "lintel core",
        (x, front + 0.12, (LINTEL + SHELF) / 2 + 0.02),
        (OPENING + 0.04, 0.18, SHELF - LINTEL - 0.03),
        mortar,
    )
    count = 7
    for k in range(count):  # a flat arch: voussoirs that lean from the middle
        t = (k + 0.5) / count - 0.5
        size = (OPENING / count + 0.012, 0.13, 0.21)
        _stone(
            room, dice, stone, (x + t * (OPENING + 0.04), front + 0.045, LINTEL + 0.10), size, lean=0.55 * t
        )
    a = -OPENING / 2
    while a < OPENING / 2 - 0.05:
        wide = min(dice.uniform(0.14, 0.26), OPENING / 2 - a)
        _stone(
            room,
            dice,
            stone,
            (x + a + wide / 2, front + 0.055, (LINTEL + 0.21 + SHELF) / 2),
            (wide, 0.12, SHELF - LINTEL - 0.21),
        )
        a += wide
    breast = m.plaster("breast", (0.54, 0.47, 0.36), 0.3)
    box(
        room,
        "breast",
        (x, front + 0.02 + PROUD / 2, (SHELF + 2.45) / 2),
        (WIDTH - 0.16, PROUD, 2.45 - SHELF),
        breast,
    )
    slab = mh.stone("hearth slab", (0.10, 0.095, 0.09), (0.24, 0.225, 0.205))
    for k in range(4):
        wide = (WIDTH + 0.2) / 4
        at = (x - WIDTH / 2 - 0.1 + wide * (k + 0.5), front - 0.02, HEARTH / 2)
        box(
            room,
            "hearth stone",
            at,
            (wide - 0.008, 0.72, HEARTH + dice.uniform(-0.004, 0.004)),
            slab,
            bevel=0.012,
        )


def _stone(
    room: Collection,
    dice: random.Random,
    material: bpy.types.Material,
    at: tuple[float, float, float],
    size: tuple[float, float, float],
    lean: float = 0.0,
) -> None:
    proud = dice.uniform(-0.012, 0.018)
    item = box(
        room, "stone", (at[0], at[1] - proud, at[2]), [s - 0.016 for s in size], material, (0, lean, 0), 0.022
    )
    item.rotation_euler.x, item.rotation_euler.z = dice.uniform(-0.04, 0.04), dice.uniform(-0.05, 0.05)


def _box(room: Collection, x: float, front: float) -> None:
    """The fire box: back, sides that close toward it, roof; soot everywhere."""
    soot = m.plaster("soot", (0.022, 0.019, 0.017), 0.5)
    back = front + PROUD - 0.03
    box(room, "fire back", (x, back, LINTEL / 2 + 0.1), (OPENING, 0.04, LINTEL + 0.3), soot)
    for s in (-1, 1):
        side = (x + s * (OPENING / 2 + 0.0), (front + 0.13 + back) / 2, LINTEL / 2 + 0.1)
        box(room, "fire side", side, (0.04, back - front - 0.10, LINTEL + 0.3), soot, (0, 0, s * 0.12))
    box(
        room,
        "fire roof",
        (x, (front + 0.1 + back) / 2, LINTEL + 0.16),
        (OPENING, back - front - 0.1, 0.04),
        soot,
    )
    box(
        room, "fire floor", (x, (front + back) / 2 + 0.03, HEARTH - 0.01), (OPENING, PROUD - 0.06, 0.03), soot
    )
    iron = m.plain("grate iron", (0.025, 0.023, 0.022), 0.45, 0.7)
    y0, y1, z = front + 0.06, front + 0.36, HEARTH + 0.10
    for k in range(9):
        across = x - 0.28 + 0.07 * k
        rod(room, "grate bar", (across, y0, z), (across, y1, z), 0.010, iron, sides=8)
    for dz in (0.0, 0.06, 0.12):
        rod(room, "grate front", (x - 0.30, y0, z + dz), (x + 0.30, y0, z + dz), 0.009, iron, sides=8)
    for s in (-1, 1):
        dog_iron = [
            (x + s * 0.31, y0 - 0.02, HEARTH),
            (x + s * 0.31, y0 - 0.02, 0.26),
            (x + s * 0.31, y0 - 0.02, 0.38),
        ]
        bent_tube(room, "fire dog", dog_iron, [0.02, 0.012, 0.014], iron)
        ball(
            room,
            "fire dog knob",
            (x + s * 0.31, y0 - 0.02, 0.40),
            0.028,
            mt.metal("fire brass", (0.75, 0.5, 0.18), 0.3, 0.4),
            3,
        )


def _fire(
    room: Collection,
    lighting: Lighting,
    dice: random.Random,
    at: tuple[float, float],
    power: tuple[float, float, float],
) -> None:
    """Coals on the grate, two burnt logs, small flames; a light of their colour shines into the room."""
    x, y = at
    live, glow = mh.coals("live coals", power[0])
    z = HEARTH + 0.13
    lumps = [ball(room, "coal", (0, 0, 0), 0.038, live, 3, 0.007, seed=1.3 * k) for k in range(3)]
    for lump in lumps:
        lump.location = (x + dice.uniform(-0.2, 0.2), y, z)
        lighting.glow("fire", lump, glow)
    for k in range(58):
        spread = 0.27 * (1.0 - k / 90)
        place = standing(
            (x + dice.uniform(-spread, spread), y + dice.uniform(-0.12, 0.13), z + 0.0013 * k), 2.4 * k
        )
        coal = lumps[k % 3].copy()
        coal.matrix_basis = place
        coal.scale = [dice.uniform(0.7, 1.15) for _ in range(3)]
        room.objects.link(coal)
        lighting.glow("fire", coal, glow)
    for dx, dy, turn in ((-0.03, 0.03, 0.18), (0.04, -0.04, -0.22)):
        c, s = math.cos(turn), math.sin(turn)
        a, b = (
            (x + dx - 0.25 * c, y + dy - 0.25 * s, z + 0.10),
            (x + dx + 0.25 * c, y + dy + 0.25 * s, z + 0.13),
        )
        log = rod(room, "burning log", a, b, 0.045, live, 0.04, 16)
        lighting.glow("fire", log, glow)
    tongue, strength = mh.flame("flame", power[1])
    for k in range(7):
        height, wide = dice.uniform(0.14, 0.30), dice.uniform(0.028, 0.05)
        outline = ((0.0, 0.0), (0.7, 0.12), (1.0, 0.3), (0.75, 0.55), (0.3, 0.82), (0.0, 1.0))
        shape = [(wide * r, height * h) for r, h in outline]
        flame = lathe(
            room, "flame", (x - 0.21 + 0.07 * k, y + dice.uniform(-0.06, 0.06), z + 0.07), shape, tongue, 14
        )
        for vertex in mesh_of(flame).vertices:  # licking: bent to and fro, more toward the tip
            rise = vertex.co.z / height
            vertex.co.x += 0.03 * rise * math.sin(4.0 * rise + 2.0 * k)
            vertex.co.y += 0.02 * rise * math.sin(5.0 * rise + 3.0 * k)
        lighting.glow("fire", flame, strength)
    # Neither is sampled as a light, nor met by diffuse rays: the spot is what they give.
    for item in room.objects:
        if item.lightgroup == "fire":
            for ray in ("diffuse", "shadow"):
                setattr(item, f"visible_{ray}", False)
    shine = lighting.spot(
        "fire",
        "fire",
        (x, y + 0.06, z + 0.30),
        (-0.12, -1.0, -0.05),
        power[2],
        (1.0, 0.44, 0.13),
        172.0,
        0.10,
    )
    shine.visible_glossy = False


def _mantel(room: Collection, dice: random.Random, x: float, front: float) -> None:
    """An oak beam; on it a clock, candlesticks, a jug of dried flowers; over it a round mirror."""
    oak = m.wood("mantel oak", (0.09, 0.045, 0.02), (0.25, 0.135, 0.06), "X", 5.0)
    box(room, "mantel", (x, front + 0.05, SHELF + 0.05), (WIDTH + 0.16, 0.34, 0.10), oak, bevel=0.016)
    top, y = SHELF + 0.10, front - 0.01
    brass = mt.metal("mantel brass", (0.76, 0.53, 0.20), 0.22, 0.3)
    silvered = mt.metal("mirror", (0.88, 0.89, 0.88), 0.02)
    dome = [(0.0, 0.045), (0.10, 0.038), (0.19, 0.018), (0.25, -0.01)]
    glass = lathe(room, "convex mirror", (x, front - 0.035, 1.78), dome, silvered, 48)
    glass.rotation_euler = (math.pi / 2, 0, 0)
    for radius, thick in ((0.26, 0.022), (0.30, 0.018)):
        ring(room, "mirror frame", (x, front - 0.03, 1.78), radius, thick, brass, (math.pi / 2, 0, 0), 48)
    bead = ball(room, "mirror bead", (x + 0.28, front - 0.045, 1.78), 0.014, brass, 2)
    for k in range(1, 20):
        a = 2 * math.pi * k / 20
        copies(room, [bead], standing((0.28 * math.cos(a) - 0.28, 0.0, 0.28 * math.sin(a))))
    case = m.wood("clock case", (0.12, 0.045, 0.018), (0.28, 0.12, 0.05), "X")
    box(room, "mantel clock", (x + 0.02, y, top + 0.085), (0.34, 0.11, 0.15), case, bevel=0.02)
    rod(
        room,
        "clock hood",
        (x + 0.02, y - 0.05, top + 0.145),
        (x + 0.02, y + 0.05, top + 0.145),
        0.095,
        case,
        sides=32,
    )
    face = m.plain("clock face", (0.66, 0.62, 0.50), 0.4)
    rod(
        room,
        "clock face",
        (x + 0.02, y - 0.056, top + 0.14),
        (x + 0.02, y - 0.062, top + 0.14),
        0.07,
        face,
        sides=32,
    )
    ring(room, "clock rim", (x + 0.02, y - 0.062, top + 0.14), 0.073, 0.007, brass, (math.pi / 2, 0, 0))
    dark = m.plain("clock hands", (0.02, 0.015, 0.01), 0.5)
    for a, length in ((0.4, 0.035), (2.5, 0.052)):
        tip = (x + 0.02 + length * math.sin(a), y - 0.066, top + 0.14 + length * math.cos(a))
        rod(room, "clock hand", (x + 0.02, y - 0.066, top + 0.14), tip, 0.004, dark, sides=6)
    wax = m.plain("wax", (0.66, 0.58, 0.42), 0.5)
    for dx, tall in ((-0.30, 0.20), (-0.40, 0.14), (0.34, 0.17)):
        stick = [
            (0.045, 0.0),
            (0.04, 0.012),
            (0.012, 0.03),
            (0.018, tall * 0.5),
            (0.01, tall * 0.7),
            (0.03, tall),
            (0.0, tall),
        ]
        lathe(room, "candlestick", (x + dx, y, top), stick, brass, 20)
        rod(room, "candle", (x + dx, y, top + tall), (x + dx, y, top + tall + 0.13), 0.012, wax)
    jug = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.075, 0.06),
        (0.065, 0.13),
        (0.038, 0.17),
        (0.045, 0.20),
        (0.038, 0.20),
        (0.0, 0.16),
    ]
    lathe(
        room,
        "mantel jug",
        (x + 0.56, y, top),
        jug,
        m.speckled("jug glaze", (0.12, 0.20, 0.34), (0.42, 0.46, 0.48), 26.0),
    )
    straw, bloom = (
        m.plain("dried stalk", (0.34, 0.25, 0.10), 0.8),
        m.fabric("dried bloom", (0.30, 0.08, 0.06), (0.62, 0.30, 0.16), 40.0),
    )
    for k in range(11):
        a, lean = 2.4 * k, dice.uniform(0.03, 0.12)
        tip = Vector(
            (x + 0.56 + lean * math.cos(a), y + 0.6 * lean * math.sin(a), top + dice.uniform(0.30, 0.42))
        )
        rod(room, "dried stalk", (x + 0.56, y, top + 0.16), tip, 0.004, straw, sides=6)
        ball(room, "dried bloom", tip, dice.uniform(0.018, 0.028), bloom, 3, 0.004, k)
    copper = mt.metal("copper", (0.72, 0.30, 0.14), 0.28, 0.3)
    plate = lathe(
        room,
        "copper plate",
        (x - 0.58, y + 0.03, top + 0.125),
        [(0.0, 0.012), (0.08, 0.01), (0.12, 0.0), (0.125, 0.006)],
        copper,
    )
    plate.rotation_euler = (math.radians(78.0), 0, 0)


def _tools(room: Collection, x: float, y: float) -> None:
    """Poker, shovel and brush on an iron stand."""
    iron = m.plain("tool iron", (0.03, 0.028, 0.026), 0.4, 0.8)
    brass = mt.metal("tool brass", (0.74, 0.50, 0.18), 0.25, 0.3)
    z = HEARTH
    lathe(room, "tool foot", (x, y, 0.0), [(0.13, 0.0), (0.12, 0.02), (0.02, 0.035), (0.01, 0.06)], iron, 24)
    rod(room, "tool pole", (x, y, 0.03), (x, y, 0.74), 0.009, iron)
    ring(room, "tool loop", (x, y, 0.77), 0.03, 0.007, brass, (math.pi / 2, 0, 0), 20)
    bristle = m.fabric("bristle", (0.05, 0.03, 0.02), (0.16, 0.10, 0.05), 60.0)
    for dx, kind in ((-0.07, "poker"), (0.07, "brush"), (0.0, "shovel")):
        dy = -0.06 if kind == "shovel" else 0.0
        rod(room, kind, (x + dx, y + dy, z + 0.14), (x + dx, y + dy, 0.62), 0.006, iron, sides=8)
        lathe(
            room,
            f"{kind} grip",
            (x + dx, y + dy, 0.60),
            [(0.007, 0.0), (0.013, 0.03), (0.009, 0.07), (0.014, 0.10), (0.0, 0.115)],
            brass,
            12,
        )
        if kind == "brush":
            rod(room, "brush head", (x + dx, y, z + 0.05), (x + dx, y, z + 0.17), 0.034, bristle, 0.02)
        if kind == "shovel":
            sheet(
                room,
                "shovel blade",
                lambda u, v, x=x, y=y: (
                    x + 0.09 * (u - 0.5),
                    y - 0.06 + 0.012 * (2 * u - 1) ** 2,
                    z + 0.02 + 0.14 * v,
                ),
                iron,
                (6, 2),
                0.004,
            )


def _logs(room: Collection, dice: random.Random, x: float, wall: float) -> None:
    """A stack of split wood beside the chimney, sawn ends toward the room."""
    bark, sawn = mh.bark("bark"), mh.sawn("sawn")
    row, z, wide = 0, 0.055, 0.52
    while row < 7:
        across = x + (0.06 if row % 2 else 0.0)
        while across < x + wide:
            radius = dice.uniform(0.042, 0.058)
            y = wall - 0.36 + dice.uniform(-0.03, 0.03)
            a, b = Vector((across + radius, y, z)), Vector((across + radius, wall - 0.03, z))
            rod(room, "log", a, b, radius, bark, sides=14)
            rod(room, "log end", a + Vector((0, -0.003, 0)), a, radius * 0.9, sawn, sides=14)
            across += 2 * radius + 0.004
        z += 0.088
        row += 1
