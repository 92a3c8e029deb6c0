# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands and hangs along the walls of ``sofa``: television, shelf, arc lamp, mirror, pictures."""

import math
import random

import bpy
from mathutils import Vector

from ..assets import Assets
from ..blender import mesh_of
from . import materials as m
from . import materials_upholstery as soft
from .lighting import Lighting
from .props import ball, box, lathe, repeated, rod
from .shapes import leaf, scatter
from .tubes import tube

Collection = bpy.types.Collection

BULB_RADIANCE = 400.0
SCREEN_RADIANCE = 5.0
#: Mean of the television's picture, of ``SCREEN_RADIANCE``.
SCREEN_COLOUR = (0.30, 0.12, 0.07)
WARM = (1.0, 0.70, 0.40)


def television(room: Collection, lighting: Lighting) -> None:
    """About the origin, looking to −Y: a slatted low board and the set on it, a speaker, a small clutter."""
    oak = m.wood("board oak", (0.13, 0.068, 0.032), (0.28, 0.165, 0.08), "X")
    dark = m.plain("board inside", (0.02, 0.015, 0.012), 0.8)
    wide, deep, z0, z1 = 1.42, 0.38, 0.12, 0.46
    for z in (z0, z1 - 0.03):
        box(room, "board", (0, 0, z + 0.015), (wide, deep, 0.03), oak, bevel=0.005)
    for x in (-wide / 2 + 0.015, wide / 2 - 0.015):
        box(room, "board side", (x, 0, (z0 + z1) / 2), (0.03, deep, z1 - z0), oak, bevel=0.005)
    box(room, "board back", (0, deep / 2 - 0.01, (z0 + z1) / 2), (wide, 0.02, z1 - z0), dark)
    slat = box(
        room, "slat", (-wide / 2 + 0.07, -deep / 2 + 0.012, (z0 + z1) / 2), (0.03, 0.018, z1 - z0 - 0.06), oak
    )
    repeated(slat, 13, (0.052, 0.0, 0.0), "along the front")
    for x in (-wide / 2 + 0.1, wide / 2 - 0.1):
        for y in (-0.12, 0.12):
            rod(room, "board foot", (x, y, 0.0), (x, y, z0), 0.012, dark, 0.018)
    for k in range(8):  # records in the open half
        tone = (0.05 + 0.07 * k, 0.35 - 0.04 * k, 0.10 + 0.05 * ((3 * k) % 5))
        box(
            room,
            "record",
            (0.12 + 0.032 * k, 0.0, 0.275),
            (0.022, 0.26, 0.24),
            m.plain(f"record {k}", tone, 0.6),
        )
    box(
        room,
        "amplifier",
        (0.52, -0.02, 0.20),
        (0.24, 0.28, 0.09),
        m.plain("amplifier", (0.55, 0.54, 0.52), 0.3, 1.0),
        bevel=0.006,
    )
    black = m.plain("set", (0.012, 0.012, 0.013), 0.25)
    w, h, cz = 1.16, 0.66, z1 + 0.41
    box(room, "set", (-0.04, 0.055, cz), (w + 0.03, 0.05, h + 0.03), black, bevel=0.008)
    for x in (-0.42, 0.34):
        rod(room, "set foot", (x, -0.06, z1 + 0.008), (x, 0.05, z1 + 0.09), 0.008, black)
        rod(room, "set foot", (x, 0.15, z1 + 0.008), (x, 0.05, z1 + 0.09), 0.008, black)
    film, strength = soft.evening_film("evening film", SCREEN_RADIANCE)
    screen = box(room, "screen", (-0.04, 0.0275, cz), (w, 0.004, h), film)
    for ray in ("diffuse", "transmission", "shadow"):
        setattr(screen, f"visible_{ray}", False)
    lighting.glow("screen", screen, strength)
    watts = math.pi * w * h * SCREEN_RADIANCE  # of a rectangle of that radiance
    lighting.area("screen light", (-0.04, 0.02, cz), (0.0, -1.0, 0.0), (w, h), watts, SCREEN_COLOUR, "screen")
    box(room, "speaker", (0.62, 0.0, z1 + 0.15), (0.13, 0.17, 0.30), oak, bevel=0.008)
    for z, r in ((0.09, 0.045), (0.21, 0.028)):
        rod(room, "cone", (0.62, -0.088, z1 + z), (0.62, -0.07, z1 + z), r, black, r * 0.8, 20)


