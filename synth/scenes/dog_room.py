# SPDX-License-Identifier: GPL-3.0-or-later
"""What else is in ``dog``: braided rug, basket, bowls, toys, an armchair, side table and lamp, plants."""

import math
import random

import bpy
from mathutils import Vector

from ..assets import Assets
from ..blender import Point, mesh_of
from . import materials as m
from . import materials_hearth as mh
from . import materials_table as mt
from .forms import framed, move, ring, standing
from .lighting import Lighting
from .props import ball, box, cushion, lathe, leaf_blade, rod, sheet
from .tubes import bent_tube

Collection = bpy.types.Collection
Place = tuple[float, float, float]


def furnish(room: Collection, assets: Assets, dice: random.Random) -> None:
    """Put everything in its place."""
    _rug(room, (-0.06, 0.08, 0.0))
    basket = (-1.32, 0.98, 0.0)
    assets.place("basket", room, basket, (0.84, 0.84, 0.3), 0.0, lambda: _basket(room, basket))
    _bowls(room, dice)
    _toys(room)
    chair = (1.52, 0.02, 0.0)
    turn = math.radians(-68.0)
    assets.place("armchair", room, chair, (0.78, 0.8, 1.0), turn, lambda: _armchair(room, chair, turn))
    _sill(room, dice)
    _hooks(room)


def _rug(room: Collection, at: Place) -> None:
    """Braids in ovals round and round, each ring of another cloth."""
    colours = [
        ((0.24, 0.05, 0.04), (0.46, 0.13, 0.08)), ((0.36, 0.28, 0.17), (0.58, 0.48, 0.32)),
        ((0.04, 0.08, 0.13), (0.12, 0.20, 0.28)), ((0.36, 0.20, 0.05), (0.60, 0.38, 0.12)),
        ((0.07, 0.12, 0.07), (0.18, 0.26, 0.14)),
    ]  # fmt: skip
    cloths = [m.fabric(f"braid {k}", dark, light, 26.0) for k, (dark, light) in enumerate(colours)]
    order = (1, 0, 1, 2, 2, 3, 0, 1, 4, 4, 3, 0)
    for k, cloth in enumerate(order):
        radius, length = 0.055 + 0.055 * k, 0.34
        points = []
        for j in range(49):
            a = 2 * math.pi * j / 48
            twist = 0.004 * math.sin(6 * (k + 2) * a)
            points.append(
                (
                    (radius + twist) * math.cos(a)
                    + math.copysign(length, math.cos(a)) * min(1.0, abs(3 * math.cos(a))),
                    (radius + twist) * math.sin(a),
                    0.014,
                )
            )
        braid = bent_tube(room, "braid", points, 0.0285, cloths[cloth], 8, 2)
        braid.scale = (1.0, 1.0, 0.55)
        braid.location = at
    box(room, "rug core", (at[0], at[1], 0.006), (0.76, 1.24, 0.01), cloths[1])


def _basket(room: Collection, at: Place) -> None:
    """A coiled basket, low in front, with a ticking cushion and a fleece."""
    weave = mt.wicker("basket", (0.13, 0.065, 0.025), (0.44, 0.27, 0.11), 18.0)
    for k in range(8):
        coil = ring(
            room, "basket coil", (at[0], at[1], 0.022 + 0.028 * k), 0.36 + 0.008 * k, 0.018, weave, sides=48
        )
        for vertex in mesh_of(coil).vertices:  # low in front
            front = max(0.0, -vertex.co.y / 0.4)
            vertex.co.z -= 0.55 * (0.028 * k) * front**3
    lathe(room, "basket floor", at, [(0.0, 0.012), (0.36, 0.012)], weave)
    ticking = m.cloth("ticking", (0.56, 0.52, 0.43), (0.10, 0.15, 0.25), 9.0)
    pad = ball(room, "basket pad", (at[0], at[1], 0.09), 0.335, ticking, 4, 0.012, 2.0)
    pad.scale = (1.0, 1.0, 0.22)
    fleece = m.fabric("fleece", (0.42, 0.17, 0.10), (0.58, 0.28, 0.18), 30.0)

    def thrown(u: float, v: float) -> Place:
        x, y = -0.40 + 0.42 * u, -0.12 + 0.42 * v
        r = math.hypot(x, y)
        hill = 0.155 if r < 0.26 else 0.155 + 0.10 * min((r - 0.26) / 0.10, 1.0)
        over = max(0.0, r - 0.40)
        return x, y, hill + 0.02 * math.sin(11 * u + 3 * v) * math.sin(8 * v) - 1.6 * over

    sheet(room, "fleece", thrown, fleece, (26, 26), 0.012).location = at


