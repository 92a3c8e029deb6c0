# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands and hangs along the walls of ``interior``: bookshelf, cabinet, console, pictures, clock."""

import math
import random

import bpy
from mathutils import Matrix, Vector

from . import materials as m
from .props import ball, box, lathe, rod

Collection = bpy.types.Collection


def bookshelf(room: Collection, dice: random.Random) -> None:
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


def cabinet(room: Collection, dice: random.Random) -> None:
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


def desk(room: Collection) -> None:
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


def pictures(room: Collection) -> None:
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
