# SPDX-License-Identifier: GPL-3.0-or-later
"""The furniture of ``interior``: sofa, table, slatted chair, bookshelf, cabinet, plant, pictures, rug."""

from __future__ import annotations

import math
import random

import bpy
from mathutils import Matrix, Vector

from . import materials as m
from .props import ball, box, cushion, lathe, leaf_blade, rod, sheet

Collection = bpy.types.Collection


def furnish(room: Collection, dice: random.Random) -> None:
    """Put everything in its place (metres, the room's own axes)."""
    box(room, "rug", (-0.35, 0.1, 0.008), (2.1, 1.4, 0.016), m.rug("rug"))
    _sofa(room)
    _coffee_table(room)
    _chair(room, (0.98, -0.25, 0.0), math.radians(38.0))
    _bookshelf(room, dice)
    _cabinet(room, dice)
    _desk(room)
    _plant(room, (-1.62, 0.62, 0.0), dice)
    _pictures(room)


def _sofa(room: Collection) -> None:
    """Under the window: frame, two seats, back, arms, cushions, a plaid throw."""
    cover = m.fabric("sofa cover", (0.035, 0.085, 0.10), (0.09, 0.17, 0.18))
    legs = m.wood("sofa legs", (0.07, 0.035, 0.02), (0.16, 0.08, 0.04), "Z")
    x0, x1, y0, y1 = -1.25, 0.10, 0.72, 1.52
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    box(room, "sofa frame", (cx, cy, 0.22), (x1 - x0, y1 - y0, 0.18), cover, bevel=0.03)
    for x in (x0 + 0.08, x1 - 0.08):
        for y in (y0 + 0.07, y1 - 0.07):
            rod(room, "sofa leg", (x, y, 0.0), (x, y, 0.14), 0.018, legs, 0.028)
    width = (x1 - x0 - 0.34) / 2
    for k in (0, 1):
        x = x0 + 0.17 + width * (k + 0.5)
        cushion(room, "seat", (x, cy - 0.06, 0.38), (width, 0.70, 0.17), cover, plump=0.25)
        lean = (math.radians(78.0), 0.0, 0.0)
        cushion(room, "sofa back", (x, y1 - 0.17, 0.64), (width, 0.46, 0.20), cover, lean, plump=0.3)
    for x in (x0 + 0.07, x1 - 0.07):
        box(room, "sofa arm", (x, cy, 0.38), (0.16, y1 - y0, 0.42), cover, bevel=0.05)
    box(room, "sofa rear", (cx, y1 - 0.03, 0.50), (x1 - x0, 0.10, 0.62), cover, bevel=0.03)
    plaid = m.cloth("plaid", (0.55, 0.12, 0.06), (0.70, 0.55, 0.30), 3.2)
    mustard = m.fabric("mustard", (0.42, 0.22, 0.03), (0.62, 0.36, 0.06), 12.0)
    cushion(
        room,
        "plaid cushion",
        (x0 + 0.34, cy - 0.02, 0.60),
        (0.38, 0.38, 0.17),
        plaid,
        (math.radians(66), 0, 0.25),
        0.85,
    )
    cushion(
        room,
        "mustard cushion",
        (x1 - 0.33, cy, 0.59),
        (0.34, 0.34, 0.16),
        mustard,
        (math.radians(64), 0, -0.3),
        0.85,
    )
    throw = m.cloth("throw", (0.60, 0.56, 0.46), (0.12, 0.20, 0.26), 4.5)
    arm = x1 - 0.07

    def draped(u: float, v: float) -> tuple[float, float, float]:
        y = cy - 0.33 + 0.46 * v + 0.012 * math.sin(9 * u)
        path = (u - 0.5) * 0.86  # along the cloth, from the seat over the arm and down outside
        if abs(path) < 0.11:
            return arm + path, y, 0.606 + 0.006 * math.sin(14 * v)
        side = math.copysign(1.0, path)
        drop = abs(path) - 0.11
        limit = 0.12 if side < 0 else 1.0
        return arm + side * (0.098 + 0.012 * math.sin(11 * v)), y, 0.60 - min(drop, limit)

    sheet(room, "throw", draped, throw, steps=(40, 20), thickness=0.008)