def shelf(room: Collection, assets: Assets, dice: random.Random) -> None:
    """Iron frame and oak boards between television and sofa: books, vessels, a trailing plant on top."""
    iron = m.plain("shelf iron", (0.025, 0.025, 0.027), 0.4)
    oak = m.wood("shelf oak", (0.17, 0.09, 0.042), (0.36, 0.21, 0.10), "X")
    x0, x1, y0, y1, high = -0.66, 0.08, 1.98, 2.24, 1.86
    for x in (x0, x1):
        for y in (y0, y1):
            box(room, "shelf post", (x, y, high / 2), (0.022, 0.022, high), iron)
        rod(room, "shelf brace", (x, y1, 0.1), (x, y0, high - 0.1), 0.006, iron, sides=6)
    levels = (0.14, 0.56, 0.96, 1.36, 1.76)
    for z in levels:
        box(
            room,
            "shelf board",
            ((x0 + x1) / 2, (y0 + y1) / 2, z),
            (x1 - x0 + 0.03, y1 - y0 + 0.03, 0.028),
            oak,
            bevel=0.004,
        )
    colours = [
        (0.42, 0.06, 0.04), (0.04, 0.12, 0.28), (0.60, 0.50, 0.34), (0.07, 0.20, 0.13), (0.55, 0.30, 0.06),
        (0.08, 0.08, 0.09), (0.62, 0.60, 0.55), (0.30, 0.08, 0.17), (0.12, 0.30, 0.32),
    ]  # fmt: skip
    covers = [m.plain(f"cover {k}", colour, 0.5) for k, colour in enumerate(colours)]
    label = m.plain("label", (0.72, 0.60, 0.32), 0.4)
    for z, start, stop in (
        (0.56, x0 + 0.03, x0 + 0.46),
        (0.96, x0 + 0.27, x1 - 0.03),
        (1.36, x0 + 0.03, x0 + 0.40),
        (0.14, x0 + 0.2, x1 - 0.04),
    ):
        x = start
        while x < stop - 0.05:
            thick, tall, deep = dice.uniform(0.026, 0.052), dice.uniform(0.20, 0.29), dice.uniform(0.15, 0.19)
            at = (x + thick / 2, y0 + 0.01 + deep / 2, z + 0.014 + tall / 2)
            box(room, "spine", at, (thick - 0.003, deep, tall), dice.choice(covers), bevel=0.003)
            if dice.random() < 0.6:
                box(
                    room,
                    "label",
                    (at[0], y0 + 0.009, z + 0.014 + tall * 0.75),
                    (thick - 0.004, 0.005, 0.03),
                    label,
                )
            x += thick + 0.001
    urn = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.09, 0.07),
        (0.075, 0.16),
        (0.03, 0.21),
        (0.04, 0.25),
        (0.03, 0.25),
        (0.0, 0.2),
    ]
    y = y0 + 0.13
    lathe(
        room,
        "white vase",
        (x1 - 0.13, y, 0.574),
        urn,
        m.speckled("oat glaze", (0.62, 0.56, 0.46), (0.30, 0.22, 0.15), 30.0, 0.3),
    )
    lathe(
        room,
        "blue vase",
        (x0 + 0.14, y, 0.974),
        [(r * 1.15, h * 1.2) for r, h in urn],
        m.plain("cobalt", (0.015, 0.04, 0.26), 0.1),
    )
    lathe(
        room,
        "red vase",
        (x1 - 0.12, y, 1.374),
        [(r * 0.9, h) for r, h in urn],
        m.banded(
            "red bands",
            [
                (0.45, 0.08, 0.04),
                (0.64, 0.58, 0.48),
                (0.45, 0.08, 0.04),
                (0.05, 0.04, 0.04),
                (0.45, 0.08, 0.04),
            ],
        ),
    )
    ball(
        room,
        "brass ball",
        (x1 - 0.25, y - 0.03, 1.374 + 0.045),
        0.045,
        m.plain("ball brass", (0.8, 0.56, 0.22), 0.12, 1.0),
        4,
    )
    box(
        room,
        "basket",
        (x0 + 0.1, y, 0.25),
        (0.16, 0.2, 0.19),
        m.cloth("wicker", (0.40, 0.25, 0.10), (0.16, 0.08, 0.03), 9.0),
        bevel=0.02,
    )
    assets.place(
        "pot-plant",
        room,
        (x0 + 0.26, y, 1.774),
        (0.5, 0.4, 0.5),
        0.0,
        lambda: _trailing(room, Vector((x0 + 0.26, y, 1.774)), dice),
    )


def _trailing(room: Collection, at: Vector, dice: random.Random) -> None:
    """A pot on the top board whose vines hang over its edge; their leaves are geometry nodes' instances."""
    pot = [(0.0, 0.0), (0.07, 0.0), (0.095, 0.13), (0.10, 0.15), (0.085, 0.15), (0.08, 0.13), (0.0, 0.13)]
    lathe(room, "ivy pot", at, pot, m.plain("ivy pot", (0.40, 0.14, 0.07), 0.7))
    green = soft.foliage("ivy", (0.02, 0.08, 0.02), (0.10, 0.24, 0.05))
    blade = leaf("ivy leaf", 0.062, 0.05, green)
    vine = m.plain("vine", (0.10, 0.14, 0.04), 0.7)
    for k in range(13):
        a = math.radians(205 + 130 * k / 12) + dice.uniform(-0.15, 0.15)
        reach, drop = dice.uniform(0.17, 0.27), dice.uniform(0.15, 0.62)
        path = [at + Vector((0.03 * math.cos(a), 0.03 * math.sin(a), 0.13))]
        path.append(at + Vector((0.6 * reach * math.cos(a), 0.6 * reach * math.sin(a), 0.23)))
        for step in range(5):
            sway = 0.02 * math.sin(2.0 * step + k)
            path.append(
                at + Vector((reach * math.cos(a) + sway, reach * math.sin(a), 0.15 - drop * step / 4))
            )
        scatter(tube(room, f"vine {k}", path, 0.005, vine, 6), blade, 2200.0, (0.6, 1.2), 0.9, seed=k)


