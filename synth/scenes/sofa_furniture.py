# SPDX-License-Identifier: GPL-3.0-or-later
"""The furniture of ``sofa``: corner sofa with cushions and throw, table, carpet, banana plant, pouf."""

import math
import random

import bpy
from mathutils import Vector

from ..assets import Assets
from . import materials as m
from . import materials_upholstery as soft
from . import sofa_storage as storage
from .lighting import Lighting
from .props import ball, box, cushion, lathe, leaf_blade, repeated, rod, sheet
from .shapes import turned
from .tubes import tube

Collection = bpy.types.Collection


def furnish(room: Collection, assets: Assets, lighting: Lighting, dice: random.Random) -> None:
    """Put everything in its place (metres, the room's own axes)."""
    _carpet(room)
    assets.place("corner-sofa", room, (1.22, 0.9, 0.0), (2.0, 2.7, 0.85), 0.0, lambda: _sofa(room))
    assets.place(
        "coffee-table", room, (0.25, 0.35, 0.0), (0.95, 0.95, 0.38), 0.0, lambda: _table(room), fill=True
    )
    _table_things(room, dice)
    with turned(room, "television corner", (-1.42, 1.86, 0.0), math.radians(24.0)):
        storage.television(room, lighting)
    storage.shelf(room, assets, dice)
    assets.place(
        "plant",
        room,
        (-1.86, 0.78, 0.0),
        (1.0, 1.0, 1.7),
        0.0,
        lambda: _plant(room, (-1.86, 0.78, 0.0), dice),
    )
    assets.place("pouf", room, (-0.72, -0.02, 0.0), (0.56, 0.56, 0.38), 0.0, lambda: _pouf(room))
    storage.arc_lamp(room, lighting)
    storage.on_the_walls(room)


def _carpet(room: Collection) -> None:
    """Knotted wool with concentric diamonds and a fringe at either end."""
    cream, rust, ink, ochre = (
        (0.58, 0.50, 0.38),
        (0.36, 0.085, 0.04),
        (0.03, 0.045, 0.085),
        (0.48, 0.26, 0.07),
    )
    wool = soft.printed("carpet", "diamonds", [ink, rust, cream, rust, ochre, cream], 0.62)
    x0, x1, y0, y1 = -1.05, 1.5, -0.55, 1.25
    box(room, "carpet", ((x0 + x1) / 2, (y0 + y1) / 2, 0.009), (x1 - x0, y1 - y0, 0.018), wool, bevel=0.006)
    edge = soft.printed("carpet edge", "chevron", [ink, cream, rust], 0.10)
    for y in (y0 + 0.06, y1 - 0.06):
        box(room, "carpet border", ((x0 + x1) / 2, y, 0.011), (x1 - x0 + 0.004, 0.12, 0.018), edge)
    thread = box(
        room, "fringe", (x0 - 0.03, y0 + 0.02, 0.004), (0.07, 0.014, 0.008), m.plain("fringe", cream, 0.95)
    )
    repeated(thread, 60, (0.0, (y1 - y0 - 0.04) / 59, 0.0), "along the edge")


