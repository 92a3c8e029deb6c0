# SPDX-License-Identifier: GPL-3.0-or-later
"""A buttoned armchair with rolled arms and turned legs: 0.90 wide, 0.88 deep, 1.06 high."""

import math

import bpy

from . import materials as m
from . import materials_fireside as hearth
from .assembly import Assembly
from .props import ball, box, cushion, lathe, modified, rod, sheet
from .tubes import tube

SIZE = (0.90, 0.88, 1.06)
COLUMNS, ROWS = 2.5, 2.0  # diamonds of the buttoned back


def armchair(room: bpy.types.Collection, foot: tuple[float, float, float], turn: float) -> None:
    """The chair, a cushion in it and a plaid over its left arm."""
    chair = Assembly(room, "armchair", foot, turn)
    cover = hearth.velvet("chair velvet", (0.30, 0.085, 0.016), (0.58, 0.22, 0.045))
    _legs(chair)
    box(chair, "chair base", (0.0, -0.02, 0.27), (0.80, 0.76, 0.17), cover, bevel=0.035)
    cushion(chair, "chair seat", (0.0, -0.10, 0.43), (0.57, 0.66, 0.19), cover, plump=0.28)
    _back(chair, cover)
    _arms(chair, cover)
    blue = hearth.herringbone("pillow twill", (0.015, 0.04, 0.11), (0.30, 0.36, 0.40))
    cushion(
        chair,
        "chair pillow",
        (-0.10, 0.12, 0.68),
        (0.40, 0.36, 0.16),
        blue,
        (math.radians(68), 0, 0.18),
        0.85,
    )
    _plaid(chair)


def _legs(chair: Assembly) -> None:
    wood = m.wood("chair legs", (0.06, 0.025, 0.012), (0.16, 0.075, 0.035), "Z")
    brass = m.plain("chair casters", (0.78, 0.55, 0.22), 0.22, 1.0)
    turned = [
        (0.0, 0.035), (0.016, 0.035), (0.014, 0.06), (0.026, 0.09), (0.018, 0.115), (0.03, 0.15),
        (0.034, 0.20),
    ]  # fmt: skip
    for x in (-0.34, 0.34):
        lathe(chair, "chair leg", (x, -0.35, 0.0), turned, wood, 20)
        ball(chair, "caster", (x, -0.35, 0.022), 0.022, brass, 2)
        rod(chair, "chair leg", (x * 1.03, 0.40, 0.0), (x, 0.32, 0.22), 0.016, wood, 0.026)
    box(chair, "chair rail", (0.0, -0.395, 0.195), (0.74, 0.025, 0.035), wood, bevel=0.006)


def _back_at(u: float, v: float) -> tuple[float, float, float]:
    """The back without its buttoning: u across, v upward. It leans, hugs at the sides, its top is arched."""
    across = 2.0 * u - 1.0
    top = 1.02 - 0.07 * across**4 + 0.012 * math.cos(math.pi * across)
    z = 0.40 + (top - 0.40) * v
    return 0.36 * across, 0.24 + 0.15 * v - 0.17 * across**4 * (0.75 + 0.25 * v), z


