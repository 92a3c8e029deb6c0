# SPDX-License-Identifier: GPL-3.0-or-later
"""The bear and his company: a rabbit, books, blocks, a ball, rings, a train, a humming top."""

import math
import random

import bpy
from mathutils import Matrix, Vector

from ..assets import Assets
from . import materials as m
from . import materials_nursery as mn
from . import plush
from .bear_furniture import PAINTS, SEAT
from .curved import torus
from .plush import Blob
from .props import ball, box, cushion, lathe, rod
from .tubes import bent_tube

Collection = bpy.types.Collection

ON_PAD = SEAT + 0.04
TEDDY = (0.04, 0.93, ON_PAD)
RABBIT = (-0.36, 0.93, ON_PAD)
BOOKS = (0.47, 0.92)
MOON_RADIUS = 0.088
MOON = (BOOKS[0], BOOKS[1], ON_PAD + 0.125 + MOON_RADIUS)


def scatter(room: Collection, assets: Assets, dice: random.Random) -> None:
    """Put every toy in its place (metres, the room's own axes)."""
    assets.place("teddy", room, TEDDY, (0.50, 0.50, 0.64), 0.0, lambda: _teddy(room))
    assets.place("rabbit", room, RABBIT, (0.24, 0.24, 0.50), 0.0, lambda: _rabbit(room))
    _books(room)
    _blocks(room, dice)
    _ball(room)
    _rings(room, (0.56, 0.30, 0.03))
    _train(room, (-0.10, 0.30, 0.03), math.radians(14.0))
    _top(room, (0.22, 0.02, 0.035))


def _teddy(room: Collection) -> None:
    """A seated bear of plush, 0.64 m: honey fur, a light muzzle, glass eyes, a bow tie."""
    place = Matrix.Translation(TEDDY) @ Matrix.Rotation(math.radians(4.0), 4, "Z") @ Matrix.Scale(1.04, 4)
    flat = (0.0, 0.0, 0.0)
    fur: list[Blob] = [
        ((0, 0, 0.19), (0.155, 0.135, 0.195), flat),
        ((0, -0.03, 0.15), (0.15, 0.13, 0.145), flat),
        ((0, -0.02, 0.475), (0.150, 0.132, 0.132), flat),
        ((0, -0.05, 0.445), (0.130, 0.105, 0.090), flat),
    ]
    light: list[Blob] = [((0, -0.142, 0.437), (0.068, 0.058, 0.052), flat)]
    for s in (-1, 1):
        fur += [
            ((s * 0.118, 0.0, 0.590), (0.058, 0.030, 0.058), (0.0, s * 0.3, 0.0)),
            ((s * 0.165, -0.05, 0.265), (0.056, 0.060, 0.125), (0.55, s * -0.42, 0.0)),
            ((s * 0.205, -0.115, 0.175), (0.056, 0.060, 0.062), flat),
            ((s * 0.115, -0.19, 0.075), (0.074, 0.170, 0.074), (0.0, 0.0, s * 0.28)),
            ((s * 0.165, -0.335, 0.090), (0.072, 0.048, 0.090), (0.0, 0.0, s * 0.2)),
        ]
        light += [
            ((s * 0.118, -0.022, 0.588), (0.038, 0.018, 0.038), (0.0, s * 0.3, 0.0)),
            ((s * 0.172, -0.372, 0.090), (0.050, 0.016, 0.064), (0.0, 0.0, s * 0.2)),
        ]
    honey = plush.pelt("teddy fur", (0.20, 0.085, 0.028), (0.56, 0.30, 0.12))
    cream = plush.pelt("teddy muzzle", (0.46, 0.33, 0.19), (0.68, 0.55, 0.36))
    plush.tufted(plush.blobs(room, "teddy", fur, place, honey), 0.026, 0.0105, 15000.0, 0.42, 0.4, 1)
    plush.tufted(plush.blobs(room, "teddy muzzle", light, place, cream), 0.011, 0.008, 24000.0, 0.5, 0.2, 2)
    glass = m.plain("teddy eye", (0.015, 0.008, 0.005), 0.06)
    wool = m.plain("teddy nose", (0.018, 0.012, 0.010), 0.45)
    for s in (-1, 1):
        ball(room, "teddy eye", place @ Vector((s * 0.054, -0.157, 0.508)), 0.019, glass, 3)
    nose = ball(room, "teddy nose", place @ Vector((0.0, -0.204, 0.458)), 0.027, wool, 3)
    nose.scale = (1.0, 0.6, 0.72)
    for s in (-1, 1):
        smile = [
            (0.0, -0.212, 0.438),
            (0.0, -0.211, 0.418),
            (s * 0.016, -0.206, 0.405),
            (s * 0.032, -0.197, 0.409),
        ]
        bent_tube(room, "teddy mouth", [place @ Vector(p) for p in smile], 0.0032, wool)
    silk = mn.dotted("bow tie", (0.42, 0.03, 0.03), (0.62, 0.52, 0.36), 40.0)
    for s in (-1, 1):
        at = place @ Vector((s * 0.058, -0.158, 0.345))
        cushion(room, "bow tie", at, (0.105, 0.075, 0.035), silk, (math.radians(82.0), s * 0.12, 0.0), 0.5)
    ball(room, "bow knot", place @ Vector((0.0, -0.172, 0.345)), 0.022, silk, 3)


