# SPDX-License-Identifier: GPL-3.0-or-later
"""The furniture of ``bear``: toy bench, bookcase with the night lamp, crate, rug, curtains, pictures."""

import itertools
import math
import random

import bpy
from mathutils import Matrix, Vector

from ..blender import Point
from . import materials as m
from . import materials_bathroom as mb
from . import materials_nursery as mn
from . import plush
from .curved import leaf_tuft, torus
from .props import ball, box, cushion, lathe, rod, sheet
from .shading import dimmed
from .small_room import Room
from .tubes import bent_tube

Collection = bpy.types.Collection

BENCH = (-0.55, 0.68, 0.74, 1.16)  # x0, x1, y0, y1
SEAT = 0.40  # height of its top
CASE = (0.86, 1.62, 0.98, 1.26)
CASE_TOP = 0.98
BULB = (1.00, 1.10, CASE_TOP + 0.30)
BULB_RADIUS = 0.042

#: Scene-linear colours of toys and books.
PAINTS = [
    (0.55, 0.06, 0.04),
    (0.65, 0.38, 0.03),
    (0.04, 0.22, 0.34),
    (0.08, 0.30, 0.12),
    (0.58, 0.22, 0.22),
    (0.30, 0.12, 0.32),
]


def furnish(room: Collection, at: Room, dice: random.Random) -> None:
    """Put everything in its place (metres, the room's own axes)."""
    _bench(room, dice)
    _bookcase(room, dice)
    _on_bookcase(room, dice)
    _crate(room, dice)
    _rug(room)
    _curtains(room, at)
    _hangings(room, at)
    _wardrobe(room, at)


def _bench(room: Collection, dice: random.Random) -> None:
    """A low bench of three open bays; baskets, a box and picture books in them, a quilted pad on top."""
    birch = m.wood("bench birch", (0.34, 0.20, 0.10), (0.56, 0.38, 0.21), "X")
    upright = m.wood("bench upright", (0.34, 0.20, 0.10), (0.56, 0.38, 0.21), "Z")
    dark = m.plain("bench back", (0.05, 0.035, 0.025), 0.8)
    x0, x1, y0, y1 = BENCH
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    for z in (0.06, SEAT - 0.014):
        box(room, "bench board", (cx, cy, z), (x1 - x0, y1 - y0, 0.028), birch, bevel=0.006)
    bays = [x0 + 0.014 + (x1 - x0 - 0.028) * k / 3 for k in range(4)]
    for x in bays:
        box(room, "bench upright", (x, cy, 0.215), (0.026, y1 - y0 - 0.01, 0.33), upright, bevel=0.004)
    box(room, "bench plinth", (cx, cy + 0.02, 0.024), (x1 - x0 - 0.04, y1 - y0 - 0.08, 0.048), dark)
    box(room, "bench back", (cx, y1 - 0.012, 0.22), (x1 - x0 - 0.03, 0.01, 0.32), dark)
    wicker = m.cloth("wicker", (0.36, 0.22, 0.09), (0.17, 0.09, 0.035), 9.0)
    box(room, "basket", ((bays[0] + bays[1]) / 2, cy - 0.03, 0.165), (0.31, 0.30, 0.18), wicker, bevel=0.02)
    for k in range(4):
        yarn = ball(
            room,
            "yarn",
            (bays[0] + 0.09 + 0.075 * k, cy - 0.08 + 0.05 * (k % 2), 0.27),
            0.045,
            m.fabric(f"yarn {k}", dimmed(PAINTS[k], 0.5), PAINTS[k], 30.0),
            3,
        )
        yarn.rotation_euler = (k, 2 * k, 0)
    x = bays[1] + 0.035
    while x < bays[2] - 0.06:
        thick, tall = dice.uniform(0.014, 0.034), dice.uniform(0.19, 0.26)
        cover = m.plain(f"picture book {x:.2f}", dice.choice(PAINTS), 0.45)
        box(room, "picture book", (x + thick / 2, cy - 0.05, 0.075 + tall / 2), (thick, 0.22, tall), cover)
        x += thick + 0.003
    tin = m.plain("tin", (0.60, 0.50, 0.32), 0.28, 1.0)
    foot = ((bays[2] + bays[3]) / 2 - 0.06, cy - 0.06, 0.074)
    rod(room, "tin", foot, (foot[0], foot[1], 0.22), 0.075, tin, sides=28)
    rod(room, "tin lid", (foot[0], foot[1], 0.22), (foot[0], foot[1], 0.235), 0.079, tin, sides=28)
    small = m.plain("skittle", (0.60, 0.40, 0.18), 0.35)
    for k in range(3):
        at = (bays[3] - 0.06 - 0.02 * k, cy - 0.12 + 0.09 * k, 0.074)
        skittle = [(0.0, 0.0), (0.022, 0.0), (0.03, 0.05), (0.016, 0.11), (0.02, 0.14), (0.0, 0.165)]
        lathe(room, "skittle", at, skittle, small, 16)
    pad = mn.dotted("bench pad", (0.05, 0.14, 0.20), (0.55, 0.50, 0.38), 20.0)
    for k in range(3):
        w = (x1 - x0 - 0.02) / 3
        cushion(
            room,
            "bench pad",
            (x0 + 0.01 + w * (k + 0.5), cy - 0.01, SEAT + 0.022),
            (w, y1 - y0 - 0.03, 0.05),
            pad,
            plump=0.35,
        )


