# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands and hangs in ``diningroom``: six chairs, rug, sideboard and mirror, clock, plant, pictures."""

import math
import random

import bpy
from mathutils import Matrix, Vector

from ..assets import Assets
from . import materials as m
from . import materials_table as mt
from .diningroom_table import branch
from .forms import copies, framed, move, ring, standing
from .props import ball, box, lathe, leaf_blade, rod, sheet
from .tubes import bent_tube

Collection = bpy.types.Collection
Place = tuple[float, float, float]
BACK, WEST, EAST = 2.1, -2.2, 2.4  # walls, as in diningroom.py


def furnish(room: Collection, assets: Assets, dice: random.Random, table: Place) -> None:
    """Put everything in its place; ``table``: the middle of the table on the floor."""
    x, y, _ = table
    box(room, "rug", (x, y, 0.007), (2.75, 2.05, 0.014), m.rug("rug"))
    built: list[tuple[Matrix, list[bpy.types.Object]]] = []
    for dx, dy, turn in (
        (-0.36, 0.72, 0.06),
        (0.38, 0.70, -0.05),
        (-1.02, 0.03, math.pi / 2 + 0.06),
        (1.06, 0.0, -math.pi / 2 - 0.16),
        (-0.40, -0.70, math.pi + 0.04),
        (0.46, -0.86, math.pi - 0.42),
    ):
        foot = (x + dx, y + dy, 0.014)
        assets.place(
            "chair", room, foot, (0.46, 0.50, 0.98), turn, lambda f=foot, t=turn: _chair(room, built, f, t)
        )
    assets.place(
        "sideboard", room, (0.72, 1.83, 0.0), (1.5, 0.46, 0.92), 0.0, lambda: _sideboard(room), fill=True
    )
    _on_sideboard(room, dice)
    _mirror(room)
    assets.place(
        "clock", room, (1.86, 1.92, 0.0), (0.44, 0.28, 2.1), 0.0, lambda: _clock(room, (1.86, 1.92, 0.0))
    )
    assets.place(
        "plant", room, (-1.80, 1.72, 0.0), (0.8, 0.8, 1.5), 0.0, lambda: _palm(room, (-1.80, 1.72, 0.0), dice)
    )
    _pictures(room)


def _chair(
    room: Collection, built: list[tuple[Matrix, list[bpy.types.Object]]], foot: Place, turn: float
) -> None:
    """A ladder-back chair with a rush seat. The first is built and noted in ``built`` with its place, the
    others share its meshes."""
    place = standing(foot, turn)
    if built:
        first, parts = built[0]
        copies(room, parts, place @ first.inverted())
    else:
        parts = _ladder_back(room)
        move(parts, place)
        built.append((place, parts))


def _ladder_back(room: Collection) -> list[bpy.types.Object]:
    wood = m.wood("chair cherry", (0.17, 0.06, 0.025), (0.36, 0.15, 0.06), "Z", 6.0, 0.35)
    rush = mt.rush("rush", (0.22, 0.13, 0.05), (0.56, 0.40, 0.19))
    made = []
    for s in (-1, 1):
        front = [
            (s * 0.21, -0.20, 0.0),
            (s * 0.21, -0.20, 0.10),
            (s * 0.212, -0.20, 0.30),
            (s * 0.21, -0.20, 0.465),
        ]
        made.append(bent_tube(room, "chair leg", front, [0.013, 0.020, 0.016, 0.021], wood))
        back = [
            (s * 0.185, 0.25, 0.0), (s * 0.18, 0.20, 0.22), (s * 0.18, 0.19, 0.46), (s * 0.178, 0.225, 0.74),
            (s * 0.172, 0.28, 0.97),
        ]  # fmt: skip
        made.append(bent_tube(room, "chair post", back, [0.016, 0.019, 0.020, 0.017, 0.014], wood))
        made.append(ball(room, "chair finial", (s * 0.171, 0.285, 0.985), 0.021, wood, 2))
        for z in (0.16, 0.28):
            made.append(
                rod(room, "chair rung", (s * 0.21, -0.20, z), (s * 0.181, 0.205, z), 0.011, wood, sides=8)
            )
    for z in (0.20, 0.32):
        made.append(rod(room, "chair rung", (-0.21, -0.20, z), (0.21, -0.20, z), 0.011, wood, sides=8))
    made.append(rod(room, "chair rung", (-0.18, 0.205, 0.22), (0.18, 0.205, 0.22), 0.011, wood, sides=8))
    for k, (z, y) in enumerate(((0.57, 0.20), (0.70, 0.218), (0.83, 0.243), (0.935, 0.27))):
        tall = 0.058 + 0.006 * k

        def slat(u: float, v: float, z: float = z, y: float = y, tall: float = tall) -> Place:
            bow = math.sin(math.pi * u)
            return (
                -0.178 + 0.356 * u,
                y + 0.035 * bow,
                z + (v - 0.5) * tall * (0.75 + 0.25 * bow) + 0.012 * bow * v,
            )

        made.append(sheet(room, "chair slat", slat, wood, (14, 2), 0.011))

    def woven(u: float, v: float) -> Place:
        x, y = 2 * u - 1, 2 * v - 1
        dip = (1 - x * x) * (1 - y * y)
        return (
            x * (0.215 - 0.015 * (y + 1)),
            y * 0.205,
            0.468 - 0.018 * dip + 0.012 * (1 - max(abs(x), abs(y)) ** 8),
        )

    made.append(sheet(room, "chair seat", woven, rush, (14, 14), 0.032))
    return made


