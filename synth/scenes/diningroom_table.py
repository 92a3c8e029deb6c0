# SPDX-License-Identifier: GPL-3.0-or-later
"""What is on the table of ``diningroom``: cloth, six places, fruit, bread, wine, candles that burn."""

import math
import random
from collections.abc import Callable

import bpy
from mathutils import Matrix, Vector

from ..assets import Assets
from ..blender import mesh_of
from . import materials as m
from . import materials_table as mt
from .forms import copies, move, ring, standing
from .lighting import Lighting
from .props import ball, box, lathe, leaf_blade, rod, sheet
from .tubes import bent_tube

Collection = bpy.types.Collection
Place = tuple[float, float, float]

LENGTH, DEPTH, TOP = 1.62, 1.0, 0.757  # of the laid table; TOP: the upper side of the cloth
FLAME = 0.016  # radius of a sphere that shines as much
CANDLES = ((-0.30, 0.02, 0.24), (0.27, 0.03, 0.30), (0.42, -0.05, 0.17))  # x, y, height of the stick


def lay(room: Collection, assets: Assets, dice: random.Random, at: Place) -> None:
    """Table, cloth and all on it but the candles; ``at``: the middle of the table on the floor."""
    assets.place("table", room, at, (LENGTH, DEPTH, TOP - 0.01), 0.0, lambda: _table(room, at), fill=True)
    _cloth(room, at)
    top = Vector(at) + Vector((0.0, 0.0, TOP))
    places = [
        (dx, side * (DEPTH / 2 - 0.17), 0.0 if side < 0 else math.pi)
        for dx in (-0.36, 0.36)
        for side in (-1, 1)
    ]
    places += [(-LENGTH / 2 + 0.18, 0.0, -math.pi / 2), (LENGTH / 2 - 0.18, 0.0, math.pi / 2)]
    first = _setting(room)
    for x, y, turn in places[1:]:
        turned = standing(top + Vector((x, y, 0.0)), turn + dice.uniform(-0.03, 0.03))
        copies(room, first, turned)
    move(first, standing(top + Vector((places[0][0], places[0][1], 0.0)), places[0][2]))
    _fruit(room, top + Vector((-0.02, 0.0, 0.006)), dice)
    _wine(room, top)
    _bread(room, top + Vector((-0.53, 0.17, 0.0)), dice)


def _table(room: Collection, at: Place) -> None:
    """Turned legs under an apron; the cloth hides the rest."""
    oak = m.wood("table oak", (0.12, 0.055, 0.025), (0.28, 0.15, 0.07), "Z")
    x, y, _ = at
    box(room, "table top", (x, y, TOP - 0.028), (LENGTH - 0.02, DEPTH - 0.02, 0.035), oak, bevel=0.01)
    leg = [
        (0.02, 0.0), (0.032, 0.03), (0.026, 0.08), (0.038, 0.20), (0.045, 0.34), (0.03, 0.44), (0.04, 0.48),
        (0.04, 0.56), (0.035, 0.57), (0.045, 0.60), (0.045, 0.72),
    ]  # fmt: skip
    for dx in (-1, 1):
        for dy in (-1, 1):
            lathe(
                room,
                "table leg",
                (x + dx * (LENGTH / 2 - 0.11), y + dy * (DEPTH / 2 - 0.10), 0.0),
                leg,
                oak,
                20,
            )