def _bookcase(room: Collection, dice: random.Random) -> None:
    """White, three shelves: books upright and leaning, boxes; dark behind them."""
    white = m.plain("case paint", (0.60, 0.58, 0.52), 0.4)
    inner = m.plain("case back", (0.10, 0.16, 0.17), 0.7)
    x0, x1, y0, y1 = CASE
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    levels = (0.05, 0.36, 0.67, CASE_TOP - 0.014)
    for z in levels:
        box(room, "case board", (cx, cy, z), (x1 - x0, y1 - y0, 0.028), white, bevel=0.005)
    for x in (x0 + 0.013, x1 - 0.013):
        box(room, "case side", (x, cy, CASE_TOP / 2), (0.026, y1 - y0, CASE_TOP), white, bevel=0.005)
    box(room, "case back", (cx, y1 - 0.01, CASE_TOP / 2), (x1 - x0 - 0.02, 0.012, CASE_TOP - 0.03), inner)
    covers = []
    for k in range(9):
        red, green, blue = (dice.uniform(0.6, 1.1) * channel for channel in PAINTS[k % 6])
        covers.append(m.plain(f"case book {k}", (red, green, blue), 0.5))
    label = m.plain("case label", (0.60, 0.54, 0.36), 0.6)
    for shelf, z in enumerate(levels[:-1]):
        x, stop = x0 + 0.035, x1 - (0.06 if shelf == 1 else 0.26)
        while x < stop:
            thick, tall = dice.uniform(0.016, 0.042), dice.uniform(0.17, 0.25)
            at = (x + thick / 2, cy - 0.03, z + 0.014 + tall / 2)
            box(room, "book", at, (thick, 0.17, tall), dice.choice(covers), (0, dice.uniform(-0.03, 0.05), 0))
            if dice.random() < 0.5:
                box(room, "label", (at[0], cy - 0.117, at[2] + 0.2 * tall), (0.8 * thick, 0.005, 0.03), label)
            x += thick + 0.003
    crate = m.wood("small crate", (0.30, 0.16, 0.07), (0.50, 0.32, 0.16), "X")
    box(room, "case box", (x1 - 0.135, cy - 0.02, 0.67 + 0.07), (0.19, 0.19, 0.11), crate, bevel=0.008)
    globe = m.painting("globe map", "abstract")
    rod(room, "globe foot", (x1 - 0.14, cy - 0.02, 0.064), (x1 - 0.14, cy - 0.02, 0.10), 0.05, crate, 0.02)
    ball(room, "globe", (x1 - 0.14, cy - 0.02, 0.185), 0.085, globe, 4)