def _sideboard(room: Collection) -> None:
    """Walnut, three drawers over three doors with brass knobs, short legs."""
    walnut = m.wood("sideboard walnut", (0.075, 0.034, 0.017), (0.19, 0.095, 0.05), "X", 5.0, 0.3)
    upright = m.wood("sideboard doors", (0.085, 0.04, 0.02), (0.21, 0.105, 0.055), "Z", 5.0, 0.3)
    brass = mt.metal("sideboard brass", (0.74, 0.50, 0.18), 0.25)
    x0, x1, y0, y1 = -0.03, 1.47, 1.62, 2.05
    cx, cy, w = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 3
    box(room, "sideboard", (cx, cy, 0.50), (x1 - x0, y1 - y0, 0.74), walnut, bevel=0.008)
    box(
        room,
        "sideboard top",
        (cx, cy - 0.01, 0.885),
        (x1 - x0 + 0.05, y1 - y0 + 0.04, 0.03),
        walnut,
        bevel=0.01,
    )
    for k in range(3):
        x = x0 + w * (k + 0.5)
        box(room, "drawer", (x, y0 - 0.004, 0.775), (w - 0.03, 0.024, 0.145), walnut, bevel=0.006)
        for dx in (-0.12, 0.12):
            ball(room, "knob", (x + dx, y0 - 0.03, 0.775), 0.016, brass, 2)
        box(room, "door", (x, y0 - 0.004, 0.41), (w - 0.03, 0.022, 0.50), upright, bevel=0.005)
        box(room, "door panel", (x, y0 - 0.016, 0.41), (w - 0.15, 0.018, 0.37), upright, bevel=0.012)
        ball(room, "knob", (x + (w / 2 - 0.05) * (1 if k == 0 else -1), y0 - 0.028, 0.44), 0.016, brass, 2)
    for x in (x0 + 0.06, x1 - 0.06):
        for y in (y0 + 0.05, y1 - 0.05):
            rod(room, "sideboard leg", (x, y, 0.0), (x, y, 0.14), 0.018, walnut, 0.03)


