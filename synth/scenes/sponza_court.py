# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in ``sponza``: pool and water lilies, orange trees and agaves, vessels, benches."""

import math
import random

import bpy
from mathutils import Vector

from ..assets import Assets
from . import materials as m
from . import materials_stone as stone
from . import materials_upholstery as soft
from . import sponza_hangings as hangings
from .lighting import Lighting
from .props import ball, box, lathe, leaf_blade, sheet
from .shapes import leaf, scatter, turned
from .sponza_colonnade import OUT_X
from .sponza_hangings import BLUE, CREAM, GOLD, RED
from .tubes import tube

Collection = bpy.types.Collection

POOL = (1.15, -0.6, 4.0)  # half width, y0, y1


def furnish(room: Collection, assets: Assets, lighting: Lighting, dice: random.Random) -> None:
    """Put everything in its place (metres; the court's middle is the origin)."""
    _pool(room)
    hangings.drapes(room)
    for k, (x, y) in enumerate(((-2.45, 1.0), (2.45, -0.9), (2.45, 3.1), (-2.45, 5.0))):
        foot = (x, y, 0.0)
        assets.place(
            "orange-tree",
            room,
            foot,
            (1.2, 1.2, 2.3),
            0.0,
            lambda foot=foot, k=k: _orange_tree(room, foot, k, dice),
        )
    for x, y in ((-1.75, 4.25), (1.75, 4.25), (-1.75, -0.85), (1.75, -0.85)):
        _agave(room, (x, y, 0.0), dice)
    _vessels(room)
    hangings.creeper(room, dice)
    _fallen(room, dice)
    _bench(room)
    hangings.lanterns(room, lighting)
    hangings.braziers(room, lighting, dice)


def _pool(room: Collection) -> None:
    """A long pool with a low kerb: dark, still water that shows the arcade upside down; a bronze bowl."""
    half, y0, y1 = POOL
    marble = m.plaster("pool marble", (0.66, 0.60, 0.50), 0.3)
    middle = (y0 + y1) / 2
    for s in (-1, 1):
        box(
            room,
            "pool kerb",
            (s * (half + 0.11), middle, 0.08),
            (0.22, y1 - y0 + 0.44, 0.16),
            marble,
            bevel=0.03,
        )
    for y in (y0 - 0.11, y1 + 0.11):
        box(room, "pool kerb", (0, y, 0.08), (2 * half, 0.22, 0.16), marble, bevel=0.03)
    box(
        room,
        "water",
        (0, middle, 0.045),
        (2 * half, y1 - y0, 0.09),
        stone.water("water", (0.008, 0.035, 0.035)),
    )
    bronze = stone.patina("bronze", (0.60, 0.36, 0.15), (0.14, 0.30, 0.23), 0.42)
    foot = [
        (0.0, 0.0),
        (0.24, 0.0),
        (0.24, 0.06),
        (0.17, 0.10),
        (0.09, 0.2),
        (0.08, 0.45),
        (0.13, 0.55),
        (0.15, 0.6),
        (0.0, 0.6),
    ]
    lathe(room, "bowl foot", (0, middle, 0.05), foot, marble)
    bowl = [
        (0.0, 0.0),
        (0.12, 0.0),
        (0.38, 0.1),
        (0.52, 0.24),
        (0.55, 0.27),
        (0.52, 0.28),
        (0.36, 0.15),
        (0.0, 0.07),
    ]
    lathe(room, "bowl", (0, middle, 0.64), bowl, bronze, 48)
    finial = [(0.0, 0.0), (0.05, 0.0), (0.035, 0.12), (0.075, 0.2), (0.06, 0.28), (0.015, 0.34), (0.0, 0.36)]
    lathe(room, "finial", (0, middle, 0.70), finial, bronze, 20)