def _cloth(room: Collection, at: Place) -> None:
    """A sheet over (way round, way down): flat on top, then hanging in folds that deepen at the corners."""
    material = mt.linen("linen", (0.62, 0.59, 0.52), (0.74, 0.72, 0.66), (0.30, 0.06, 0.05), -0.19)
    w, d, rounding = LENGTH / 2, DEPTH / 2, 0.035

    def edge(u: float) -> tuple[Vector, Vector, float]:
        """Point and outward normal of the rounded outline, and how near a corner is (0…1)."""
        straight = (2 * (w - rounding), 2 * (d - rounding))
        arc = math.pi / 2 * rounding
        rest = u * 2 * (sum(straight) + 2 * arc)
        heading = 0
        while heading < 3 and rest > straight[heading % 2] + arc:
            rest -= straight[heading % 2] + arc
            heading += 1
        length = straight[heading % 2]
        along = [Vector((1, 0)), Vector((0, 1)), Vector((-1, 0)), Vector((0, -1))][heading]
        out = Vector((along.y, -along.x))
        half = straight[(heading + 1) % 2] / 2
        start = out * (half + rounding) - along * length / 2
        if rest <= length:
            point, normal = start + along * rest, out
            gap = min(rest, length - rest)
        else:
            a = (rest - length) / rounding
            normal = out * math.cos(a) + along * math.sin(a)
            point = out * half + along * length / 2 + normal * rounding
            gap = 0.0
        return point, normal, math.exp(-((gap / 0.10) ** 2))

    def draped(u: float, v: float) -> Place:
        point, normal, corner = edge(u)
        if v <= 0.3:
            inward = point * (v / 0.3)
            return inward.x, inward.y, 0.0
        down = (v - 0.3) / 0.7
        phase = 2.0 * math.pi * u
        folds = 0.016 * math.sin(23 * phase) + 0.010 * math.sin(37 * phase + 1.0) + 0.03 * corner
        swing = 0.012 + (down**1.2) * (0.03 + folds + 0.035 * corner)
        drop = 0.25 * down + 0.07 * corner * down + 0.006 * math.sin(5 * phase)
        out = point + normal * swing * min(1.0, 8 * down)
        return out.x, out.y, -0.004 - drop if down > 0.02 else -0.002

    item = sheet(room, "tablecloth", draped, material, steps=(260, 22))
    item.location = (at[0], at[1], TOP)
    runner = m.cloth("runner", (0.42, 0.10, 0.06), (0.55, 0.40, 0.20), 3.6, 0.5)
    strip = sheet(
        room,
        "runner",
        lambda u, v: ((u - 0.5) * 1.06, (v - 0.5) * 0.24, 0.003 + 0.001 * math.sin(21 * u)),
        runner,
        (30, 6),
        0.003,
    )
    strip.location = (at[0], at[1], TOP)


def _setting(room: Collection) -> list[bpy.types.Object]:
    """One place about the middle of its plate; who eats sits at −Y."""
    china = m.banded(
        "china", [(0.70, 0.69, 0.66)] * 5 + [(0.03, 0.07, 0.25)] * 2 + [(0.72, 0.71, 0.68)] * 3, 0.12
    )
    white = m.plain("porcelain", (0.74, 0.73, 0.70), 0.1)
    silver = mt.metal("silver", (0.78, 0.76, 0.72), 0.18)
    clear = mt.glass("wine glass")
    plate = [
        (0.0, 0.004), (0.06, 0.004), (0.082, 0.008), (0.09, 0.013), (0.132, 0.022), (0.134, 0.019),
        (0.08, 0.0), (0.0, 0.0),
    ]  # fmt: skip
    bowl = [
        (0.0, 0.006),
        (0.055, 0.008),
        (0.075, 0.028),
        (0.105, 0.034),
        (0.106, 0.031),
        (0.07, 0.02),
        (0.05, 0.0),
    ]
    made = [
        lathe(room, "plate", (0, 0, 0.002), plate, china, 36),
        lathe(room, "soup plate", (0, 0, 0.012), bowl, white, 36),
    ]
    goblet = [
        (0.036, 0.0), (0.034, 0.004), (0.006, 0.012), (0.005, 0.075), (0.014, 0.085), (0.036, 0.105),
        (0.043, 0.135), (0.040, 0.165), (0.035, 0.19),
    ]  # fmt: skip
    made.append(lathe(room, "wine glass", (0.135, 0.16, 0.001), goblet, clear, 24))
    tumbler = [(0.0, 0.004), (0.026, 0.004), (0.03, 0.05), (0.034, 0.095)]
    made.append(lathe(room, "tumbler", (0.205, 0.10, 0.001), tumbler, clear, 20))
    red = m.plain("wine", (0.10, 0.004, 0.008), 0.08)
    fill = [(0.0, 0.088), (0.012, 0.088), (0.034, 0.106), (0.0395, 0.13), (0.0, 0.13)]
    made.append(lathe(room, "wine", (0.135, 0.16, 0.001), fill, red, 24))

    def flat(name: str, x: float, outline: Callable[[float], float], lift: Callable[[float], float]) -> None:
        """Cutlery from the end of the handle (v = 0): half its width and height along its 20 cm."""

        def surface(u: float, v: float) -> Place:
            return x + (2 * u - 1) * outline(v), -0.10 + 0.20 * v, 0.004 + lift(v)

        made.append(sheet(room, name, surface, silver, (2, 20), 0.003))

    def handle(v: float) -> float:
        return 0.009 - 0.0055 * min(v / 0.45, 1.0) + 0.002 * math.exp(-((v / 0.08) ** 2))

    def arched(v: float) -> float:
        return 0.006 * math.sin(math.pi * v)

    flat("fork", -0.165, lambda v: handle(v) if v < 0.62 else 0.0115 * min(1.0, (v - 0.58) / 0.06), arched)
    flat(
        "knife", 0.165, lambda v: handle(0.0) if v < 0.42 else 0.0105 * (1.0 - max(0.0, v - 0.8) * 3), arched
    )
    flat(
        "spoon",
        0.195,
        lambda v: handle(v) if v < 0.64 else 0.019 * math.sin(math.pi * (v - 0.6) / 0.41) + 0.002,
        arched,
    )
    dark = m.plain("between the tines", (0.35, 0.33, 0.29), 0.8)
    for k in (-1, 0, 1):
        made.append(box(room, "tine gap", (-0.165 + 0.0062 * k, 0.075, 0.0105), (0.0028, 0.05, 0.002), dark))
    napkin = m.cloth("napkin", (0.50, 0.12, 0.07), (0.62, 0.46, 0.26), 16.0)

    def rolled(u: float, v: float) -> Place:
        a = 2 * math.pi * u
        flare = abs(v - 0.42)
        r = 0.017 + 0.055 * flare * flare * 4 + 0.010 * flare * math.sin(5 * a)
        return -0.085 + 0.17 * v, 0.65 * r * math.cos(a), 0.045 + 0.75 * r * math.sin(a)

    cloth = sheet(room, "napkin", rolled, napkin, (30, 14))
    cloth.rotation_euler = (0.0, 0.0, 0.5)
    brass = mt.metal("napkin ring", (0.75, 0.52, 0.20), 0.2)
    made += [
        cloth,
        ring(room, "napkin ring", (-0.012, -0.006, 0.044), 0.019, 0.005, brass, (0, math.pi / 2, 0.5), 20),
    ]
    return made