def _bowls(room: Collection, dice: random.Random) -> None:
    """Two steel bowls on a mat, water in one, biscuits in the other."""
    mat = m.cloth("mat", (0.10, 0.13, 0.15), (0.22, 0.22, 0.20), 3.5)
    x, y, turn = 0.66, -0.68, 0.55
    box(room, "mat", (x, y, 0.005), (0.62, 0.34, 0.008), mat, (0, 0, turn))
    steel = mt.metal("bowl steel", (0.68, 0.67, 0.65), 0.24)
    bowl = [
        (0.115, 0.0),
        (0.118, 0.006),
        (0.098, 0.062),
        (0.102, 0.068),
        (0.094, 0.068),
        (0.080, 0.03),
        (0.06, 0.012),
        (0.0, 0.010),
    ]
    c, s = math.cos(turn), math.sin(turn)
    water, food = (x - 0.145 * c, y - 0.145 * s, 0.009), (x + 0.145 * c, y + 0.145 * s, 0.009)
    for at in (water, food):
        lathe(room, "steel bowl", at, bowl, steel, 48)
        rubber = m.plain("rubber", (0.02, 0.02, 0.022), 0.7)
        ring(room, "bowl foot", (at[0], at[1], 0.012), 0.117, 0.006, rubber)
    wet = m.plain("water", (0.03, 0.035, 0.04), 0.03)
    lathe(room, "water", (*water[:2], 0.056), [(0.0, 0.0), (0.0905, 0.0)], wet, 40)
    biscuit = m.speckled("biscuit", (0.30, 0.14, 0.05), (0.46, 0.26, 0.10), 60.0, 0.8)
    for k in range(70):
        a, r = 2.4 * k, 0.082 * math.sqrt(dice.random())
        z = 0.045 + 0.022 * (1 - (r / 0.085) ** 2) + dice.uniform(0, 0.008)
        ball(room, "biscuit", (food[0] + r * math.cos(a), food[1] + r * math.sin(a), z), 0.013, biscuit, 2)
    for dx, dy in ((0.20, -0.03), (0.07, -0.19)):
        ball(room, "biscuit", (food[0] + dx, food[1] + dy, 0.012), 0.012, biscuit, 2)


def _toys(room: Collection) -> None:
    """A rubber ball with a stripe, a tennis ball, a bone, a knotted rope."""
    red = m.banded(
        "rubber ball", [(0.52, 0.03, 0.02)] * 4 + [(0.62, 0.58, 0.48)] * 2 + [(0.04, 0.12, 0.34)] * 4, 0.25
    )
    toy = ball(room, "ball", (-0.72, -0.26, 0.112), 0.085, red, 4)
    toy.rotation_euler = (0.5, 0.7, 0.2)
    felt = m.speckled("felt", (0.46, 0.56, 0.06), (0.54, 0.62, 0.12), 60.0, 0.9)
    ball(room, "tennis ball", (-0.34, -0.74, 0.034), 0.034, felt, 3)
    bone = m.speckled("bone", (0.62, 0.55, 0.42), (0.46, 0.38, 0.26), 40.0, 0.5)
    a, b = Vector((-0.66, 0.10, 0.05)), Vector((-0.53, 0.20, 0.05))
    rod(room, "bone", a, b, 0.017, bone)
    upright: Point = (b - a).cross(Vector((0, 0, 1)))
    across = upright.normalized() * 0.02
    for end in (a, b):
        for s in (-1, 1):
            ball(room, "bone end", end + s * across, 0.026, bone, 3)
    rope = m.cloth("rope", (0.54, 0.48, 0.36), (0.16, 0.26, 0.36), 7.0, 0.6)
    path = [
        (-0.12, -0.86, 0.02),
        (-0.04, -0.84, 0.024),
        (0.05, -0.90, 0.02),
        (0.13, -0.86, 0.022),
        (0.21, -0.92, 0.02),
    ]
    bent_tube(room, "rope", path, 0.016, rope, 10)
    for knot in (path[1], path[3]):
        ball(room, "knot", (knot[0], knot[1], 0.026), 0.026, rope, 3, 0.003)