def _orange_tree(room: Collection, foot: tuple[float, float, float], seed: int, dice: random.Random) -> None:
    """A clipped orange tree in a terracotta pot: the crown's leaves are strewn by geometry nodes."""
    clay = stone.rock("terracotta", (0.34, 0.13, 0.07), (0.52, 0.24, 0.13), 5.0)
    pot = [
        (0.0, 0.0),
        (0.2, 0.0),
        (0.22, 0.04),
        (0.29, 0.36),
        (0.33, 0.40),
        (0.33, 0.48),
        (0.29, 0.48),
        (0.28, 0.42),
        (0.0, 0.42),
    ]
    lathe(room, "pot", foot, pot, clay)
    for z in (0.17, 0.27):
        ring = [
            (
                foot[0] + (0.20 + 0.26 * z) * math.cos(math.tau * k / 24),
                foot[1] + (0.20 + 0.26 * z) * math.sin(math.tau * k / 24),
                z,
            )
            for k in range(25)
        ]
        tube(room, "pot ring", ring, 0.016, clay, 6)
    base = Vector(foot)
    crown = base + Vector((0.0, 0.0, 1.65))
    bark = m.wood("bark", (0.10, 0.065, 0.04), (0.22, 0.15, 0.09), "Z")
    tube(
        room,
        "trunk",
        [base + Vector((0, 0, 0.4)), base + Vector((0.03, 0.02, 0.8)), base + Vector((-0.01, 0, 1.2)), crown],
        0.035,
        bark,
    )
    inner = m.plain("crown shade", (0.015, 0.04, 0.01), 0.9)
    core = ball(room, "crown", crown, 0.40, inner, 3, 0.05, seed * 1.3)
    green = soft.foliage("orange leaf", (0.025, 0.085, 0.02), (0.10, 0.22, 0.045))
    scatter(core, leaf("orange leaf", 0.15, 0.07, green), 420.0, (0.6, 1.15), 1.0, seed=seed)
    skin = m.plain("orange skin", (0.80, 0.27, 0.02), 0.4)
    for _ in range(16):
        a, h = dice.uniform(0, math.tau), dice.uniform(-0.75, 0.7)
        r = 0.455 * math.sqrt(1.0 - h * h)
        ball(room, "orange", crown + Vector((r * math.cos(a), r * math.sin(a), 0.455 * h)), 0.045, skin, 2)


def _agave(room: Collection, foot: tuple[float, float, float], dice: random.Random) -> None:
    """A rosette of stiff leaves in a glazed bowl."""
    glaze = stone.glazed("agave pot", (0.03, 0.16, 0.26), (0.62, 0.58, 0.46))
    pot = [
        (0.0, 0.0),
        (0.13, 0.0),
        (0.15, 0.03),
        (0.12, 0.07),
        (0.21, 0.22),
        (0.22, 0.27),
        (0.19, 0.27),
        (0.18, 0.22),
        (0.0, 0.22),
    ]
    lathe(room, "agave pot", foot, pot, glaze)
    green = soft.foliage("agave", (0.07, 0.17, 0.11), (0.24, 0.36, 0.22))
    for k in range(21):
        t = k / 20
        root = Vector(foot) + Vector((0.0, 0.0, 0.24))
        length = dice.uniform(0.36, 0.44) * (1.0 - 0.25 * t)
        leaf_blade(room, "agave leaf", root, 2.399963 * k, length, 0.075, green, 0.35 + 1.5 * t, 0.25)


def _vessels(room: Collection) -> None:
    """Amphorae of glazed earthenware, a copper jar, a basket of lemons by the columns."""
    body = [
        (0.0, 0.0),
        (0.10, 0.0),
        (0.12, 0.03),
        (0.24, 0.26),
        (0.27, 0.45),
        (0.22, 0.62),
        (0.10, 0.73),
        (0.085, 0.84),
        (0.13, 0.88),
        (0.10, 0.88),
        (0.0, 0.7),
    ]
    blue = stone.glazed("blue glaze", (0.64, 0.60, 0.50), (0.02, 0.07, 0.28))
    green = stone.glazed("green glaze", (0.55, 0.36, 0.08), (0.03, 0.17, 0.10))
    copper = stone.patina("copper", (0.72, 0.30, 0.14), (0.16, 0.36, 0.28), 0.36)
    for name, (x, y), size, material in (
        ("blue amphora", (-2.35, -0.2), 1.0, blue),
        ("green amphora", (-2.62, 2.15), 0.8, green),
        ("copper jar", (2.42, 1.35), 0.95, copper),
        ("blue jar", (2.20, 1.95), 0.62, blue),
        ("green jar", (2.35, 5.3), 0.9, green),
    ):
        lathe(room, name, (x, y, 0.0), [(r * size, z * size) for r, z in body], material, 40)
        for s in (-1, 1):
            arc = [
                (x + s * size * (0.09 + 0.14 * math.sin(t)), y, size * (0.60 + 0.22 * (1 - math.cos(t)) / 2))
                for t in (0.0, 0.5, 1.0, 1.6, 2.2, 2.8, 3.14)
            ]
            tube(room, f"{name} handle", arc, 0.02 * size, material)


