# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands about the armchair of ``chair``: side table, pouf, log basket, plant, lamp, window, panels."""

import math
import random
from typing import Any

import bpy
from mathutils import Matrix, Vector

from . import materials as m
from . import materials_fireside as hearth
from .assembly import Assembly, disk, ring
from .forms import standing
from .greenery import arching, leaf_colour, leaf_mesh
from .lighting import Lighting
from .props import ball, box, lathe, modified, repeated, rod, sheet
from .shading import Colour
from .tubes import tube

Collection = bpy.types.Collection
Foot = tuple[float, float, float]

BULB_RADIANCE = 280.0
BULB_COLOUR = (1.0, 0.72, 0.42)


def standing_lamp(room: Collection, lighting: Lighting, foot: Foot) -> None:
    """A brass pole that bends over, a bare bulb hanging from its end."""
    brass = m.plain("lamp brass", (0.74, 0.52, 0.22), 0.24, 1.0)
    x, y, _ = foot
    lathe(
        room,
        "lamp foot",
        foot,
        [(0.0, 0.0), (0.15, 0.0), (0.145, 0.018), (0.03, 0.035), (0.0, 0.04)],
        brass,
        40,
    )
    arc = [
        (x - 0.12 * (1.0 - math.cos(a)), y, 1.72 + 0.12 * math.sin(a))
        for a in [math.pi * k / 12 for k in range(13)]
    ]
    tube(room, "lamp pole", [(x, y, 0.02), (x, y, 0.9), (x, y, 1.6), *arc], 0.011, brass)
    bulb = (x - 0.24, y, 1.56)
    rod(room, "lamp socket", (bulb[0], y, 1.60), (bulb[0], y, 1.69), 0.021, brass, 0.016)
    rod(room, "lamp cord", (bulb[0], y, 1.68), (bulb[0], y, 1.725), 0.006, brass)
    lighting.bulb("lamp", "lamp", bulb, 0.06, BULB_RADIANCE, BULB_COLOUR)


def side_table(room: Collection, foot: Foot) -> None:
    """A round tripod table: tea cup on a saucer, two books with spectacles, a silver sugar bowl."""
    table = Assembly(room, "side table", foot, 0.3)
    walnut = m.wood("table walnut", (0.08, 0.035, 0.018), (0.24, 0.12, 0.055), "X", 6.0, 0.25)
    top = 0.56
    lathe(
        table, "table top", (0, 0, top - 0.03),
        [(0.0, 0.0), (0.25, 0.0), (0.262, 0.012), (0.262, 0.026), (0.252, 0.026), (0.245, 0.02), (0.0, 0.02)],
        walnut, 48,
    )  # fmt: skip
    stem = [(0.0, 0.16), (0.03, 0.16), (0.04, 0.22), (0.022, 0.28), (0.018, 0.42), (0.034, 0.5), (0.05, 0.53)]
    lathe(table, "table stem", (0, 0, 0), stem, walnut, 24)
    for k in range(3):
        a = 2.0 * math.pi * k / 3 + 0.5
        path = [
            (r * math.cos(a), r * math.sin(a), z)
            for r, z in ((0.01, 0.22), (0.10, 0.19), (0.17, 0.08), (0.23, 0.014))
        ]
        tube(table, "table leg", path, 0.019, walnut, 10, 0.013)
    z = top - 0.008
    china = m.banded("china", [(0.75, 0.73, 0.68)] * 4 + [(0.03, 0.07, 0.25), (0.75, 0.73, 0.68)], 0.1)
    cup_at = Vector((-0.07, -0.11, z))
    lathe(
        table,
        "saucer",
        cup_at,
        [(0.0, 0.0), (0.04, 0.0), (0.078, 0.014), (0.076, 0.017), (0.0, 0.006)],
        china,
        32,
    )
    lathe(
        table, "tea cup", cup_at + Vector((0, 0, 0.007)),
        [(0.0, 0.0), (0.022, 0.0), (0.04, 0.03), (0.046, 0.062), (0.043, 0.062), (0.036, 0.03), (0.0, 0.012)],
        china, 32,
    )  # fmt: skip
    tea = m.plain("tea", (0.10, 0.03, 0.008), 0.05)
    disk(table, "tea", cup_at + Vector((0, 0, 0.056)), 0.039, tea, sides=32)
    ear = [
        cup_at + Vector((-0.041 - 0.024 * math.sin(a), 0, 0.044 + 0.02 * math.cos(a)))
        for a in [math.pi * k / 8 for k in range(9)]
    ]
    tube(table, "cup handle", ear, 0.0045, china, 8)
    silver = m.plain("silver", (0.86, 0.84, 0.80), 0.1, 1.0)
    sugar = [
        (0.0, 0.0),
        (0.03, 0.0),
        (0.015, 0.014),
        (0.045, 0.04),
        (0.05, 0.07),
        (0.03, 0.095),
        (0.008, 0.105),
        (0.012, 0.118),
        (0.0, 0.125),
    ]
    lathe(table, "sugar bowl", (-0.02, 0.12, z), sugar, silver, 32)
    covers = [((0.06, 0.14, 0.12), 0.0), ((0.36, 0.05, 0.04), 0.35)]
    for k, (colour, turn) in enumerate(covers):
        book(table, (0.11, 0.0, z + 0.03 * k), (0.13, 0.19, 0.03), colour, turn)