def _back(chair: Assembly, cover: bpy.types.Material) -> None:
    """Diamonds drawn in at their corners by buttons; a shell behind and a roll along the rim."""

    def buttoned(u: float, v: float) -> tuple[float, float, float]:
        x, y, z = _back_at(u, v)
        a, b = u * COLUMNS, v * ROWS
        swell = abs(math.sin(math.pi * (a + b)) * math.sin(math.pi * (a - b))) ** 0.6
        edge = min(1.0, 9.0 * min(u, 1.0 - u), 9.0 * min(v, 1.0 - v))
        return x, y - 0.075 * swell * edge, z

    sheet(chair, "chair back", buttoned, cover, steps=(60, 48))
    behind = sheet(
        chair,
        "chair shell",
        lambda u, v: (_back_at(u, v)[0], _back_at(u, v)[1] + 0.09, _back_at(u, v)[2]),
        cover,
    )
    modified(behind, "thick", "SOLIDIFY", thickness=0.02)
    rim = [_back_at(0.0, k / 8) for k in range(9)]
    rim += [_back_at(k / 20, 1.0) for k in range(1, 20)]
    rim += [_back_at(1.0, 1.0 - k / 8) for k in range(9)]
    tube(chair, "chair roll", [(x, y + 0.04, z) for x, y, z in rim], 0.056, cover, 14)
    button = m.plain("chair button", (0.10, 0.035, 0.01), 0.4)
    for twice_a in range(1, 10):
        for twice_b in range(1, 8):
            a, b = twice_a / 2, twice_b / 2
            if (twice_a + twice_b) % 2 == 0 and a < COLUMNS and b < ROWS:
                x, y, z = _back_at(a / COLUMNS, b / ROWS)
                ball(chair, "chair button", (x, y - 0.004, z), 0.013, button, 2)


def _arms(chair: Assembly, cover: bpy.types.Material) -> None:
    brass = m.plain("chair nails", (0.80, 0.57, 0.25), 0.25, 1.0)
    for side in (-1, 1):
        x = side * 0.365
        box(chair, "chair arm", (x, -0.05, 0.40), (0.12, 0.72, 0.40), cover, bevel=0.03)
        outward = x + side * 0.022
        tube(
            chair,
            "arm roll",
            [(outward, -0.43 + 0.74 * k / 10, 0.595 + 0.03 * (k / 10) ** 2) for k in range(11)],
            0.082,
            cover,
            20,
        )
        rod(chair, "arm scroll", (outward, -0.425, 0.595), (outward, -0.442, 0.595), 0.07, cover, 0.06, 24)
        for k in range(14):  # nails around the scroll
            angle = 2.0 * math.pi * k / 14
            at = (outward + 0.071 * math.cos(angle), -0.432, 0.595 + 0.071 * math.sin(angle))
            ball(chair, "chair nail", at, 0.008, brass, 1)
        for k in range(7):
            ball(chair, "chair nail", (x + side * 0.045, -0.412, 0.26 + 0.038 * k), 0.008, brass, 1)


def _plaid(chair: Assembly) -> None:
    """A woollen throw over the right arm as one looks at it, with tassels."""
    wool = m.cloth("chair plaid", (0.66, 0.60, 0.46), (0.05, 0.11, 0.10), 5.5)
    arm, top, reach = 0.388, 0.69, 0.092

    def at(u: float, v: float) -> tuple[float, float, float]:
        y = -0.30 + 0.40 * v + 0.02 * math.sin(7.0 * u + 1.0)
        path = (u - 0.44) * 1.02  # metres along the cloth, 0 on top of the arm
        bend = path / reach
        if abs(bend) < math.pi / 2:
            return arm + reach * math.sin(bend), y, top - reach * (1.0 - math.cos(bend)) + 0.004
        drop = abs(path) - reach * math.pi / 2
        side = math.copysign(1.0, path)
        wave = 0.012 * math.sin(15.0 * v + 2.0) * min(1.0, drop * 6.0)
        if side < 0:  # down to the seat and along it
            fall = min(drop, 0.10)
            return arm - reach - 0.006 - max(0.0, drop - fall), y, top - reach - fall + wave * 0.4
        return arm + reach + 0.012 + wave + 0.03 * drop, y, top - reach - drop

    sheet(chair, "chair plaid", at, wool, steps=(60, 28), thickness=0.009)
    fringe = m.plain("fringe", (0.62, 0.56, 0.44), 1.0)
    for k in range(15):
        x, y, z = at(1.0, k / 14)
        rod(chair, "tassel", (x, y, z), (x + 0.006 * (-1) ** k, y, z - 0.05), 0.006, fringe, 0.008, 6)