def _on_bookcase(room: Collection, dice: random.Random) -> None:
    """The night lamp's stand, a plant, a bell, a snow globe."""
    x, y, z = BULB
    turned = m.wood("lamp wood", (0.28, 0.14, 0.06), (0.50, 0.30, 0.14), "Z")
    brass = m.plain("brass", (0.74, 0.50, 0.20), 0.2, 1.0)
    base = [
        (0.0, 0.0),
        (0.075, 0.0),
        (0.078, 0.015),
        (0.05, 0.03),
        (0.022, 0.06),
        (0.032, 0.10),
        (0.022, 0.15),
        (0.028, 0.20),
    ]
    base += [(0.018, 0.22), (0.0, 0.22)]
    lathe(room, "lamp foot", (x, y, CASE_TOP), base, turned)
    rod(room, "lamp socket", (x, y, CASE_TOP + 0.215), (x, y, z - 0.03), 0.024, brass)
    wire = m.plain("lamp wire", (0.05, 0.05, 0.05), 0.4)
    for k in range(4):  # a cage about the bulb
        c, s = math.cos(0.4 + k * math.pi / 2), math.sin(0.4 + k * math.pi / 2)
        bow = [(0.026, -0.03), (0.07, -0.01), (0.075, 0.04), (0.03, 0.075), (0.0, 0.08)]
        bent_tube(room, "lamp cage", [(x + r * c, y + r * s, z + h) for r, h in bow], 0.0035, wire)
    pot = [(0.0, 0.0), (0.055, 0.0), (0.075, 0.10), (0.078, 0.12), (0.068, 0.12), (0.064, 0.10), (0.0, 0.10)]
    foot = Vector((1.45, 1.11, CASE_TOP))
    lathe(room, "pot", foot, pot, m.speckled("pot glaze", (0.55, 0.50, 0.40), (0.10, 0.22, 0.26), 26.0, 0.3))
    leaf_tuft(room, foot + Vector((0, 0, 0.10)), 26, (0.18, 0.30), 0.045, 1.2, dice)
    bell = [(0.0, 0.075), (0.02, 0.072), (0.03, 0.05), (0.035, 0.02), (0.05, 0.0), (0.046, 0.0), (0.0, 0.06)]
    lathe(room, "bell", (1.17, 1.05, CASE_TOP), bell, brass)
    rod(
        room,
        "bell handle",
        (1.17, 1.05, CASE_TOP + 0.07),
        (1.17, 1.05, CASE_TOP + 0.13),
        0.008,
        turned,
        0.014,
    )
    ring = m.plain("snow globe foot", (0.30, 0.05, 0.05), 0.3)
    at = Vector((1.28, 1.07, CASE_TOP))
    rod(room, "snow globe foot", at, at + Vector((0, 0, 0.03)), 0.042, ring, 0.034, sides=24)
    rod(
        room,
        "snow tree",
        at + Vector((0, 0, 0.03)),
        at + Vector((0, 0, 0.085)),
        0.02,
        m.plain("snow tree", (0.03, 0.20, 0.08)),
        0.0,
    )
    ball(
        room,
        "snow globe",
        at + Vector((0, 0, 0.072)),
        0.046,
        mb.thin_glass("snow glass", (0.9, 0.94, 0.95)),
        4,
    )