def book(room: Collection | Assembly, foot: Foot, size: Foot, colour: Colour, turn: float) -> None:
    """A book lying flat: cover, pages that show on three sides."""
    lying = Assembly(getattr(room, "room", room), "book", foot, turn)
    if isinstance(room, Assembly):
        lying.hub.parent = room.hub
    wide, deep, thick = size
    cover = m.plain(f"cover {colour}", colour, 0.55)
    for z in (0.0015, thick - 0.0015):
        box(lying, "cover", (0, 0, z), (wide, deep, 0.003), cover)
    box(lying, "spine", (-wide / 2, 0, thick / 2), (0.004, deep, thick), cover)
    box(
        lying,
        "pages",
        (-0.002, 0, thick / 2),
        (wide - 0.008, deep - 0.01, thick - 0.006),
        m.plain("pages", (0.62, 0.56, 0.44), 0.9),
    )


def pouf(room: Collection, foot: Foot) -> None:
    """A knitted pouf with an open book on it."""
    wool = hearth.knit("pouf wool", (0.10, 0.13, 0.13), (0.34, 0.38, 0.36))
    profile = [
        (0.0, 0.0),
        (0.16, 0.0),
        (0.235, 0.05),
        (0.26, 0.13),
        (0.25, 0.22),
        (0.19, 0.29),
        (0.08, 0.315),
        (0.0, 0.318),
    ]
    item = lathe(room, "pouf", foot, profile, wool, 40)
    modified(item, "round", "SUBSURF", render_levels=1)
    paper = m.banded("open book", [(0.70, 0.66, 0.55), (0.42, 0.40, 0.35)] * 12, 0.9)
    turn = standing(Vector(foot) + Vector((0.0, 0.0, 0.318)), 0.5)

    def pages(u: float, v: float) -> Vector:
        x = (u - 0.5) * 0.30
        return turn @ Vector(
            (x, (v - 0.5) * 0.21, 0.006 + 0.028 * math.sin(math.pi * min(1.0, abs(x) / 0.15)) ** 0.6)
        )

    sheet(room, "open book", pages, paper, steps=(28, 4), thickness=0.006)


def log_basket(room: Collection, foot: Foot, dice: random.Random) -> None:
    """A basket of woven willow, full of split logs."""
    willow = m.cloth("willow", (0.30, 0.17, 0.07), (0.12, 0.06, 0.025), 9.0)
    profile = [(0.0, 0.0), (0.17, 0.0), (0.21, 0.16), (0.22, 0.28), (0.205, 0.28), (0.19, 0.14), (0.0, 0.02)]
    lathe(room, "basket", foot, profile, willow, 32)
    ring(room, "basket rim", (foot[0], foot[1], 0.28), 0.213, 0.014, willow)
    bark = m.wood("bark", (0.05, 0.03, 0.02), (0.20, 0.12, 0.07), "Z", 8.0)
    for k in range(9):
        angle = k * 2.399963
        at = Vector(
            (
                foot[0] + 0.13 * math.sqrt(k / 9) * math.cos(angle),
                foot[1] + 0.13 * math.sqrt(k / 9) * math.sin(angle),
                0.03,
            )
        )
        tip = at + Vector((dice.uniform(-0.05, 0.05), dice.uniform(-0.05, 0.05), dice.uniform(0.36, 0.48)))
        rod(room, "fire wood", at, tip, dice.uniform(0.03, 0.042), bark, sides=9)