def _rabbit(room: Collection) -> None:
    """A small grey rabbit that leans on the bear; one ear hangs."""
    place = Matrix.Translation(RABBIT) @ Matrix.Rotation(0.13, 4, "Y") @ Matrix.Rotation(0.25, 4, "Z")
    flat = (0.0, 0.0, 0.0)
    coat: list[Blob] = [
        ((0, 0, 0.105), (0.085, 0.078, 0.11), flat),
        ((0, -0.015, 0.255), (0.078, 0.074, 0.070), flat),
        ((-0.045, 0.005, 0.375), (0.026, 0.016, 0.085), (0.0, -0.22, 0.0)),
        ((0.052, 0.0, 0.365), (0.026, 0.016, 0.065), (0.0, 0.5, 0.0)),
        ((0.118, -0.01, 0.375), (0.024, 0.016, 0.060), (0.0, 2.2, 0.0)),
    ]
    for s in (-1, 1):
        coat += [
            ((s * 0.088, -0.04, 0.135), (0.030, 0.032, 0.07), (0.6, s * -0.35, 0.0)),
            ((s * 0.062, -0.11, 0.04), (0.038, 0.075, 0.038), (0.0, 0.0, s * 0.25)),
        ]
    grey = plush.pelt("rabbit coat", (0.24, 0.22, 0.21), (0.56, 0.52, 0.48), 14.0)
    plush.tufted(plush.blobs(room, "rabbit", coat, place, grey), 0.015, 0.008, 20000.0, 0.45, 0.3, 7)
    dark, pink = (
        m.plain("rabbit eye", (0.012, 0.010, 0.010), 0.08),
        m.plain("rabbit nose", (0.55, 0.20, 0.18), 0.5),
    )
    for s in (-1, 1):
        ball(room, "rabbit eye", place @ Vector((s * 0.032, -0.086, 0.272)), 0.010, dark, 2)
    ball(room, "rabbit nose", place @ Vector((0.0, -0.096, 0.247)), 0.010, pink, 2)
    knit = m.cloth("rabbit scarf", (0.05, 0.22, 0.26), (0.55, 0.48, 0.34), 12.0)
    scarf = torus(room, "rabbit scarf", (0, 0, 0), 0.058, 0.019, knit)
    scarf.matrix_world = place @ Matrix.Translation((0, -0.005, 0.19))
    end = box(room, "rabbit scarf end", (0, 0, 0), (0.035, 0.014, 0.09), knit, bevel=0.005)
    end.matrix_world = place @ Matrix.Translation((0.03, -0.088, 0.15)) @ Matrix.Rotation(0.25, 4, "X")


