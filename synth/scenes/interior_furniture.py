# SPDX-License-Identifier: GPL-3.0-or-later
"""The furniture of ``interior``: sofa, coffee table, slatted chair, plant, rug."""

import itertools
import math
import random

import bpy
from mathutils import Matrix, Vector

from . import interior_storage as storage
from . import materials as m
from .props import ball, box, cushion, lathe, leaf_blade, rod, sheet

Collection = bpy.types.Collection


def furnish(room: Collection, dice: random.Random) -> None:
    """Put everything in its place (metres, the room's own axes)."""
    box(room, "rug", (-0.35, 0.1, 0.008), (2.1, 1.4, 0.016), m.rug("rug"))
    _sofa(room)
    _coffee_table(room)
    _chair(room, (0.98, -0.25, 0.0), math.radians(38.0))
    storage.bookshelf(room, dice)
    storage.cabinet(room, dice)
    storage.desk(room)
    _plant(room, (-1.62, 0.62, 0.0), dice)
    storage.pictures(room)


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
    for start, end in itertools.pairwise(arc):
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