def _fruit(room: Collection, at: Vector, dice: random.Random) -> None:
    """A footed bowl of painted ware: oranges, apples, pears, bananas, grapes over the rim."""
    ware = m.speckled("fruit bowl", (0.66, 0.63, 0.55), (0.04, 0.12, 0.32), 22.0, 0.15)
    bowl = [
        (0.085, 0.0), (0.08, 0.012), (0.03, 0.03), (0.03, 0.055), (0.09, 0.075), (0.15, 0.105), (0.178, 0.14),
        (0.185, 0.142), (0.168, 0.13), (0.14, 0.105), (0.08, 0.085), (0.0, 0.08),
    ]  # fmt: skip
    lathe(room, "fruit bowl", at, bowl, ware, 40)
    orange = m.speckled("orange", (0.74, 0.26, 0.02), (0.60, 0.17, 0.01), 60.0, 0.4)
    apple = m.speckled("apple", (0.50, 0.035, 0.02), (0.60, 0.38, 0.06), 14.0, 0.2)
    green = m.speckled("pear", (0.42, 0.42, 0.06), (0.45, 0.25, 0.06), 20.0, 0.35)
    stalk = m.plain("stalk", (0.10, 0.06, 0.03), 0.8)
    for k, (x, y, z) in enumerate(
        (
            (-0.09, -0.05, 0.135),
            (-0.02, 0.09, 0.135),
            (0.085, -0.065, 0.135),
            (-0.005, -0.01, 0.205),
            (0.10, 0.05, 0.14),
        )
    ):
        skin = (orange, apple, apple, orange, orange)[k]
        fruit = ball(room, "fruit", at + Vector((x, y, z)), 0.043, skin, 4)
        fruit.scale = (1.0, 1.0, 0.93)
        fruit.rotation_euler = (dice.uniform(-0.5, 0.5), dice.uniform(-0.5, 0.5), 0.0)
        rod(
            room,
            "stalk",
            at + Vector((x, y, z + 0.034)),
            at + Vector((x + 0.008, y, z + 0.056)),
            0.003,
            stalk,
            sides=6,
        )
    pear = [
        (0.0, -0.045),
        (0.025, -0.04),
        (0.042, -0.012),
        (0.038, 0.015),
        (0.022, 0.045),
        (0.015, 0.062),
        (0.0, 0.07),
    ]
    for x, y, z, lean in ((-0.075, 0.055, 0.16, 0.7), (0.055, 0.0, 0.195, -0.9)):
        item = lathe(room, "pear", at + Vector((x, y, z)), pear, green, 20)
        item.rotation_euler = (lean, 0.4 * lean, 0.3)
    yellow = m.speckled("banana", (0.66, 0.46, 0.04), (0.25, 0.15, 0.03), 16.0, 0.45)
    for k in range(3):
        y = -0.115 + 0.024 * k
        points = [
            (-0.06, y, 0.165),
            (0.0, y - 0.022, 0.148),
            (0.07, y - 0.022, 0.152),
            (0.125, y + 0.01, 0.195),
        ]
        arc = [at + Vector(p) + Vector((0.0, 0.0, 0.016 * k)) for p in points]
        bent_tube(room, "banana", arc, [0.006, 0.018, 0.018, 0.007], yellow, 8)
    grape = m.plain("grape", (0.07, 0.015, 0.055), 0.2)
    for k in range(34):
        t = k / 33
        spread = 0.034 * (1.0 - 0.65 * t)
        x = 0.145 + 0.06 * t + dice.uniform(-spread, spread)
        y = 0.06 - 0.02 * t + dice.uniform(-spread, spread)
        z = 0.175 - 0.115 * t * t + dice.uniform(-0.5, 0.7) * spread
        ball(room, "grape", at + Vector((x, y, z)), 0.0125, grape, 2)