def _crate(room: Collection, dice: random.Random) -> None:
    """Under the window: a slatted crate, deep and dark, full of balls and sticks."""
    pine = m.wood("crate pine", (0.26, 0.13, 0.055), (0.48, 0.28, 0.13), "X")
    x0, x1, y0, y1 = -1.36, -0.76, 0.72, 1.16
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    box(room, "crate floor", (cx, cy, 0.03), (x1 - x0, y1 - y0, 0.02), pine)
    for k in range(4):
        z = 0.055 + 0.095 * k
        for y in (y0, y1):
            box(room, "crate slat", (cx, y, z + 0.02), (x1 - x0 + 0.02, 0.014, 0.068), pine, bevel=0.003)
        for x in (x0, x1):
            box(room, "crate slat", (x, cy, z + 0.02), (0.014, y1 - y0, 0.068), pine, bevel=0.003)
    for x in (x0 + 0.02, x1 - 0.02):
        for y in (y0 + 0.02, y1 - 0.02):
            box(room, "crate post", (x, y, 0.2), (0.03, 0.03, 0.40), pine)
    for k in range(7):
        paint = m.plain(f"crate ball {k}", PAINTS[k % 6], 0.25)
        r = dice.uniform(0.055, 0.085)
        at = (dice.uniform(x0 + 0.1, x1 - 0.1), dice.uniform(y0 + 0.1, y1 - 0.1), 0.20 + 0.03 * (k % 4))
        ball(room, "crate ball", at, r, paint, 3)
    bat = m.wood("bat", (0.36, 0.20, 0.10), (0.58, 0.38, 0.20), "Z")
    rod(room, "bat", (cx - 0.05, cy, 0.06), (cx - 0.20, cy + 0.10, 0.66), 0.026, bat, 0.014)
    rod(room, "net stick", (cx + 0.14, cy + 0.02, 0.06), (cx + 0.20, cy + 0.14, 0.62), 0.01, bat)
    torus(
        room,
        "net hoop",
        (cx + 0.212, cy + 0.155, 0.70),
        0.085,
        0.007,
        m.plain("hoop", (0.5, 0.08, 0.05), 0.4),
        1.2,
    )


def _rug(room: Collection) -> None:
    """Round and tufted."""
    rings = [
        (0.0, (0.62, 0.55, 0.40)),
        (0.16, (0.52, 0.20, 0.12)),
        (0.30, (0.62, 0.55, 0.40)),
        (0.44, (0.08, 0.24, 0.28)),
        (0.58, (0.62, 0.55, 0.40)),
        (0.68, (0.50, 0.30, 0.05)),
    ]
    rug = rod(room, "rug", (0.02, 0.02, 0.0), (0.02, 0.02, 0.02), 0.78, mn.ringed("rug", rings), sides=64)
    plush.tufted(rug, 0.018, 0.017, 6500.0, 0.35, 0.0, 3)


def _curtains(room: Collection, at: Room) -> None:
    x0, x1, _, z1 = at.window
    y, z = at.back - 0.10, z1 + 0.13
    pole = m.wood("curtain pole", (0.30, 0.16, 0.07), (0.50, 0.32, 0.16), "X")
    rod(room, "curtain pole", (x0 - 0.26, y, z), (x1 + 0.26, y, z), 0.014, pole)
    for x in (x0 - 0.27, x1 + 0.27):
        ball(room, "finial", (x, y, z), 0.026, pole, 3)
    cotton = m.curtain("curtain", (0.62, 0.42, 0.12), (0.70, 0.62, 0.44))
    for a, b in ((x0 - 0.26, x0 + 0.02), (x1 - 0.02, x1 + 0.22)):

        def gathered(u: float, v: float, a: float = a, b: float = b) -> Point:
            depth = 0.03 * math.sin(2.0 * math.pi * 5.0 * u) * (0.5 + 0.5 * v)
            return a + (b - a) * u, y + depth, z - v * 1.30

        sheet(room, "curtain", gathered, cotton, steps=(60, 10))