def _armchair(room: Collection, at: Place, turn: float) -> None:
    """A wing chair of worn leather with brass nails and a knitted cushion."""
    hide = mh.leather("hide", (0.10, 0.035, 0.015), (0.26, 0.105, 0.045))
    legs = m.wood("armchair legs", (0.06, 0.03, 0.015), (0.15, 0.075, 0.035), "Z")
    made = [
        box(room, "armchair base", (0, 0, 0.24), (0.72, 0.68, 0.18), hide, bevel=0.04),
        cushion(room, "armchair seat", (0, -0.06, 0.40), (0.52, 0.62, 0.18), hide, plump=0.3),
        cushion(
            room, "armchair back", (0, 0.235, 0.72), (0.54, 0.64, 0.20), hide, (math.radians(80), 0, 0), 0.3
        ),
        box(
            room, "armchair rear", (0, 0.33, 0.64), (0.70, 0.10, 0.74), hide, (math.radians(-8), 0, 0), 0.045
        ),
    ]
    brass = mt.metal("nails", (0.72, 0.50, 0.18), 0.25)
    for s in (-1, 1):
        made.append(box(room, "armchair arm", (s * 0.31, -0.02, 0.42), (0.13, 0.64, 0.34), hide, bevel=0.045))
        made.append(
            rod(
                room,
                "armchair scroll",
                (s * 0.315, -0.34, 0.585),
                (s * 0.315, 0.26, 0.61),
                0.075,
                hide,
                sides=20,
            )
        )
        made.append(
            box(
                room,
                "armchair wing",
                (s * 0.315, 0.22, 0.82),
                (0.09, 0.24, 0.38),
                hide,
                (-0.12, 0, s * 0.2),
                0.04,
            )
        )
        for y in (-0.28, 0.28):
            made.append(rod(room, "armchair leg", (s * 0.29, y, 0.0), (s * 0.29, y, 0.16), 0.018, legs, 0.03))
        for k in range(9):
            made.append(ball(room, "nail", (s * 0.315, -0.345, 0.28 + 0.028 * k), 0.008, brass, 1))
    knit = m.cloth("knit", (0.52, 0.46, 0.34), (0.12, 0.22, 0.24), 9.0)
    made.append(
        cushion(
            room,
            "knit cushion",
            (0.05, 0.09, 0.62),
            (0.38, 0.38, 0.15),
            knit,
            (math.radians(66), 0, 0.15),
            0.85,
        )
    )
    wool = m.cloth("blanket", (0.40, 0.07, 0.05), (0.08, 0.12, 0.16), 5.0)

    def draped(u: float, v: float) -> Place:
        y, path = -0.26 + 0.40 * v, (u - 0.5) * 0.80
        a = max(-1.0, min(1.0, path / 0.13)) * math.pi / 2
        x = 0.315 + 0.083 * math.sin(a)
        z = 0.60 + 0.083 * math.cos(a) - max(0.0, abs(path) - 0.13) * (1.0 if path > 0 else 0.35)
        return x + 0.008 * math.sin(17 * v) * (1 if path > 0 else 0), y + 0.01 * math.sin(8 * u), z

    made.append(sheet(room, "blanket", draped, wool, (30, 16), 0.012))
    move(made, standing(at, turn))