def _coffee_table(room: Collection) -> None:
    """A low table: slab, four splayed legs, a slatted shelf; kettle, cup, bowl, books."""
    oak = m.wood("table oak", (0.20, 0.10, 0.045), (0.42, 0.24, 0.11), "X")
    cx, cy, top = -0.42, 0.02, 0.42
    box(room, "table top", (cx, cy, top - 0.02), (0.95, 0.52, 0.04), oak, bevel=0.012)
    for sx in (-1, 1):
        for sy in (-1, 1):
            foot = (cx + sx * 0.43, cy + sy * 0.22, 0.015)
            rod(room, "table leg", foot, (cx + sx * 0.38, cy + sy * 0.18, top - 0.04), 0.014, oak, 0.022)
    for k in range(6):
        box(room, "table slat", (cx, cy - 0.15 + 0.06 * k, 0.17), (0.78, 0.035, 0.014), oak)
    steel = m.plain("kettle steel", (0.62, 0.60, 0.58), 0.16, 1.0)
    dark = m.plain("kettle handle", (0.02, 0.02, 0.02), 0.35)
    body = [(0.0, 0.0), (0.085, 0.0), (0.10, 0.02), (0.098, 0.07), (0.075, 0.115), (0.04, 0.135), (0.0, 0.14)]
    at = Vector((cx - 0.22, cy + 0.06, top))
    lathe(room, "kettle", at, body, steel)
    ball(room, "kettle knob", at + Vector((0, 0, 0.15)), 0.016, dark, 2)
    rod(room, "spout", at + Vector((0.08, 0, 0.05)), at + Vector((0.16, -0.01, 0.13)), 0.02, steel, 0.011)
    arc = [
        at + Vector((0.085 * math.cos(a), 0, 0.10 + 0.12 * math.sin(a)))
        for a in [math.pi * k / 8 for k in range(9)]
    ]
    for start, end in zip(arc, arc[1:], strict=False):
        rod(room, "kettle handle", start, end, 0.009, dark, sides=8)
    bowl = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.10, 0.035),
        (0.125, 0.075),
        (0.118, 0.075),
        (0.09, 0.035),
        (0.0, 0.012),
    ]
    blue = m.banded(
        "bowl", [(0.65, 0.62, 0.55), (0.03, 0.08, 0.28), (0.65, 0.62, 0.55), (0.03, 0.08, 0.28)], 0.2
    )
    bowl_at = Vector((cx + 0.14, cy + 0.05, top))
    lathe(room, "bowl", bowl_at, bowl, blue)
    skins = [
        m.plain(f"fruit {k}", c, 0.35)
        for k, c in enumerate([(0.7, 0.25, 0.02), (0.55, 0.04, 0.02), (0.35, 0.45, 0.05)])
    ]
    for k, (dx, dy) in enumerate([(-0.045, -0.02), (0.045, -0.025), (0.0, 0.045)]):
        ball(room, "fruit", bowl_at + Vector((dx, dy, 0.07)), 0.042, skins[k], 3)
    cup = [(0.0, 0.0), (0.03, 0.0), (0.042, 0.07), (0.037, 0.07), (0.026, 0.008), (0.0, 0.008)]
    lathe(room, "cup", (cx - 0.02, cy - 0.15, top), cup, m.plain("cup glaze", (0.70, 0.66, 0.58), 0.15))
    for k, colour in enumerate([(0.10, 0.20, 0.16), (0.55, 0.40, 0.12), (0.35, 0.05, 0.06)]):
        cover = m.plain(f"table book {k}", colour, 0.6)
        size = (0.24 - 0.02 * k, 0.17 - 0.015 * k, 0.028)
        box(
            room, "book", (cx + 0.32, cy - 0.11, top + 0.014 + 0.028 * k), size, cover, (0, 0, 0.2 - 0.25 * k)
        )