def _hangings(room: Collection, at: Room) -> None:
    """Bunting, a round mirror with rays, two pictures."""
    flags = [m.fabric(f"flag {k}", dimmed(colour, 0.75), colour, 20.0) for k, colour in enumerate(PAINTS)]
    flags.append(mn.dotted("flag dots", (0.60, 0.56, 0.46), (0.55, 0.10, 0.06), 32.0))
    y, x0, x1 = at.back - 0.03, -0.10, 1.66
    cord = m.plain("cord", (0.5, 0.46, 0.36), 0.8)

    def sag(t: float) -> Vector:
        return Vector((x0 + (x1 - x0) * t, y, 2.02 - 0.56 * t * (1.0 - t)))

    bent_tube(room, "bunting cord", [sag(k / 12) for k in range(13)], 0.004, cord)
    for k in range(11):
        left, right = sag((k + 0.62) / 12), sag((k + 1.38) / 12)
        tip = (left + right) / 2 - Vector((0.0, 0.012, 0.15))

        def flag(u: float, v: float, a: Vector = left, b: Vector = right, tip: Vector = tip) -> Point:
            edge = a.lerp(b, u)
            return edge.lerp(tip, v * 0.98)

        sheet(room, "flag", flag, flags[k % 7], steps=(4, 6), thickness=0.002)
    gold = m.plain("gold", (0.74, 0.52, 0.20), 0.25, 1.0)
    centre = Vector((1.24, at.back - 0.02, 1.56))
    rod(room, "mirror", centre, centre - Vector((0, 0.012, 0)), 0.155, mb.mirror("mirror"), sides=48)
    torus(room, "mirror ring", centre - Vector((0, 0.012, 0)), 0.16, 0.014, gold, math.pi / 2)
    for k in range(16):
        turn = 2.0 * math.pi * k / 16
        out = Vector((math.cos(turn), 0.0, math.sin(turn)))
        rod(
            room,
            "ray",
            centre + out * 0.165,
            centre + out * (0.235 if k % 2 else 0.205),
            0.010,
            gold,
            0.002,
            8,
        )
    frame = m.wood("picture frame", (0.24, 0.12, 0.05), (0.44, 0.26, 0.12), "X")
    for (x, z), (w, h), kind in (
        ((0.27, 1.50), (0.42, 0.34), "landscape"),
        ((0.74, 1.40), (0.22, 0.28), "abstract"),
    ):
        box(
            room,
            f"picture {kind}",
            (x, at.back - 0.012, z),
            (w, 0.02, h),
            m.painting(f"nursery {kind}", kind),
        )
        box(
            room,
            "passepartout",
            (x, at.back - 0.006, z),
            (w + 0.07, 0.012, h + 0.07),
            m.plain("passepartout", (0.6, 0.58, 0.5), 0.8),
        )
        corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
        for a, b in itertools.pairwise(corners):
            start = (x + a[0] * (w / 2 + 0.04), at.back - 0.015, z + a[1] * (h / 2 + 0.04))
            end = (x + b[0] * (w / 2 + 0.04), at.back - 0.015, z + b[1] * (h / 2 + 0.04))
            rod(room, "picture frame", start, end, 0.014, frame)


def _wardrobe(room: Collection, at: Room) -> None:
    """Behind the cameras, for the mirror: a wardrobe, a door, a coat."""
    blue = m.plain("wardrobe paint", (0.08, 0.18, 0.26), 0.4)
    brass = m.plain("wardrobe knob", (0.74, 0.50, 0.20), 0.25, 1.0)
    box(room, "wardrobe", (-0.75, at.front + 0.15, 0.95), (1.1, 0.30, 1.9), blue, bevel=0.01)
    for side in (-1, 1):
        box(
            room,
            "wardrobe door",
            (-0.75 + side * 0.265, at.front + 0.305, 0.98),
            (0.49, 0.02, 1.7),
            blue,
            bevel=0.01,
        )
        ball(room, "wardrobe knob", (-0.75 + side * 0.06, at.front + 0.34, 1.0), 0.022, brass, 2)
    white = m.plain("door paint", (0.62, 0.60, 0.55), 0.4)
    box(room, "door", (0.75, at.front + 0.02, 1.0), (0.80, 0.04, 2.0), white, bevel=0.006)
    for z, high in ((1.5, 0.75), (0.55, 0.75)):
        place = Matrix.Translation((0.75, at.front + 0.044, z))
        panel = box(room, "door panel", (0, 0, 0), (0.58, 0.012, high), white, bevel=0.008)
        panel.matrix_world = place