def _fallen(room: Collection, dice: random.Random) -> None:
    """Lily pads on the pool, blossom under the creeper."""
    half, y0, y1 = POOL
    pads = [m.plain(f"lily pad {k}", c, 0.3) for k, c in enumerate([(0.05, 0.16, 0.04), (0.11, 0.22, 0.05)])]
    white = m.plain("lily", (0.72, 0.52, 0.56), 0.5)
    for k in range(22):
        corner = dice.choice(((-0.6, 2.9), (0.55, 0.35), (-0.45, 0.25)))
        x = max(-half + 0.16, min(half - 0.16, corner[0] + dice.gauss(0.0, 0.28)))
        y = max(y0 + 0.16, min(y1 - 0.16, corner[1] + dice.gauss(0.0, 0.3)))
        size = dice.uniform(0.08, 0.15)
        rim = [(0.0, 0.0), (0.9 * size, 0.002), (size, 0.012), (0.97 * size, 0.004), (0.0, 0.004)]
        lathe(room, "lily pad", (x, y, 0.091 + 0.0015 * k), rim, pads[k % 2], 18)
        if k % 6 == 0:
            for j in range(9):
                root = (x, y, 0.13)
                leaf_blade(room, "lily", root, math.tau * j / 9, 0.10, 0.05, white, 0.8 + 0.3 * (j % 2), 0.3)
    pink = m.plain("fallen blossom", (0.55, 0.05, 0.20), 0.7)
    for _ in range(70):
        x, y = -2.45 + abs(dice.gauss(0.0, 0.5)), 3.0 + dice.gauss(0.0, 0.9)
        if x > -half - 0.3 and y < y1 + 0.3:
            continue  # that would be the pool
        size, turn = dice.uniform(0.025, 0.045), dice.uniform(0.0, 3.0)
        box(room, "blossom", (x, y, 0.012), (size, 0.7 * size, 0.008), pink, (0.2, 0.1, turn))


def _bench(room: Collection) -> None:
    """A plank bench in the right aisle and a rug thrown over it; another at the far wall."""
    oak = m.wood("bench oak", (0.10, 0.055, 0.03), (0.26, 0.15, 0.08), "X")
    for at, turn in (((OUT_X - 0.4, 2.9, 0.0), -math.pi / 2), ((-OUT_X + 0.4, 2.9, 0.0), math.pi / 2)):
        with turned(room, "bench", at, turn):
            for k in range(3):
                box(room, "bench plank", (0, -0.15 + 0.15 * k, 0.45), (1.7, 0.14, 0.045), oak, bevel=0.006)
            for x in (-0.7, 0.7):
                box(room, "bench end", (x, 0, 0.21), (0.07, 0.4, 0.42), oak, bevel=0.01)
            woven = soft.printed("bench rug", "diamonds", [RED, CREAM, BLUE, GOLD], 0.3)
            cloth = sheet(
                room,
                "bench rug",
                lambda u, v: (
                    -0.4 + 0.7 * u,
                    0.22 - min(max(v - 0.25, 0.0), 0.45) * 1.0 if v > 0.25 else 0.23,
                    0.48 - max(v - 0.7, 0.0) * 1.3 - max(0.25 - v, 0.0) * 1.0,
                ),
                woven,
                steps=(12, 20),
                thickness=0.012,
            )
            cloth.name = "bench rug"
            kilim = soft.printed("wall rug", "diamonds", [BLUE, RED, CREAM, RED, GOLD], 0.5)
            hung = box(room, "wall rug", (0.0, 0.36, 1.9), (1.5, 1.5, 0.02), kilim, (math.pi / 2, 0, 0))
            hung.name = "wall rug"