def _on_sideboard(room: Collection, dice: random.Random) -> None:
    """A tureen, a stack of plates, a tray with a decanter, books, a vase of berries, a small photograph."""
    z = 0.90
    white = m.plain("tureen glaze", (0.70, 0.68, 0.62), 0.12)
    silver = mt.metal("tray silver", (0.72, 0.70, 0.66), 0.16, 0.2)
    tureen = [
        (0.07, 0.0), (0.06, 0.02), (0.10, 0.045), (0.135, 0.09), (0.13, 0.13), (0.138, 0.135), (0.125, 0.145),
        (0.09, 0.185), (0.03, 0.205), (0.012, 0.21), (0.02, 0.228), (0.0, 0.238),
    ]  # fmt: skip
    lathe(room, "tureen", (0.16, 1.80, z), tureen, white)
    for s in (-1, 1):
        ring(
            room,
            "tureen handle",
            (0.16 + 0.145 * s, 1.80, z + 0.10),
            0.026,
            0.007,
            white,
            (math.pi / 2, 0, 0),
            16,
        )
    plate = [(0.0, 0.004), (0.07, 0.006), (0.12, 0.018), (0.122, 0.014), (0.07, 0.0)]
    china = m.banded("sideboard china", [(0.66, 0.64, 0.58), (0.66, 0.64, 0.58), (0.04, 0.10, 0.30)], 0.12)
    for k in range(5):
        lathe(room, "stacked plate", (0.49, 1.80, z + 0.011 * k), plate, china)
    lathe(
        room,
        "tray",
        (0.83, 1.82, z),
        [(0.0, 0.004), (0.16, 0.004), (0.175, 0.018), (0.178, 0.015), (0.16, 0.0)],
        silver,
    )
    amber = m.plain("decanter", (0.20, 0.055, 0.008), 0.06)
    decanter = [
        (0.0, 0.0),
        (0.055, 0.0),
        (0.06, 0.03),
        (0.05, 0.11),
        (0.018, 0.15),
        (0.018, 0.19),
        (0.028, 0.20),
        (0.0, 0.20),
    ]
    lathe(room, "decanter", (0.80, 1.85, z + 0.006), decanter, amber, 8)
    ball(room, "stopper", (0.80, 1.85, z + 0.228), 0.026, mt.metal("stopper", (0.8, 0.8, 0.78), 0.1), 2)
    clear = mt.glass("sherry glass")
    for dx, dy in ((0.09, -0.02), (0.12, 0.06), (0.03, -0.08)):
        sherry = [(0.024, 0.0), (0.004, 0.006), (0.004, 0.05), (0.02, 0.07), (0.024, 0.115)]
        lathe(room, "sherry glass", (0.80 + dx, 1.85 + dy, z + 0.006), sherry, clear, 16)
    vase = [
        (0.0, 0.0), (0.05, 0.0), (0.085, 0.08), (0.08, 0.16), (0.04, 0.24), (0.035, 0.28), (0.05, 0.30),
        (0.042, 0.30), (0.0, 0.25),
    ]  # fmt: skip
    lathe(
        room,
        "vase",
        (1.27, 1.84, z),
        vase,
        m.speckled("vase glaze", (0.04, 0.18, 0.20), (0.16, 0.36, 0.30), 24.0, 0.12),
    )
    branch(room, (1.27, 1.84, z + 0.28), dice, 0.42, "sprig")
    covers = [(0.35, 0.06, 0.05), (0.08, 0.14, 0.20), (0.48, 0.36, 0.14)]
    for k, colour in enumerate(covers):
        at = (1.03, 1.75, z + 0.015 + 0.028 * k)
        box(
            room,
            "book",
            at,
            (0.20 - 0.02 * k, 0.14, 0.027),
            m.plain(f"book {k}", colour, 0.6),
            (0, 0, 0.25 * k - 0.1),
        )


def _mirror(room: Collection) -> None:
    """Over the sideboard, in a gilded frame with a crest."""
    gold = mt.metal("gilt", (0.70, 0.46, 0.16), 0.34, 0.35)
    silvered = mt.metal("mirror", (0.88, 0.89, 0.88), 0.015)
    place = standing((0.72, BACK - 0.035, 1.63))
    framed(room, "mirror", place, (0.98, 0.74), silvered, gold, 0.075)
    for s in (-1, 1):
        crest = [(0.0, 0.02), (0.10, 0.075), (0.20, 0.06), (0.28, 0.01), (0.36, 0.02), (0.42, 0.0)]
        points = [(0.72 + s * x, BACK - 0.05, 2.07 + z) for x, z in crest]
        bent_tube(room, "crest", points, [0.028, 0.022, 0.018, 0.016, 0.014, 0.008], gold)
    ball(room, "crest", (0.72, BACK - 0.055, 2.10), 0.045, gold, 3)
    bead = ball(room, "bead", (0.72 - 0.53, BACK - 0.07, 1.26), 0.013, gold, 2)
    for k in range(17):
        for z in (1.222, 2.038):
            copies(room, [bead], standing((0.066 * k, 0.0, z - 1.26)))


def _clock(room: Collection, at: Place) -> None:
    """A tall case clock: plinth, trunk with a glazed door and pendulum, hood with its dial."""
    case = m.wood("clock case", (0.10, 0.04, 0.018), (0.24, 0.11, 0.05), "Z", 5.0, 0.3)
    brass = mt.metal("clock brass", (0.76, 0.54, 0.20), 0.22)
    dark = m.plain("clock inside", (0.015, 0.010, 0.008), 0.9)
    x, y, _ = at
    for z, w, d, h in (
        (0.16, 0.42, 0.28, 0.32),
        (0.36, 0.36, 0.25, 0.08),
        (0.90, 0.30, 0.22, 1.04),
        (1.47, 0.38, 0.26, 0.08),
        (1.74, 0.36, 0.25, 0.50),
        (2.02, 0.44, 0.29, 0.07),
    ):
        box(room, "clock case", (x, y, z), (w, d, h), case, bevel=0.012)
    box(room, "clock door", (x, y - 0.108, 0.92), (0.18, 0.012, 0.78), dark)
    rod(room, "pendulum", (x, y - 0.118, 1.30), (x + 0.03, y - 0.118, 0.72), 0.005, brass, sides=8)
    rod(room, "pendulum", (x + 0.03, y - 0.116, 0.70), (x + 0.03, y - 0.124, 0.70), 0.045, brass, sides=24)
    face = m.plain("clock face", (0.68, 0.64, 0.52), 0.4)
    rod(room, "clock face", (x, y - 0.12, 1.75), (x, y - 0.13, 1.75), 0.135, face, sides=32)
    ring(room, "clock bezel", (x, y - 0.13, 1.75), 0.14, 0.012, brass, (math.pi / 2, 0, 0))
    for k in range(12):
        a = math.pi / 6 * k
        ball(room, "hour", (x + 0.108 * math.sin(a), y - 0.131, 1.75 + 0.108 * math.cos(a)), 0.009, dark, 1)
    for a, length in ((0.9, 0.065), (2.3, 0.10)):
        tip = (x + length * math.sin(a), y - 0.137, 1.75 + length * math.cos(a))
        rod(room, "clock hand", (x, y - 0.137, 1.75), tip, 0.006, dark, 0.003, sides=6)