def plant(room: Collection, foot: Foot, dice: random.Random) -> None:
    """A tall fig in a ribbed pot."""
    glaze = m.speckled("plant pot", (0.46, 0.40, 0.32), (0.16, 0.18, 0.18), 22.0, 0.35)
    pot = [
        (0.0, 0.0),
        (0.13, 0.0),
        (0.175, 0.14),
        (0.18, 0.27),
        (0.195, 0.28),
        (0.195, 0.31),
        (0.17, 0.31),
        (0.16, 0.27),
        (0.0, 0.27),
    ]
    lathe(room, "plant pot", foot, pot, glaze, 36)
    green = leaf_colour("fig leaf", (0.012, 0.05, 0.016), (0.07, 0.20, 0.045))
    stem = m.plain("fig stem", (0.10, 0.13, 0.04), 0.6)
    blade = leaf_mesh(room, "fig blade", green, 0.62, 0.5, 0.03)
    arching(room, "fig", (foot[0], foot[1], 0.27), blade, stem, dice, 34, 1.75, 0.36, 0.55)


def curtains(room: Collection, wall: float, window: tuple[float, float, float, float]) -> None:
    """Two lengths of linen on a rod before a window in the wall at x = ``wall``, held back by cords."""
    y0, y1, _, z1 = window
    brass = m.plain("curtain brass", (0.75, 0.52, 0.20), 0.25, 1.0)
    x, top = wall + 0.10, z1 + 0.14
    rod(room, "curtain rod", (x, y0 - 0.4, top), (x, y1 + 0.34, top), 0.015, brass)
    for y in (y0 - 0.41, y1 + 0.35):
        ball(room, "finial", (x, y, top), 0.032, brass, 2)
    linen = m.curtain("curtain linen", (0.66, 0.58, 0.44), (0.40, 0.12, 0.05))
    for start, stop, tie in ((y0 - 0.36, y0 + 0.16, y0 - 0.26), (y1 + 0.30, y1 - 0.16, y1 + 0.22)):

        def gathered(
            u: float, v: float, a: float = start, b: float = stop, tie: float = tie
        ) -> tuple[float, float, float]:
            held = math.exp(-(((v - 0.62) / 0.20) ** 2))  # drawn aside by the cord
            y = a + u * (b - a)
            y += 0.72 * held * (tie - y)
            fold = 0.034 * math.sin(2.0 * math.pi * 6.0 * u) * (1.0 - 0.5 * held) * (0.55 + 0.45 * v)
            return x + fold, y, top - 0.02 - v * (top - 0.05)

        sheet(room, "curtain", gathered, linen, steps=(72, 30))
        ring(room, "tie-back", (x, tie, top - 0.02 - 0.62 * (top - 0.05)), 0.07, 0.012, brass)
        curl = ring(
            room, "curtain ring", (x, min(start, stop) + 0.03, top), 0.024, 0.004, brass, (0.0, 1.0, 0.0), 16
        )
        repeated(curl, 7, (0.0, 0.0, abs(stop - start) / 7))


def panelling(
    room: Collection,
    start: Vector,
    end: Vector,
    inward: Vector,
    material: bpy.types.Material,
    height: float = 0.86,
) -> None:
    """Painted boards along the foot of a wall from ``start`` to ``end``: skirting, raised fields, a rail."""
    length = (end - start).length
    along = (end - start) / length
    place: Any = Matrix.Translation([*start])
    place.col[0].xyz, place.col[1].xyz, place.col[2].xyz = along, -inward, Vector((0, 0, 1))
    fields = max(1, round(length / 0.46))
    step = length / fields

    def part(name: str, centre: Foot, size: Foot, bevel: float) -> bpy.types.Object:
        item = box(room, name, (0, 0, 0), size, material, bevel=bevel)
        item.matrix_world = place @ Matrix.Translation(centre)
        return item

    part("panel board", (length / 2, -0.006, height / 2), (length, 0.012, height), 0.0)
    part("skirting", (length / 2, -0.018, 0.075), (length, 0.036, 0.15), 0.008)
    part("dado rail", (length / 2, -0.02, height), (length, 0.04, 0.05), 0.012)
    for x, z, wide, tall in (
        (step / 2, 0.22, step - 0.12, 0.035),
        (step / 2, 0.76, step - 0.12, 0.035),
        (0.06, 0.49, 0.035, 0.575),
        (step - 0.06, 0.49, 0.035, 0.575),
    ):
        repeated(part("panel moulding", (x, -0.022, z), (wide, 0.026, tall), 0.01), fields, (step, 0.0, 0.0))