def _books(room: Collection) -> None:
    """A pile beside the bear; the moon stands on it in a wooden ring."""
    x, y = BOOKS
    z = ON_PAD
    paper = m.plain("pages", (0.60, 0.56, 0.46), 0.85)
    for k, (thick, turn) in enumerate(((0.034, 0.10), (0.026, -0.14), (0.030, 0.22), (0.022, -0.02))):
        cover = m.plain(f"pile book {k}", PAINTS[(k * 2 + 1) % 6], 0.4)
        w, d = 0.25 - 0.014 * k, 0.19 - 0.01 * k
        box(
            room,
            "pile pages",
            (x, y, z + thick / 2),
            (w - 0.012, d - 0.008, thick - 0.008),
            paper,
            (0, 0, turn),
        )
        for dz in (0.003, thick - 0.003):
            box(room, "pile cover", (x, y, z + dz), (w, d, 0.006), cover, (0, 0, turn))
        z += thick
    stand = m.wood("moon stand", (0.28, 0.14, 0.06), (0.50, 0.30, 0.14), "X")
    torus(room, "moon stand", (x, y, z + 0.012), 0.052, 0.012, stand)


def _blocks(room: Collection, dice: random.Random) -> None:
    """A crooked tower and some that fell from it."""
    size = 0.088
    kinds = [
        mn.block(f"block {k}", PAINTS[k % 6], ("disc", "ring", "cross", "square")[k % 4]) for k in range(8)
    ]
    x, y, z = -0.58, 0.36, 0.022

    def put(index: int, at: tuple[float, float, float], turn: float) -> None:
        box(room, "block", at, (size,) * 3, kinds[index % 8], (0, 0, turn), bevel=0.006)

    for k in range(3):
        put(k, (x + 0.1 * (k - 1), y + 0.01 * (k % 2), z + size / 2), dice.uniform(-0.15, 0.15))
    for k in range(2):
        put(k + 3, (x + 0.1 * (k - 0.5), y, z + size * 1.5), dice.uniform(-0.2, 0.2))
    for k in range(2):
        put(k + 5, (x + 0.012 * (-1) ** k, y, z + size * (2.5 + k)), dice.uniform(-0.5, 0.5))
    for k, (dx, dy, turn) in enumerate(((0.20, -0.22, 0.6), (-0.06, -0.30, 0.2), (0.34, -0.40, 1.0))):
        put(k + 2, (x + dx, y + dy, z + size / 2), turn)
    paint = m.plain("arch", PAINTS[0], 0.35)
    for k, (a, b) in enumerate(((0.0, 0.06), (0.06, 0.12))):
        rod(
            room,
            "cylinder",
            (x - 0.24, y - 0.1, z + a),
            (x - 0.24, y - 0.1, z + b),
            0.034,
            m.plain(f"cylinder {k}", PAINTS[2 + k], 0.35),
            sides=24,
        )
    rod(
        room,
        "cone",
        (x - 0.24, y - 0.1, z + 0.12),
        (x - 0.24, y - 0.1, z + 0.20),
        0.038,
        paint,
        0.0,
        sides=24,
    )


def _ball(room: Collection) -> None:
    white, red, blue = (0.66, 0.63, 0.56), (0.55, 0.05, 0.03), (0.03, 0.16, 0.36)
    item = ball(
        room,
        "ball",
        (0.92, 0.52, 0.135),
        0.135,
        mn.gores("ball", [white, red, white, blue, white, (0.62, 0.38, 0.02)]),
        4,
    )
    item.rotation_euler = (0.9, 0.3, 0.5)


def _rings(room: Collection, at: tuple[float, float, float]) -> None:
    """Rings on a peg, the smallest on top; one lies beside."""
    x, y, z = at
    peg = m.wood("peg", (0.36, 0.20, 0.10), (0.58, 0.38, 0.20), "Z")
    rod(room, "peg foot", (x, y, z), (x, y, z + 0.02), 0.085, peg, sides=28)
    rod(room, "peg", (x, y, z + 0.02), (x, y, z + 0.225), 0.012, peg)
    height = z + 0.02
    for k in range(5):
        thick = 0.022 - 0.0015 * k
        torus(
            room,
            "ring",
            (x, y, height + thick),
            0.058 - 0.007 * k,
            thick,
            m.plain(f"ring {k}", PAINTS[(k + 1) % 6], 0.22),
        )
        height += 2 * thick
    torus(room, "ring", (x - 0.17, y - 0.10, z + 0.014), 0.034, 0.015, m.plain("ring 5", PAINTS[0], 0.22))