def _chair(room: Collection, at: tuple[float, float, float], turn: float) -> None:
    """A slatted wooden chair, 4 cm slats: the thin parts of the scene."""
    ash = m.wood("chair ash", (0.26, 0.13, 0.055), (0.50, 0.30, 0.14), "Z", 6.0)
    place = Matrix.Translation(at) @ Matrix.Rotation(turn, 4, "Z")

    def bar(
        name: str, start: tuple[float, float, float], end: tuple[float, float, float], radius: float
    ) -> None:
        rod(room, name, place @ Vector(start), place @ Vector(end), radius, ash, sides=10)

    for x in (-0.20, 0.20):
        bar("chair front leg", (x, -0.20, 0.0), (x, -0.19, 0.44), 0.018)
        bar("chair back post", (x, 0.24, 0.0), (x, 0.20, 0.44), 0.018)
        bar("chair back post", (x, 0.20, 0.44), (x * 0.95, 0.29, 0.92), 0.017)
        bar("chair rung", (x, -0.20, 0.2), (x, 0.225, 0.2), 0.011)
    for y in (-0.20, 0.225):
        bar("chair rung", (-0.20, y, 0.26), (0.20, y, 0.26), 0.011)
    for k in range(6):
        slat = box(room, "chair seat slat", (0, 0, 0), (0.44, 0.052, 0.018), ash, bevel=0.005)
        slat.matrix_world = place @ Matrix.Translation((0.0, -0.19 + 0.075 * k, 0.45))
    for k in range(5):
        x = -0.13 + 0.065 * k
        slat = box(room, "chair back slat", (0, 0, 0), (0.034, 0.012, 0.42), ash)
        slat.matrix_world = (
            place @ Matrix.Translation((x, 0.245, 0.68)) @ Matrix.Rotation(math.radians(-10.6), 4, "X")
        )
    bar("chair rail", (-0.20, 0.285, 0.90), (0.20, 0.285, 0.90), 0.022)
    bar("chair rail", (-0.19, 0.205, 0.49), (0.19, 0.205, 0.49), 0.014)


def _bookshelf(room: Collection, dice: random.Random) -> None:
    """Right of the window: four boards of books and vases over a closed-in niche with one door ajar."""
    board = m.wood("shelf walnut", (0.085, 0.042, 0.022), (0.20, 0.11, 0.06), "Z")
    flat = m.wood("shelf boards", (0.085, 0.042, 0.022), (0.20, 0.11, 0.06), "X")
    x0, x1, y0, y1, height = 0.72, 1.86, 1.46, 1.78, 2.12
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    for x in (x0, x1):
        box(room, "shelf side", (x, cy, height / 2), (0.035, y1 - y0, height), board, bevel=0.004)
    box(room, "shelf back", (cx, y1 - 0.008, height / 2), (x1 - x0, 0.012, height), board)
    levels = [0.05, 0.62, 0.98, 1.34, 1.70, height - 0.017]
    for z in levels:
        box(room, "shelf board", (cx, cy, z), (x1 - x0, y1 - y0, 0.032), flat, bevel=0.003)
    box(room, "shelf door", (x0 + 0.285, y0 - 0.012, 0.335), (0.54, 0.022, 0.53), board, bevel=0.006)
    ball(
        room,
        "shelf knob",
        (x0 + 0.50, y0 - 0.04, 0.36),
        0.018,
        m.plain("knob", (0.75, 0.52, 0.2), 0.25, 1.0),
        2,
    )
    hinge = Matrix.Translation((x1, y0, 0.335)) @ Matrix.Rotation(math.radians(62.0), 4, "Z")
    door = box(room, "shelf door ajar", (0, 0, 0), (0.54, 0.022, 0.53), board, bevel=0.006)
    door.matrix_world = hinge @ Matrix.Translation((-0.27, 0.0, 0.0))
    colours = [
        (0.45, 0.05, 0.04), (0.05, 0.12, 0.30), (0.60, 0.50, 0.32), (0.06, 0.22, 0.12), (0.55, 0.30, 0.05),
        (0.10, 0.10, 0.11), (0.62, 0.60, 0.55), (0.28, 0.07, 0.18), (0.12, 0.30, 0.33),
    ]  # fmt: skip
    covers = [m.plain(f"cover {k}", colour, 0.55) for k, colour in enumerate(colours)]
    label = m.plain("spine label", (0.70, 0.62, 0.40), 0.5)
    spans = [
        (0.62, x0 + 0.03, x0 + 0.72),
        (0.98, x0 + 0.36, x1 - 0.04),
        (1.34, x0 + 0.03, x1 - 0.38),
        (1.70, x0 + 0.5, x1 - 0.1),
    ]
    for z, start, stop in spans:
        x = start
        while x < stop - 0.06:
            thick, tall = dice.uniform(0.035, 0.062), dice.uniform(0.21, 0.30)
            deep = dice.uniform(0.17, 0.22)
            lean = dice.choice([0.0, 0.0, 0.0, 0.06])
            at = (x + thick / 2, y0 + 0.04 + deep / 2, z + 0.016 + tall / 2)
            box(
                room, "spine", at, (thick - 0.003, deep, tall), dice.choice(covers), (0, lean, 0), bevel=0.003
            )
            if dice.random() < 0.55:
                stripe = (at[0], y0 + 0.041, z + 0.016 + tall * 0.72)
                box(room, "label", stripe, (thick - 0.004, 0.006, 0.035), label, (0, lean, 0))
            x += thick + 0.002
    _vases(room, x0, x1, y0 + 0.14)