def _sofa(room: Collection) -> None:
    """Two legs of leather meet in the right corner: along the back wall, and along the right wall."""
    hide = soft.leather("cognac", (0.16, 0.050, 0.017), (0.32, 0.115, 0.038))
    foot = m.wood("sofa foot", (0.05, 0.025, 0.015), (0.12, 0.06, 0.03), "Z")
    x0, x1, y0, y1, deep = 0.24, 2.2, -0.42, 2.2, 0.86
    box(room, "sofa base", ((x0 + x1) / 2, y1 - deep / 2, 0.21), (x1 - x0, deep, 0.16), hide, bevel=0.03)
    box(
        room,
        "sofa base",
        (x1 - deep / 2, (y0 + y1 - deep) / 2, 0.21),
        (deep, y1 - deep - y0, 0.16),
        hide,
        bevel=0.03,
    )
    for x, y in (
        (x0 + 0.07, y1 - deep + 0.08),
        (x1 - deep + 0.08, y0 + 0.08),
        (x1 - 0.08, y0 + 0.08),
        (1.0, 1.42),
    ):
        rod(room, "sofa foot", (x, y, 0.0), (x, y, 0.13), 0.018, foot, 0.026)
    box(room, "sofa rear", ((x0 + x1) / 2, y1 - 0.06, 0.46), (x1 - x0, 0.13, 0.56), hide, bevel=0.05)
    box(room, "sofa rear", (x1 - 0.06, (y0 + y1) / 2, 0.46), (0.13, y1 - y0, 0.56), hide, bevel=0.05)
    box(room, "sofa arm", (x0 + 0.08, y1 - deep / 2, 0.39), (0.17, deep, 0.40), hide, bevel=0.055)
    box(room, "sofa arm", (x1 - deep / 2, y0 + 0.08, 0.39), (deep, 0.17, 0.40), hide, bevel=0.055)
    inner = x1 - deep  # where the legs meet
    seats = [
        ((x0 + 0.165 + inner) / 2, y1 - deep / 2 - 0.05, inner - x0 - 0.17, deep - 0.12),
        (x1 - deep / 2 - 0.05, y1 - deep / 2 - 0.05, deep - 0.11, deep - 0.12),
    ]
    length = (y1 - deep - y0 - 0.165) / 2
    seats += [
        (x1 - deep / 2 - 0.05, y0 + 0.165 + length * (k + 0.5), deep - 0.12, length - 0.005) for k in (0, 1)
    ]
    for x, y, sx, sy in seats:
        cushion(room, "sofa seat", (x, y, 0.365), (sx, sy, 0.17), hide, plump=0.28)
    lean = math.radians(77.0)
    cushion(
        room,
        "sofa back",
        ((x0 + 0.165 + inner) / 2, y1 - 0.2, 0.61),
        (inner - x0 - 0.2, 0.46, 0.19),
        hide,
        (lean, 0, 0),
        0.35,
    )
    cushion(
        room,
        "sofa back",
        (x1 - deep / 2 - 0.06, y1 - 0.2, 0.61),
        (deep - 0.26, 0.46, 0.19),
        hide,
        (lean, 0, 0),
        0.35,
    )
    for k in (0, 1):
        y = y0 + 0.165 + length * (k + 0.5)
        cushion(
            room,
            "sofa back",
            (x1 - 0.2, y, 0.61),
            (length - 0.03, 0.46, 0.19),
            hide,
            (lean, 0, -math.pi / 2),
            0.35,
        )
    _sofa_cushions(room)
    _throw(room, x1 - deep, y0, y0 + 0.08)


def _sofa_cushions(room: Collection) -> None:
    cream, ink, teal = (0.62, 0.56, 0.45), (0.03, 0.05, 0.10), (0.03, 0.16, 0.17)
    rust, ochre = (0.42, 0.10, 0.04), (0.55, 0.30, 0.05)
    covers = [
        soft.printed("chevron cushion", "chevron", [cream, ink], 0.13),
        soft.velvet("ochre velvet", (0.36, 0.18, 0.025), (0.80, 0.52, 0.20)),
        soft.printed("kilim cushion", "diamonds", [ochre, rust, cream, ink, rust], 0.21),
        soft.printed("striped cushion", "stripes", [teal, cream, teal, teal, ochre], 0.17),
        soft.velvet("teal velvet", (0.012, 0.075, 0.08), (0.12, 0.34, 0.34)),
        soft.printed("dotted cushion", "dots", [ink, cream, cream], 0.085),
    ]
    at = [
        ((0.56, 1.70, 0.65), 0.44, (68, 0, 12)),
        ((0.90, 1.64, 0.62), 0.38, (62, 0, -16)),
        ((1.52, 1.78, 0.67), 0.46, (70, 0, -28)),
        ((1.83, 1.36, 0.65), 0.42, (68, 0, -72)),
        ((1.76, 0.98, 0.62), 0.38, (62, 0, -104)),
        ((1.84, 0.16, 0.64), 0.42, (66, 0, -82)),
    ]
    for cover, (place, size, turns) in zip(covers, at, strict=True):
        angles = tuple(math.radians(a) for a in turns)
        cushion(room, "cushion", place, (size, size, 0.17), cover, angles, plump=0.88)


def _throw(room: Collection, x0: float, y0: float, arm: float) -> None:
    """A knitted throw over the near arm: from the seat over it and down outside, ending in a fringe."""
    wool = soft.printed(
        "throw", "stripes", [(0.62, 0.56, 0.46), (0.62, 0.56, 0.46), (0.30, 0.07, 0.05)], 0.16
    )

    def draped(u: float, v: float) -> tuple[float, float, float]:
        x = x0 + 0.16 + 0.44 * u + 0.014 * math.sin(9.0 * v)
        path = (v - 0.4) * 0.95
        if abs(path) < 0.10:
            return x, arm - path, 0.602 + 0.005 * math.sin(17.0 * u)
        side = math.copysign(1.0, path)  # + outside
        drop = abs(path) - 0.10
        if side < 0.0:  # inside: down to the seat, then along it
            down = min(drop, 0.13)
            return x, arm + 0.10 + max(drop - 0.13, 0.0) + 0.012, 0.60 - down
        return x, arm - 0.105 - 0.012 * math.sin(11.0 * u), 0.60 - drop

    sheet(room, "throw", draped, wool, steps=(22, 40), thickness=0.008)