def _train(room: Collection, at: tuple[float, float, float], turn: float) -> None:
    """An engine with a brass funnel and two wagons; along its own X."""
    place = Matrix.Translation(at) @ Matrix.Rotation(turn, 4, "Z")
    black = m.plain("wheel", (0.03, 0.03, 0.03), 0.4)
    brass = m.plain("funnel", (0.74, 0.50, 0.20), 0.2, 1.0)
    oak = m.wood("train oak", (0.30, 0.16, 0.07), (0.52, 0.33, 0.16), "X")

    def part(
        name: str,
        centre: tuple[float, float, float],
        size: tuple[float, float, float],
        material: bpy.types.Material,
    ) -> None:
        item = box(room, name, (0, 0, 0), size, material, bevel=0.005)
        item.matrix_world = place @ Matrix.Translation(centre)

    def bar(
        name: str,
        a: tuple[float, float, float],
        b: tuple[float, float, float],
        r: float,
        material: bpy.types.Material,
    ) -> None:
        rod(room, name, place @ Vector(a), place @ Vector(b), r, material, sides=20)

    for k, x in enumerate((0.0, 0.165, 0.31)):
        part("chassis", (x, 0, 0.038), (0.13, 0.062, 0.018), oak)
        for dx in (-0.042, 0.042):
            for s in (-1, 1):
                bar("wheel", (x + dx, s * 0.034, 0.024), (x + dx, s * 0.048, 0.024), 0.024, black)
                bar("hub", (x + dx, s * 0.048, 0.024), (x + dx, s * 0.051, 0.024), 0.008, brass)
        if k:
            part("wagon", (x, 0, 0.075), (0.12, 0.066, 0.056), m.plain(f"wagon {k}", PAINTS[k + 1], 0.35))
            bar("coupling", (x - 0.10, 0, 0.04), (x - 0.06, 0, 0.04), 0.005, brass)
    red = m.plain("boiler", PAINTS[0], 0.25)
    bar("boiler", (-0.075, 0, 0.080), (0.02, 0, 0.080), 0.033, red)
    bar("boiler ring", (-0.078, 0, 0.080), (-0.066, 0, 0.080), 0.036, brass)
    part("cab", (0.04, 0, 0.096), (0.05, 0.07, 0.098), m.plain("cab", PAINTS[2], 0.3))
    part("roof", (0.04, 0, 0.150), (0.072, 0.084, 0.012), oak)
    bar("funnel", (-0.05, 0, 0.105), (-0.05, 0, 0.155), 0.012, brass)
    bar("dome", (-0.012, 0, 0.105), (-0.012, 0, 0.128), 0.013, brass)
    for k in range(5):
        log = place @ Vector(
            (0.165 + 0.05 * math.sin(2.1 * k), 0.016 * math.cos(3.0 * k), 0.112 + 0.006 * (k % 2))
        )
        ball(room, "cargo", log, 0.018, m.plain(f"cargo {k}", PAINTS[k], 0.25), 2)


def _top(room: Collection, at: tuple[float, float, float]) -> None:
    """A humming top of tin."""
    steel = m.plain("top steel", (0.66, 0.65, 0.63), 0.12, 1.0)
    paint = m.plain("top paint", (0.50, 0.04, 0.05), 0.15)
    tilt = Matrix.Translation(at) @ Matrix.Rotation(0.32, 4, "Y")
    for name, profile, material in (
        ("top", [(0.0, 0.0), (0.006, 0.0), (0.02, 0.02), (0.075, 0.058), (0.088, 0.072)], steel),
        ("top band", [(0.088, 0.072), (0.090, 0.080), (0.080, 0.092)], paint),
        ("top dome", [(0.080, 0.092), (0.045, 0.112), (0.012, 0.122), (0.009, 0.17), (0.0, 0.17)], steel),
    ):
        body = lathe(room, name, (0, 0, 0), profile, material)
        body.matrix_world = tilt
    ball(
        room, "top knob", tilt @ Vector((0, 0, 0.178)), 0.016, m.plain("top knob", (0.62, 0.38, 0.02), 0.3), 3
    )