def _vases(room: Collection, x0: float, x1: float, y: float) -> None:
    """Glazed vases, a plate, a brass bowl and a small globe between the books."""
    slim = [
        (0.0, 0.0),
        (0.045, 0.0),
        (0.075, 0.07),
        (0.06, 0.15),
        (0.025, 0.2),
        (0.034, 0.235),
        (0.026, 0.235),
        (0.0, 0.18),
    ]
    jade = m.speckled("jade glaze", (0.10, 0.32, 0.22), (0.40, 0.52, 0.34), 28.0)
    white = m.banded(
        "banded vase", [(0.62, 0.60, 0.54), (0.42, 0.10, 0.05), (0.62, 0.60, 0.54), (0.05, 0.05, 0.06)]
    )
    cobalt = m.plain("cobalt", (0.02, 0.05, 0.30), 0.12)
    brass = m.plain("brass bowl", (0.78, 0.50, 0.16), 0.22, 1.0)
    lathe(room, "vase jade", (x0 + 0.14, y, 0.996), [(r * 1.2, h * 1.15) for r, h in slim], jade)
    lathe(room, "vase banded", (x1 - 0.16, y, 1.356), slim, white)
    lathe(room, "vase cobalt", (x0 + 0.20, y, 1.716), [(r * 1.1, h) for r, h in slim], cobalt)
    ball(room, "globe", (x1 - 0.22, y, 0.636 + 0.13), 0.11, m.painting("globe map", "abstract"), 4)
    rod(room, "globe stand", (x1 - 0.22, y, 0.636), (x1 - 0.22, y, 0.67), 0.06, brass)
    bowl = [(0.0, 0.0), (0.05, 0.0), (0.11, 0.06), (0.14, 0.11), (0.132, 0.11), (0.09, 0.05), (0.0, 0.015)]
    lathe(room, "brass bowl", ((x0 + x1) / 2, y, 2.12), bowl, brass)