def arc_lamp(room: Collection, lighting: Lighting) -> None:
    """From a marble foot behind the sofa's arm a brass pole bends over the table; its bulb is bare."""
    brass = m.plain("lamp brass", (0.78, 0.53, 0.20), 0.18, 1.0)
    marble = m.plaster("lamp marble", (0.66, 0.64, 0.60), 0.5)
    foot, bulb = Vector((0.17, 2.02, 0.0)), Vector((0.52, 0.78, 1.60))
    rod(room, "lamp foot", foot, foot + Vector((0, 0, 0.06)), 0.11, marble, sides=32)
    away = Vector((bulb.x - foot.x, bulb.y - foot.y, 0.0))
    path = [foot + Vector((0, 0, 0.06)), foot + Vector((0, 0, 0.9))]
    for k in range(13):
        t = math.pi * k / 12
        path.append(
            foot
            + away * (0.5 - 0.5 * math.cos(t))
            + Vector((0, 0, 1.45 + 0.72 * math.sin(t) + 0.34 * t / math.pi))
        )
    path[-1] = bulb + Vector((0, 0, 0.16))
    tube(room, "lamp pole", path, 0.011, brass)
    rod(room, "lamp socket", bulb + Vector((0, 0, 0.04)), bulb + Vector((0, 0, 0.17)), 0.024, brass)
    lighting.bulb("arc", "arc", bulb, 0.05, BULB_RADIANCE, WARM)


def on_the_walls(room: Collection) -> None:
    """A round mirror over the sofa, pictures on the brick wall."""
    silver = m.plain("mirror", (0.90, 0.90, 0.90), 0.015, 1.0)
    gold = m.plain("mirror frame", (0.72, 0.48, 0.18), 0.3, 1.0)
    at = Vector((1.16, 2.285, 1.62))
    glass = rod(room, "mirror", at, at - Vector((0, 0.012, 0)), 0.36, silver, sides=64)
    mesh_of(glass).shade_flat()
    ring = [
        at + Vector((0.37 * math.cos(math.tau * k / 48), -0.012, 0.37 * math.sin(math.tau * k / 48)))
        for k in range(49)
    ]
    tube(room, "mirror frame", ring, 0.02, gold)
    oak = m.wood("frame", (0.06, 0.03, 0.015), (0.16, 0.08, 0.04), "Y")
    for k, (y, z, w, h) in enumerate(
        ((1.72, 1.62, 0.46, 0.6), (1.08, 1.52, 0.56, 0.42), (0.42, 1.62, 0.42, 0.56))
    ):
        box(room, "frame", (2.285, y, z), (0.03, w + 0.07, h + 0.07), oak, bevel=0.006)
        box(room, "mount", (2.268, y, z), (0.006, w, h), m.plain("mount", (0.68, 0.65, 0.58), 0.8))
        art = m.painting(f"picture {k}", "landscape" if k % 2 else "abstract")
        box(room, "picture", (2.264, y, z), (0.006, w - 0.12, h - 0.12), art)
    shore = m.painting("shore print", "landscape")
    prints = (
        soft.printed("arches print", "dots", [(0.62, 0.20, 0.08), (0.66, 0.58, 0.44)], 0.17),
        shore,
        soft.printed(
            "weave print", "diamonds", [(0.03, 0.10, 0.12), (0.66, 0.60, 0.48), (0.55, 0.30, 0.06)], 0.15
        ),
    )
    black = m.plain("print frame", (0.02, 0.018, 0.016), 0.35)
    for x, z, wide, high, art in (
        (-1.86, 1.72, 0.40, 0.54, prints[0]),
        (-1.32, 1.80, 0.50, 0.38, prints[1]),
        (-0.88, 1.70, 0.26, 0.36, prints[2]),
    ):
        box(room, "print frame", (x, 2.285, z), (wide, 0.03, high), black, bevel=0.006)
        box(
            room,
            "print mount",
            (x, 2.268, z),
            (wide - 0.05, 0.006, high - 0.05),
            m.plain("mount", (0.68, 0.65, 0.58), 0.8),
        )
        if art == shore:
            box(room, "print", (x, 2.264, z), (wide - 0.15, 0.006, high - 0.15), art)
        else:  # printed cloth lies in X and Y
            box(room, "print", (x, 2.264, z), (wide - 0.15, high - 0.15, 0.006), art, (math.pi / 2, 0, 0))