def _table(room: Collection) -> None:
    """A round walnut table on three splayed legs, with a brass ring below."""
    walnut = m.wood("walnut", (0.085, 0.04, 0.02), (0.22, 0.115, 0.055), "X", 4.0, 0.28)
    brass = m.plain("table brass", (0.78, 0.54, 0.22), 0.22, 1.0)
    cx, cy, top = 0.25, 0.35, 0.38
    edge = [(0.0, -0.035), (0.44, -0.035), (0.465, -0.02), (0.47, -0.008), (0.46, 0.0), (0.0, 0.0)]
    lathe(room, "table top", (cx, cy, top), edge, walnut, 56)
    ring = []
    for k in range(37):
        a = 2.0 * math.pi * k / 36
        ring.append((cx + 0.27 * math.cos(a), cy + 0.27 * math.sin(a), 0.14))
    tube(room, "table ring", ring, 0.009, brass)
    for k in range(3):
        a = 0.5 + 2.0 * math.pi * k / 3
        c, s = math.cos(a), math.sin(a)
        rod(
            room,
            "table leg",
            (cx + 0.36 * c, cy + 0.36 * s, 0.0),
            (cx + 0.22 * c, cy + 0.22 * s, top - 0.03),
            0.014,
            walnut,
            0.024,
        )


def _table_things(room: Collection, dice: random.Random) -> None:
    """On the table: a teapot and cups on a brass tray, a glass vase of tulips, a bowl of oranges, books."""
    top, at = 0.38, Vector((0.25, 0.35, 0.38))
    brass = m.plain("tray", (0.80, 0.56, 0.24), 0.2, 1.0)
    tray = [(0.0, 0.0), (0.17, 0.0), (0.185, 0.022), (0.18, 0.022), (0.165, 0.006), (0.0, 0.006)]
    place = at + Vector((-0.17, -0.14, 0.0))
    lathe(room, "tray", place, tray, brass, 40)
    glaze = m.speckled("celadon", (0.34, 0.46, 0.38), (0.16, 0.28, 0.24), 24.0, 0.16)
    pot = [(0.0, 0.0), (0.05, 0.0), (0.085, 0.035), (0.09, 0.07), (0.07, 0.11), (0.035, 0.125), (0.0, 0.13)]
    pot_at = place + Vector((-0.03, 0.05, 0.006))
    lathe(room, "teapot", pot_at, pot, glaze)
    ball(room, "teapot knob", pot_at + Vector((0, 0, 0.138)), 0.014, glaze, 2)
    tube(
        room,
        "spout",
        [pot_at + Vector(p) for p in ((-0.075, 0, 0.05), (-0.115, 0, 0.07), (-0.13, 0, 0.115))],
        0.012,
        glaze,
    )
    handle = [
        pot_at + Vector((0.075 + 0.045 * math.sin(t), 0, 0.07 - 0.04 * math.cos(t)))
        for t in (0, 0.6, 1.2, 1.9, 2.5, 3.1)
    ]
    tube(room, "handle", handle, 0.008, glaze)
    cup = [(0.0, 0.0), (0.022, 0.0), (0.038, 0.045), (0.034, 0.045), (0.02, 0.006), (0.0, 0.006)]
    for x, y in ((0.09, 0.0), (0.02, -0.09)):
        lathe(room, "cup", place + Vector((x, y, 0.006)), cup, glaze)
    glass = soft.thin_glass("vase glass")
    vase = [(0.0, 0.004), (0.05, 0.0), (0.062, 0.05), (0.05, 0.13), (0.042, 0.17), (0.055, 0.21)]
    vase_at = at + Vector((0.16, 0.16, 0.0))
    lathe(room, "glass vase", vase_at, vase, glass, 40)
    stem = m.plain("tulip stem", (0.10, 0.22, 0.05), 0.5)
    petals = [
        m.plain(f"tulip {k}", c, 0.5)
        for k, c in enumerate([(0.62, 0.05, 0.04), (0.75, 0.28, 0.04), (0.66, 0.12, 0.16)])
    ]
    blade = soft.foliage("tulip leaf", (0.05, 0.14, 0.04), (0.12, 0.26, 0.08))
    bloom = [(0.004, 0.0), (0.024, 0.012), (0.03, 0.032), (0.024, 0.055), (0.012, 0.066), (0.0, 0.05)]
    for k in range(9):
        a, r = k * 2.4, 0.05 + 0.05 * dice.random()
        tip = vase_at + Vector((r * math.cos(a), r * math.sin(a), 0.30 + 0.08 * dice.random()))
        middle = (vase_at + tip) / 2 + Vector((0, 0, 0.03))
        tube(
            room,
            "tulip stem",
            [vase_at + Vector((0.01 * math.cos(a), 0.01 * math.sin(a), 0.02)), middle, tip],
            0.005,
            stem,
            6,
        )
        lathe(room, "tulip", tip, bloom, petals[k % 3], 12)
    for k in range(6):
        leaf_blade(
            room, "tulip leaf", vase_at + Vector((0, 0, 0.14)), k * 1.05 + 0.3, 0.2, 0.045, blade, 1.0, 0.7
        )
    bowl = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.10, 0.03),
        (0.135, 0.075),
        (0.128, 0.075),
        (0.09, 0.032),
        (0.0, 0.012),
    ]
    bowl_at = at + Vector((0.2, -0.17, 0.0))
    lathe(
        room,
        "bowl",
        bowl_at,
        bowl,
        m.banded(
            "bowl",
            [
                (0.03, 0.06, 0.22),
                (0.62, 0.58, 0.5),
                (0.03, 0.06, 0.22),
                (0.62, 0.58, 0.5),
                (0.03, 0.06, 0.22),
            ],
            0.15,
        ),
    )
    orange = m.plain("orange", (0.75, 0.24, 0.015), 0.4)
    for dx, dy, dz in ((-0.05, -0.02, 0.06), (0.04, -0.045, 0.06), (0.01, 0.05, 0.06), (0.0, 0.0, 0.115)):
        ball(room, "orange", bowl_at + Vector((dx, dy, dz)), 0.04, orange, 3)
    for k, colour in enumerate([(0.05, 0.10, 0.24), (0.55, 0.42, 0.20), (0.36, 0.05, 0.05)]):
        size = (0.23 - 0.02 * k, 0.16 - 0.015 * k, 0.028)
        place = (0.10, 0.60, top + 0.014 + 0.028 * k)
        box(
            room,
            "book",
            place,
            size,
            m.plain(f"table book {k}", colour, 0.55),
            (0, 0, 0.35 - 0.3 * k),
            bevel=0.003,
        )