def _cabinet(room: Collection, dice: random.Random) -> None:
    """Against the left wall: an open cabinet, dark inside; records, a box, a vase and a clock on top."""
    teak = m.wood("cabinet teak", (0.15, 0.07, 0.03), (0.30, 0.15, 0.07), "Y")
    x0, x1, y0, y1, z0, z1 = -2.08, -1.66, -0.95, 0.30, 0.14, 0.74
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    for z in (z0, 0.44, z1):
        box(room, "cabinet board", (cx, cy, z), (x1 - x0, y1 - y0, 0.03), teak, bevel=0.004)
    for y in (y0, cy, y1):
        box(room, "cabinet wall", (cx, y, (z0 + z1) / 2), (x1 - x0, 0.03, z1 - z0), teak)
    box(room, "cabinet back", (x0 + 0.01, cy, (z0 + z1) / 2), (0.015, y1 - y0, z1 - z0), teak)
    for x in (x0 + 0.05, x1 - 0.05):
        for y in (y0 + 0.06, y1 - 0.06):
            rod(room, "cabinet leg", (x, y, 0.0), (x, y, z0), 0.014, teak, 0.02)
    sleeves = [
        m.plain(
            f"sleeve {k}", (dice.uniform(0.03, 0.6), dice.uniform(0.03, 0.5), dice.uniform(0.03, 0.4)), 0.6
        )
        for k in range(6)
    ]
    for k in range(14):
        y = cy + 0.06 + 0.037 * k
        box(
            room,
            "record",
            (cx + 0.03, y, 0.29),
            (0.27, 0.03, 0.27),
            dice.choice(sleeves),
            (dice.uniform(-0.03, 0.03), 0, 0),
        )
    box(
        room,
        "basket",
        (cx + 0.02, cy - 0.30, 0.26),
        (0.30, 0.40, 0.20),
        m.cloth("wicker", (0.34, 0.20, 0.08), (0.14, 0.07, 0.03), 8.0),
    )
    tall = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.10, 0.10),
        (0.085, 0.22),
        (0.04, 0.31),
        (0.055, 0.36),
        (0.045, 0.36),
        (0.0, 0.3),
    ]
    lathe(
        room,
        "floor vase",
        (cx, y1 - 0.22, z1 + 0.015),
        tall,
        m.speckled("terra glaze", (0.42, 0.13, 0.06), (0.60, 0.38, 0.18), 22.0),
    )
    twig = m.plain("twig", (0.12, 0.07, 0.04), 0.8)
    berry = m.plain("berry", (0.55, 0.04, 0.03), 0.3)
    for k in range(6):
        tip = Vector(
            (cx + 0.16 * math.cos(k * 1.1), y1 - 0.22 + 0.16 * math.sin(k * 1.1), z1 + 0.62 + 0.05 * (k % 3))
        )
        rod(room, "twig", (cx, y1 - 0.22, z1 + 0.3), tip, 0.007, twig, 0.004, sides=6)
        ball(room, "berry", tip, 0.022, berry, 2)
    box(
        room,
        "radio",
        (cx + 0.05, cy - 0.15, z1 + 0.105),
        (0.16, 0.34, 0.18),
        m.wood("radio", (0.2, 0.08, 0.03), (0.36, 0.17, 0.07), "Y"),
        bevel=0.015,
    )
    box(
        room,
        "radio cloth",
        (cx + 0.134, cy - 0.20, z1 + 0.105),
        (0.006, 0.18, 0.13),
        m.fabric("radio cloth", (0.4, 0.33, 0.2), (0.6, 0.5, 0.32), 25.0),
    )
    dial = m.plain("dial", (0.72, 0.70, 0.6), 0.3)
    ball(room, "dial", (cx + 0.125, cy - 0.04, z1 + 0.12), 0.035, dial, 3)


def _desk(room: Collection) -> None:
    """Narrow console on the right wall with a glazed jug, a stack of paper and a chequered runner."""
    pine = m.wood("console pine", (0.30, 0.17, 0.08), (0.52, 0.33, 0.17), "Y")
    x0, x1, y0, y1, top = 1.68, 2.08, -0.1, 1.15, 0.80
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    box(room, "console top", (cx, cy, top - 0.018), (x1 - x0, y1 - y0, 0.036), pine, bevel=0.006)
    box(room, "console drawer", (cx + 0.02, cy, top - 0.10), (x1 - x0 - 0.06, y1 - y0 - 0.1, 0.13), pine)
    knob = m.plain("drawer knob", (0.7, 0.48, 0.18), 0.25, 1.0)
    for y in (cy - 0.3, cy + 0.3):
        ball(room, "drawer knob", (x0 + 0.035, y, top - 0.10), 0.02, knob, 2)
        for x in (x0 + 0.04, x1 - 0.04):
            leg_y = cy + math.copysign(0.57, y - cy)
            rod(room, "console leg", (x, leg_y, 0.0), (x, leg_y, top - 0.03), 0.014, pine, 0.024)
    box(
        room,
        "runner",
        (cx, cy, top + 0.004),
        (0.3, 0.95, 0.008),
        m.cloth("runner", (0.55, 0.50, 0.40), (0.10, 0.22, 0.20), 4.0),
    )
    jug = [
        (0.0, 0.0),
        (0.07, 0.0),
        (0.105, 0.08),
        (0.095, 0.17),
        (0.055, 0.23),
        (0.06, 0.28),
        (0.052, 0.28),
        (0.0, 0.2),
    ]
    lathe(room, "jug", (cx, cy - 0.30, top + 0.008), jug, m.plain("jug glaze", (0.58, 0.56, 0.50), 0.1))
    box(
        room,
        "box",
        (cx, cy + 0.12, top + 0.06),
        (0.2, 0.26, 0.11),
        m.cloth("hat box", (0.45, 0.08, 0.08), (0.62, 0.56, 0.45), 5.0),
        (0, 0, 0.3),
        0.008,
    )
    lathe(
        room,
        "mug",
        (cx - 0.08, cy - 0.10, top + 0.008),
        [(0.0, 0.0), (0.04, 0.0), (0.045, 0.1), (0.039, 0.1), (0.034, 0.01), (0.0, 0.01)],
        m.banded("mug", [(0.08, 0.2, 0.3), (0.62, 0.6, 0.52), (0.08, 0.2, 0.3)]),
    )