def lamp(
    room: Collection, lighting: Lighting, at: Place, radiance: float, colour: tuple[float, float, float]
) -> None:
    """A round table with a turned lamp whose bulb is bare; a cup, glasses and a book beside it."""
    oak = m.wood("lamp table oak", (0.12, 0.055, 0.024), (0.28, 0.15, 0.065), "X")
    x, y, _ = at
    top = 0.62
    rod(room, "lamp table", (x, y, top - 0.03), (x, y, top), 0.25, oak, sides=40)
    lathe(
        room,
        "lamp table stem",
        at,
        [(0.03, 0.05), (0.045, 0.12), (0.02, 0.22), (0.035, 0.40), (0.025, 0.60)],
        oak,
        20,
    )
    for k in range(3):
        a = 2.1 * k + 0.4
        foot = [
            (x, y, 0.14),
            (x + 0.12 * math.cos(a), y + 0.12 * math.sin(a), 0.10),
            (x + 0.22 * math.cos(a), y + 0.22 * math.sin(a), 0.014),
        ]
        bent_tube(room, "lamp table foot", foot, [0.022, 0.018, 0.014], oak)
    glaze = m.speckled("lamp glaze", (0.06, 0.17, 0.15), (0.24, 0.34, 0.24), 22.0, 0.12)
    body = [
        (0.07, 0.0),
        (0.075, 0.015),
        (0.05, 0.03),
        (0.095, 0.11),
        (0.09, 0.17),
        (0.03, 0.25),
        (0.025, 0.28),
        (0.0, 0.28),
    ]
    lathe(room, "lamp", (x + 0.02, y + 0.02, top), body, glaze, 32)
    brass = mt.metal("lamp brass", (0.74, 0.50, 0.18), 0.25)
    rod(room, "lamp socket", (x + 0.02, y + 0.02, top + 0.27), (x + 0.02, y + 0.02, top + 0.36), 0.02, brass)
    lighting.bulb("lamp", "lamp", (x + 0.02, y + 0.02, top + 0.41), 0.06, radiance, colour)
    lathe(
        room,
        "cup",
        (x - 0.12, y - 0.10, top),
        [(0.0, 0.0), (0.026, 0.0), (0.036, 0.065), (0.032, 0.065), (0.02, 0.008), (0.0, 0.008)],
        m.banded("cup", [(0.6, 0.56, 0.46), (0.45, 0.08, 0.05), (0.6, 0.56, 0.46)]),
    )
    for k, tint in enumerate(((0.08, 0.16, 0.20), (0.42, 0.10, 0.06))):
        box(
            room,
            "book",
            (x + 0.04 - 0.14 * k * 0.1, y - 0.15, top + 0.015 + 0.028 * k),
            (0.19 - 0.02 * k, 0.13, 0.027),
            m.plain(f"book {k}", tint, 0.6),
            (0, 0, 0.3 - 0.4 * k),
        )