def _wine(room: Collection, top: Vector) -> None:
    """A bottle with its label, a carafe of water, salt and pepper, a small bunch of flowers."""
    glass = m.plain("bottle glass", (0.012, 0.03, 0.014), 0.08)
    bottle = [
        (0.0, 0.0), (0.036, 0.0), (0.038, 0.01), (0.038, 0.18), (0.03, 0.21), (0.015, 0.235), (0.014, 0.29),
        (0.017, 0.29), (0.017, 0.302), (0.0, 0.302),
    ]  # fmt: skip
    at = top + Vector((0.05, 0.215, 0.0))
    lathe(room, "bottle", at, bottle, glass, 24)
    paper = m.banded(
        "label", [(0.62, 0.57, 0.45), (0.62, 0.57, 0.45), (0.40, 0.05, 0.04), (0.62, 0.57, 0.45)], 0.7
    )
    lathe(room, "label", at, [(0.0388, 0.05), (0.0388, 0.14)], paper, 24)
    lathe(
        room,
        "capsule",
        at,
        [(0.0152, 0.24), (0.015, 0.285)],
        m.plain("capsule", (0.30, 0.02, 0.03), 0.3, 0.6),
        16,
    )
    clear = mt.glass("carafe", (0.90, 0.95, 0.95))
    carafe = [
        (0.0, 0.004),
        (0.05, 0.004),
        (0.066, 0.03),
        (0.06, 0.09),
        (0.028, 0.15),
        (0.024, 0.19),
        (0.034, 0.225),
    ]
    lathe(room, "carafe", top + Vector((0.20, -0.18, 0.0)), carafe, clear, 28)
    silver = mt.metal("cellar silver", (0.75, 0.73, 0.68), 0.2)
    pot = [(0.0, 0.0), (0.016, 0.0), (0.02, 0.03), (0.012, 0.05), (0.015, 0.058), (0.008, 0.068), (0.0, 0.07)]
    for k in (0, 1):
        lathe(room, "cellar", top + Vector((-0.17 + 0.055 * k, -0.19 - 0.02 * k, 0.0)), pot, silver, 16)