def _plant(room: Collection, at: tuple[float, float, float], dice: random.Random) -> None:
    """A tall pot plant with arching leaves in the left corner."""
    pot = [(0.0, 0.0), (0.12, 0.0), (0.17, 0.26), (0.18, 0.30), (0.16, 0.30), (0.15, 0.26), (0.0, 0.26)]
    lathe(room, "pot", at, pot, m.speckled("pot", (0.50, 0.46, 0.38), (0.22, 0.26, 0.28), 16.0, 0.4))
    greens = [
        m.leaf(f"leaf {k}", (0.02, 0.07, 0.02), c)
        for k, c in enumerate([(0.08, 0.22, 0.05), (0.16, 0.30, 0.07)])
    ]
    stem = m.plain("stem", (0.12, 0.16, 0.05), 0.6)
    for k in range(26):
        layer = k / 25
        angle = k * 2.399963 + dice.uniform(-0.2, 0.2)  # golden angle
        root = Vector(at) + Vector((0.03 * math.cos(angle), 0.03 * math.sin(angle), 0.30 + 0.72 * layer))
        length = dice.uniform(0.34, 0.48) * (1.15 - 0.45 * layer)
        leaf_blade(room, "leaf", root, angle, length, 0.105, greens[k % 2], 0.35 + 0.9 * layer, 0.75)
    rod(
        room, "stem", Vector(at) + Vector((0, 0, 0.25)), Vector(at) + Vector((0, 0, 1.05)), 0.018, stem, 0.008
    )


def _pictures(room: Collection) -> None:
    """Framed paintings: one by the shelf, one on each side wall; a round clock."""
    frame = m.wood("picture frame", (0.10, 0.05, 0.02), (0.26, 0.14, 0.06), "X")
    gold = m.plain("gold frame", (0.70, 0.46, 0.16), 0.35, 1.0)
    white = m.plain("clock face", (0.70, 0.68, 0.60), 0.5)
    dark = m.plain("clock hands", (0.02, 0.02, 0.02), 0.5)

    def hang(
        centre: tuple[float, float, float],
        size: tuple[float, float],
        turn: float,
        kind: str,
        wood: bpy.types.Material,
    ) -> None:
        place = Matrix.Translation(centre) @ Matrix.Rotation(turn, 4, "Z")
        w, h = size
        canvas = box(room, f"canvas {kind}", (0, 0, 0), (w, 0.02, h), m.painting(f"{kind} {turn:.2f}", kind))
        canvas.matrix_world = place
        for dx, dz, sx, sz in (
            (0, h / 2, w + 0.08, 0.05),
            (0, -h / 2, w + 0.08, 0.05),
            (w / 2, 0, 0.05, h),
            (-w / 2, 0, 0.05, h),
        ):
            bar = box(room, "frame", (0, 0, 0), (sx, 0.045, sz), wood, bevel=0.008)
            bar.matrix_world = place @ Matrix.Translation((dx, 0.0, dz))

    hang((0.42, 1.775, 1.90), (0.34, 0.44), 0.0, "abstract", frame)
    hang((-2.07, -0.2, 1.60), (0.92, 0.62), math.pi / 2, "landscape", gold)
    hang((2.07, 0.35, 1.62), (0.62, 0.78), -math.pi / 2, "abstract", frame)
    rod(room, "clock", (2.09, -0.65, 1.75), (2.06, -0.65, 1.75), 0.16, white, sides=32)
    rod(room, "clock hand", (2.055, -0.65, 1.75), (2.055, -0.65, 1.87), 0.007, dark, sides=6)
    rod(room, "clock hand", (2.055, -0.65, 1.75), (2.055, -0.57, 1.72), 0.009, dark, sides=6)