def _sill(room: Collection, dice: random.Random) -> None:
    """Geraniums in clay pots and a small watering can on the window sill."""
    clay = m.plaster("clay", (0.42, 0.17, 0.08), 0.35)
    pot = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.068, 0.09),
        (0.076, 0.09),
        (0.076, 0.11),
        (0.064, 0.11),
        (0.06, 0.09),
        (0.0, 0.09),
    ]
    greens = [
        m.leaf(f"geranium {k}", (0.02, 0.06, 0.015), c)
        for k, c in enumerate([(0.08, 0.19, 0.05), (0.15, 0.27, 0.07)])
    ]
    petal = m.plain("petal", (0.60, 0.03, 0.04), 0.6)
    for x in (-1.50, -0.84):
        at = Vector((x, 1.72, 0.72))
        lathe(room, "clay pot", at, pot, clay, 24)
        for k in range(16):
            a = 2.4 * k
            root = at + Vector((0.02 * math.cos(a), 0.02 * math.sin(a), 0.10 + 0.004 * k))
            leaf_blade(
                room, "leaf", root, a, dice.uniform(0.10, 0.17), 0.085, greens[k % 2], 0.5 + 0.05 * k, 0.5
            )
        for k in range(3):
            a = 2.2 * k + x
            tip = at + Vector((0.07 * math.cos(a), 0.05 * math.sin(a), 0.27 + 0.03 * k))
            rod(room, "flower stalk", at + Vector((0, 0, 0.1)), tip, 0.004, greens[1], sides=6)
            for j in range(7):
                b = 0.9 * j
                ball(
                    room,
                    "petal",
                    tip + Vector((0.022 * math.cos(b), 0.022 * math.sin(b), 0.006 * (j % 3))),
                    0.015,
                    petal,
                    2,
                )
    tin = mt.metal("tin", (0.50, 0.52, 0.52), 0.32, 0.4)
    at = Vector((-1.12, 1.71, 0.72))
    lathe(
        room,
        "watering can",
        at,
        [(0.0, 0.0), (0.055, 0.0), (0.05, 0.12), (0.044, 0.12), (0.048, 0.01), (0.0, 0.01)],
        tin,
        28,
    )
    bent_tube(
        room,
        "can spout",
        [at + Vector((0.05, 0, 0.03)), at + Vector((0.10, 0, 0.09)), at + Vector((0.14, 0, 0.15))],
        [0.014, 0.010, 0.009],
        tin,
    )
    bent_tube(
        room,
        "can handle",
        [
            at + Vector((-0.05, 0, 0.03)),
            at + Vector((-0.10, 0, 0.09)),
            at + Vector((-0.05, 0, 0.15)),
            at + Vector((0.02, 0, 0.13)),
        ],
        0.006,
        tin,
    )


def _hooks(room: Collection) -> None:
    """A rail with a lead, a hat and a small picture between window and chimney; pictures on the east wall."""
    oak = m.wood("hook rail", (0.13, 0.06, 0.028), (0.30, 0.16, 0.07), "X")
    brass = mt.metal("hook brass", (0.74, 0.50, 0.18), 0.25)
    x0 = -0.40
    box(room, "hook rail", (x0 + 0.11, 1.785, 1.42), (0.34, 0.026, 0.08), oak, bevel=0.008)
    hide = mh.leather("lead", (0.20, 0.05, 0.025), (0.36, 0.11, 0.05))
    for k in range(3):
        x = x0 + 0.11 * k
        bent_tube(room, "hook", [(x, 1.77, 1.42), (x, 1.73, 1.40), (x, 1.72, 1.43)], 0.008, brass, 8, 4)
    loop = [
        (x0, 1.725, 1.43),
        (x0 - 0.035, 1.735, 1.20),
        (x0 - 0.01, 1.74, 0.98),
        (x0 + 0.03, 1.735, 1.10),
        (x0 + 0.01, 1.725, 1.43),
    ]
    bent_tube(room, "lead", loop, 0.010, hide, 8)
    felt = m.fabric("hat", (0.09, 0.08, 0.05), (0.20, 0.17, 0.10), 20.0)
    hat = lathe(
        room,
        "hat",
        (x0 + 0.22, 1.70, 1.34),
        [(0.17, 0.0), (0.165, 0.008), (0.09, 0.012), (0.085, 0.08), (0.05, 0.105), (0.0, 0.10)],
        felt,
    )
    hat.rotation_euler = (math.radians(70.0), 0.0, 0.0)
    frame = m.wood("small frame", (0.08, 0.04, 0.018), (0.20, 0.11, 0.05), "X")
    framed(
        room,
        "small picture",
        standing((x0 + 0.11, 1.785, 1.74)),
        (0.26, 0.20),
        m.painting("small oil", "landscape"),
        frame,
        0.03,
    )
    framed(
        room,
        "east picture",
        standing((2.08, 0.5, 1.55), -math.pi / 2),
        (0.6, 0.45),
        m.painting("east oil", "landscape"),
        frame,
    )
    framed(
        room,
        "front picture",
        standing((0.3, -2.77, 1.5), math.pi),
        (0.9, 0.6),
        m.painting("front oil", "abstract"),
        frame,
    )