def _bread(room: Collection, at: Vector, dice: random.Random) -> None:
    """A basket with a napkin and rolls, leaning on the rim."""
    weave = mt.wicker("bread basket", (0.14, 0.07, 0.03), (0.42, 0.26, 0.11), 34.0)
    side = [
        (0.0, 0.004),
        (0.075, 0.004),
        (0.10, 0.05),
        (0.106, 0.066),
        (0.098, 0.066),
        (0.09, 0.05),
        (0.0, 0.012),
    ]
    lathe(room, "bread basket", at, side, weave, 28)
    ring(room, "basket rim", at + Vector((0, 0, 0.066)), 0.102, 0.008, weave)
    crust = m.speckled("crust", (0.42, 0.20, 0.06), (0.62, 0.42, 0.20), 26.0, 0.6)
    for k in range(5):
        a = 2.4 * k
        roll = ball(
            room,
            "roll",
            at + Vector((0.048 * math.cos(a), 0.048 * math.sin(a), 0.068 + 0.007 * k)),
            0.038,
            crust,
            3,
            0.0015,
            k,
        )
        roll.scale, roll.rotation_euler = (1.3, 0.9, 0.75), (0.2, dice.uniform(-0.3, 0.3), a)


def candles(
    room: Collection, lighting: Lighting, at: Place, radiance: float, colour: tuple[float, float, float]
) -> None:
    """Three candles in brass sticks. Their flames are bulbs in the shape of a drop."""
    brass = mt.metal("candlestick brass", (0.78, 0.54, 0.20), 0.2, 0.25)
    wax = m.plain("wax", (0.70, 0.64, 0.50), 0.45)
    wick = m.plain("wick", (0.02, 0.015, 0.01), 0.9)
    flames = []
    for k, (x, y, height) in enumerate(CANDLES):
        foot = Vector((at[0] + x, at[1] + y, TOP + 0.005))
        stick = [
            (0.056, 0.0), (0.052, 0.01), (0.02, 0.022), (0.012, 0.04), (0.02, height * 0.45),
            (0.01, height * 0.55), (0.018, height * 0.62), (0.009, height * 0.7), (0.014, height - 0.03),
            (0.03, height - 0.012), (0.03, height - 0.006), (0.014, height - 0.006),
        ]  # fmt: skip
        lathe(room, "candlestick", foot, stick, brass, 24)
        burnt = 0.17 - 0.035 * k
        tip = foot + Vector((0.0, 0.0, height + burnt))
        rod(room, "candle", foot + Vector((0, 0, height - 0.02)), tip, 0.0125, wax, 0.0115, sides=16)
        rod(room, "wick", tip, tip + Vector((0.002, 0, 0.014)), 0.002, wick, sides=6)
        flames.append(tip + Vector((0.0, 0.0, 0.030)))
    # One light for all three, at the middle of the row: fewer to sample, so less noise.
    flame = lighting.bulb("candles", "candle", flames[1], FLAME * math.sqrt(3.0), radiance, colour)
    for vertex in mesh_of(flame).vertices:  # a drop: round below, drawn out above
        vertex.co /= math.sqrt(3.0)
        rise = vertex.co.z / FLAME
        vertex.co.x *= 0.78 - 0.3 * rise
        vertex.co.y *= 0.78 - 0.3 * rise
        vertex.co.z *= 2.4 if rise > 0 else 1.2
    for place in (flames[0], flames[2]):
        copies(room, [flame], Matrix.Translation(place - flames[1]))


def branch(room: Collection, at: Place, dice: random.Random, height: float, name: str) -> None:
    """A sprig of leaves with berries, for a vase."""
    green = m.leaf(f"{name} leaf", (0.03, 0.07, 0.03), (0.15, 0.22, 0.11))
    bark = m.plain(f"{name} bark", (0.10, 0.06, 0.04), 0.8)
    berry = m.plain(f"{name} berry", (0.62, 0.10, 0.03), 0.3)
    for k in range(7):
        a = 2.4 * k + dice.uniform(-0.3, 0.3)
        lean = dice.uniform(0.10, 0.24)
        tip = Vector(at) + Vector((lean * math.cos(a), lean * math.sin(a), height * dice.uniform(0.75, 1.1)))
        middle = (Vector(at) + tip) / 2 + Vector((0, 0, 0.04))
        bent_tube(room, name, [at, middle, tip], [0.005, 0.004, 0.002], bark, 6, 4)
        for j in range(6):
            t = 0.35 + 0.65 * j / 5
            root = Vector(at).lerp(tip, t) + Vector((0, 0, 0.02))
            leaf_blade(room, "leaf", root, a + (1.1 if j % 2 else -1.1), 0.085, 0.035, green, 0.5, 0.5)
        ball(room, "berry", tip, 0.012, berry, 2)