def _palm(room: Collection, at: Place, dice: random.Random) -> None:
    """A palm in a glazed pot: arched fronds of narrow leaves."""
    pot = [
        (0.0, 0.0),
        (0.13, 0.0),
        (0.19, 0.22),
        (0.20, 0.34),
        (0.215, 0.36),
        (0.18, 0.36),
        (0.17, 0.30),
        (0.0, 0.30),
    ]
    lathe(
        room,
        "palm pot",
        at,
        pot,
        m.speckled("palm glaze", (0.36, 0.15, 0.06), (0.12, 0.16, 0.18), 14.0, 0.25),
    )
    greens = [
        m.leaf(f"palm {k}", (0.02, 0.06, 0.015), c)
        for k, c in enumerate([(0.09, 0.20, 0.04), (0.17, 0.26, 0.06)])
    ]
    stem = m.plain("palm stem", (0.16, 0.17, 0.06), 0.6)
    root = Vector(at) + Vector((0, 0, 0.30))
    for k in range(11):
        a = 2.4 * k + dice.uniform(-0.2, 0.2)
        reach, rise = dice.uniform(0.22, 0.40), dice.uniform(0.75, 1.20)
        out = Vector((math.cos(a), math.sin(a), 0.0))
        bend = ((0.0, 0.0), (0.2, 0.6), (0.65, 1.0), (1.25, 0.95))
        path = [root + out * r * reach + Vector((0, 0, h * rise)) for r, h in bend]
        bent_tube(room, "frond", path, [0.009, 0.007, 0.005, 0.003], stem, 6, 4)
        for j in range(9):
            t = 1.0 + 2.0 * j / 8
            whole = min(int(t), 2)
            base = path[whole].lerp(path[whole + 1], t - whole)
            for s in (-1, 1):
                leaf_blade(room, "palm leaf", base, a + s * 0.95, 0.21, 0.034, greens[k % 2], 0.25, 0.75)


def _pictures(room: Collection) -> None:
    """Two on the back wall, plates beside the window, one large behind the camera for the mirror to show."""
    gold = mt.metal("picture gilt", (0.66, 0.44, 0.17), 0.36, 0.3)
    black = m.plain("ebony", (0.03, 0.024, 0.02), 0.3)
    paper = m.plain("mount", (0.62, 0.59, 0.50), 0.8)
    framed(
        room,
        "landscape",
        standing((-0.95, BACK - 0.02, 1.66)),
        (0.78, 0.54),
        m.painting("oil", "landscape"),
        gold,
    )
    framed(
        room,
        "print",
        standing((-0.26, BACK - 0.02, 1.78)),
        (0.24, 0.32),
        m.painting("print", "abstract"),
        black,
        0.025,
        paper,
    )
    framed(
        room,
        "etching",
        standing((-0.26, BACK - 0.02, 1.30)),
        (0.24, 0.32),
        m.painting("etching", "landscape"),
        black,
        0.025,
        paper,
    )
    framed(
        room,
        "portrait",
        standing((0.2, -2.77, 1.6), math.pi),
        (1.1, 0.8),
        m.painting("canvas", "abstract"),
        gold,
        0.08,
    )
    oak = m.wood("door oak", (0.16, 0.075, 0.03), (0.32, 0.17, 0.08), "Z")
    box(room, "house door", (-1.35, -2.78, 1.02), (0.86, 0.04, 2.04), oak, bevel=0.01)
    for z in (0.55, 1.5):
        box(room, "house door panel", (-1.35, -2.755, z), (0.6, 0.02, 0.7), oak, bevel=0.015)
    framed(
        room,
        "east picture",
        standing((EAST - 0.02, 0.9, 1.6), -math.pi / 2),
        (0.9, 0.6),
        m.painting("east oil", "landscape"),
        gold,
    )