def _plant(room: Collection, foot: tuple[float, float, float], dice: random.Random) -> None:
    """Banana leaves, broad and lit from behind, in a basket by the window."""
    weave = soft.printed("basket weave", "chevron", [(0.46, 0.30, 0.13), (0.24, 0.13, 0.05)], 0.05)
    pot = [(0.0, 0.0), (0.15, 0.0), (0.19, 0.16), (0.18, 0.34), (0.165, 0.34), (0.165, 0.30), (0.0, 0.30)]
    lathe(room, "basket pot", foot, pot, weave)
    greens = [
        soft.foliage(f"banana {k}", (0.025, 0.09, 0.02), c)
        for k, c in enumerate([(0.09, 0.24, 0.04), (0.16, 0.30, 0.06)])
    ]
    stem = m.plain("banana stem", (0.14, 0.19, 0.06), 0.5)
    for k in range(15):
        a = k * 2.399963 + dice.uniform(-0.25, 0.25)
        layer = k / 14
        root = Vector(foot) + Vector((0.05 * math.cos(a), 0.05 * math.sin(a), 0.30))
        crown = root + Vector((0.10 * math.cos(a), 0.10 * math.sin(a), 0.35 + 0.62 * layer))
        tube(room, "banana stem", [root, root.lerp(crown, 0.6), crown], 0.010, stem, 7)
        length = dice.uniform(0.36, 0.52) * (1.1 - 0.3 * layer)
        leaf_blade(room, "banana leaf", crown, a, length, 0.17, greens[k % 2], 0.55 + 0.5 * layer, 0.75)


def _pouf(room: Collection) -> None:
    """A ribbed velvet drum: a turned body whose side waves."""
    rose = soft.velvet("rose velvet", (0.24, 0.045, 0.05), (0.70, 0.34, 0.30))
    profile = [(0.0, 0.0), (0.22, 0.0), (0.255, 0.03), (0.27, 0.10)]
    profile += [(0.272 + 0.006 * math.cos(k * math.pi), 0.12 + 0.02 * k) for k in range(10)]
    profile += [(0.262, 0.33), (0.23, 0.365), (0.12, 0.375), (0.0, 0.372)]
    lathe(room, "pouf", (-0.72, -0.02, 0.018), profile, rose, 48)
    ball(room, "pouf button", (-0.72, -0.02, 0.392), 0.018, m.plain("button", (0.7, 0.48, 0.2), 0.25, 1.0), 2)
