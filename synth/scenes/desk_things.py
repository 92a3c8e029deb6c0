# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies and stands on the desk of ``desk``, and what is pinned above it. ``TOP`` is the desk's height."""

import math
import random

import bpy
from mathutils import Vector

from . import materials as m
from . import materials_desk as md
from .assembly import Assembly, disk, ring
from .greenery import arching, leaf_colour, leaf_mesh, trailing
from .lighting import Lighting
from .props import ball, box, lathe, repeated, rod, sheet
from .tubes import tube

Collection = bpy.types.Collection
Place = tuple[float, float, float]

TOP = 0.74
SCREEN_RADIANCE = 2.2
STRIP_POWER = 4.0  # watts of the coloured lamp behind the monitor
BULB_RADIANCE = 300.0
BULB_COLOUR = (1.0, 0.70, 0.40)


def computer(room: Collection, lighting: Lighting, foot: Place) -> None:
    """A monitor on an aluminium stand, keyboard and mouse.

    Its picture is the light of group ``screen``, with a strip of coloured lamps on its back.
    """
    monitor = Assembly(room, "monitor", foot, -0.06)
    steel = m.plain("monitor aluminium", (0.62, 0.63, 0.65), 0.28, 1.0)
    shell = m.plain("monitor shell", (0.03, 0.03, 0.033), 0.35)
    box(monitor, "monitor foot", (0.0, 0.02, 0.006), (0.24, 0.18, 0.012), steel, bevel=0.004)
    box(monitor, "monitor neck", (0.0, 0.07, 0.12), (0.05, 0.02, 0.24), steel, bevel=0.004)
    wide, high, middle = 0.555, 0.328, 0.285
    box(
        monitor,
        "monitor shell",
        (0.0, 0.012, middle),
        (wide + 0.026, 0.024, high + 0.032),
        shell,
        bevel=0.006,
    )
    picture, strength = md.screen("screen", SCREEN_RADIANCE)

    def face(u: float, v: float) -> Place:
        return (u - 0.5) * wide, -0.0015, middle + (v - 0.5) * high

    lighting.glow("screen", sheet(monitor, "screen", face, picture, steps=(1, 1)), strength)
    behind = (foot[0], foot[1] + 0.05, foot[2] + middle)
    strip = (wide - 0.1, high - 0.1)
    lighting.area("strip", behind, (0.0, 1.0, 0.0), strip, STRIP_POWER, (0.35, 0.55, 1.0), "screen")
    _keyboard(room, (foot[0] - 0.03, foot[1] - 0.32, TOP + 0.004))
    mouse = ball(room, "mouse", (foot[0] + 0.27, foot[1] - 0.33, TOP + 0.008), 0.05, shell, 3)
    mouse.scale = (0.62, 1.05, 0.52)


def _keyboard(room: Collection, foot: Place) -> None:
    """Five rows of keys, each one key repeated; orange ones at the ends."""
    board = Assembly(room, "keyboard", foot, 0.03, math.radians(4.0))
    case = m.plain("keyboard case", (0.42, 0.41, 0.39), 0.35, 0.7)
    white, grey = m.plain("key", (0.62, 0.60, 0.55), 0.5), m.plain("key grey", (0.15, 0.15, 0.15), 0.5)
    accent = m.plain("key accent", (0.75, 0.20, 0.03), 0.5)
    box(board, "keyboard case", (0.0, 0.0, 0.012), (0.45, 0.165, 0.018), case, bevel=0.005)
    pitch, size = 0.0295, (0.025, 0.025, 0.012)
    for row in range(5):
        y = 0.059 - pitch * row
        x = -0.207
        if row in (0, 2):
            box(board, "key", (x, y, 0.026), size, accent, bevel=0.003)
        else:
            box(board, "key", (x, y, 0.026), size, grey, bevel=0.003)
        if row < 4:
            count = 12
            repeated(
                box(board, "keys", (x + pitch, y, 0.026), size, white, bevel=0.003), count, (pitch, 0.0, 0.0)
            )
            last = x + pitch * (count + 1.28)
            box(
                board,
                "key",
                (last, y, 0.026),
                (0.041, 0.025, 0.012),
                accent if row == 2 else grey,
                bevel=0.003,
            )
        else:
            repeated(box(board, "keys", (x + pitch, y, 0.026), size, grey, bevel=0.003), 2, (pitch, 0.0, 0.0))
            box(
                board, "space bar", (x + pitch * 6, y, 0.026), (pitch * 6.8, 0.025, 0.012), white, bevel=0.003
            )
            repeated(
                box(board, "keys", (x + pitch * 10, y, 0.026), size, grey, bevel=0.003),
                4,
                (pitch * 1.1, 0.0, 0.0),
            )


def lamp(room: Collection, lighting: Lighting, foot: Place) -> None:
    """A jointed lamp of brass and black with a bare bulb."""
    brass = m.plain("lamp brass", (0.76, 0.53, 0.21), 0.22, 1.0)
    black = m.plain("lamp enamel", (0.02, 0.02, 0.022), 0.25)
    x, y, z = foot
    lathe(
        room,
        "lamp foot",
        foot,
        [(0.0, 0.0), (0.085, 0.0), (0.083, 0.014), (0.022, 0.026), (0.016, 0.05), (0.0, 0.05)],
        black,
        40,
    )
    elbow, head = Vector((x + 0.12, y + 0.06, z + 0.32)), Vector((x - 0.11, y - 0.04, z + 0.545))
    start = Vector((x, y, z + 0.05))
    for dx in (-0.010, 0.010):
        offset = Vector((0.0, dx, 0.0))
        rod(room, "lamp arm", start + offset, elbow + offset, 0.006, brass)
        rod(room, "lamp arm", elbow + offset, head + offset, 0.006, brass)
    for joint in (start, elbow, head):
        rod(
            room,
            "lamp joint",
            joint + Vector((0, -0.022, 0)),
            joint + Vector((0, 0.022, 0)),
            0.018,
            black,
            sides=20,
        )
    down = Vector((-0.25, -0.22, -0.94))
    rod(room, "lamp socket", head, head + down * 0.055, 0.024, brass, 0.020, 24)
    rod(room, "lamp neck", head + down * 0.055, head + down * 0.07, 0.018, black, 0.016, 20)
    lighting.bulb("lamp", "lamp", head + down * 0.096, 0.029, BULB_RADIANCE, BULB_COLOUR)
    slack = [
        (x + 0.08, y + 0.03, TOP + 0.004), (x + 0.18, y + 0.10, TOP + 0.004),
        (x + 0.22, y + 0.19, TOP + 0.004),
        (x + 0.25, y + 0.24, TOP - 0.03), (x + 0.25, y + 0.25, 0.3),
    ]  # fmt: skip
    tube(room, "lamp cable", slack, 0.0035, black, 6)


def mug(room: Collection, foot: Place) -> None:
    """A glazed mug of coffee on a cork coaster."""
    rod(room, "coaster", foot, (foot[0], foot[1], foot[2] + 0.006), 0.055, md.cork("coaster"), sides=32)
    at = Vector(foot) + Vector((0.0, 0.0, 0.006))
    glaze = m.banded(
        "mug glaze",
        [(0.36, 0.19, 0.10)] + [(0.10, 0.27, 0.30)] * 4 + [(0.62, 0.58, 0.48)] * 2 + [(0.10, 0.27, 0.30)] * 2,
        0.1,
    )
    profile = [
        (0.0, 0.0), (0.034, 0.0), (0.041, 0.012), (0.043, 0.05), (0.0425, 0.094), (0.0395, 0.096),
        (0.039, 0.05), (0.036, 0.014), (0.0, 0.010),
    ]  # fmt: skip
    lathe(room, "mug", at, profile, glaze, 40)
    disk(room, "coffee", at + Vector((0, 0, 0.078)), 0.0395, m.plain("coffee", (0.035, 0.012, 0.005), 0.06))
    ear = [
        at + Vector((0.041 + 0.034 * math.sin(a), -0.012 * math.sin(a), 0.05 + 0.029 * math.cos(a)))
        for a in [math.pi * k / 10 for k in range(11)]
    ]
    tube(room, "mug handle", ear, 0.006, glaze, 10)


def pens(room: Collection, foot: Place, dice: random.Random) -> None:
    """Pencils, a ruler and a brush in a tumbler of thin glass."""
    glass = md.thin_glass("tumbler")
    profile = [
        (0.0, 0.004),
        (0.030, 0.004),
        (0.034, 0.01),
        (0.039, 0.105),
        (0.0365, 0.105),
        (0.032, 0.014),
        (0.0, 0.012),
    ]
    lathe(room, "tumbler", foot, profile, glass, 36)
    colours = [
        (0.70, 0.42, 0.03),
        (0.55, 0.05, 0.04),
        (0.05, 0.14, 0.38),
        (0.08, 0.28, 0.12),
        (0.02, 0.02, 0.02),
        (0.6, 0.57, 0.5),
    ]
    tip = m.plain("pencil wood", (0.58, 0.38, 0.20), 0.8)
    for k, colour in enumerate(colours):
        angle = 2.0 * math.pi * k / len(colours) + dice.uniform(-0.3, 0.3)
        out = Vector((math.cos(angle), math.sin(angle), 0.0))
        start = Vector(foot) + out * 0.014 + Vector((0, 0, 0.014))
        axis = (out * 0.052 + Vector((0.0, 0.0, dice.uniform(0.16, 0.20)))) - out * 0.02
        rod(room, "pencil", start, start + axis, 0.0042, m.plain(f"pencil {k}", colour, 0.4), sides=6)
        rod(room, "pencil tip", start + axis, start + axis * 1.09, 0.0042, tip, 0.0008, 6)
    ruler = box(
        room,
        "ruler",
        Vector(foot) + Vector((-0.004, 0.008, 0.13)),
        (0.024, 0.002, 0.24),
        m.plain("ruler", (0.68, 0.69, 0.70), 0.25, 1.0),
    )
    ruler.rotation_euler = (-0.08, 0.14, 0.4)


def armillary(room: Collection, foot: Place) -> None:
    """A small armillary sphere of brass and steel: rings about a globe."""
    brass = m.plain("armillary brass", (0.80, 0.57, 0.24), 0.16, 1.0)
    steel = m.plain("armillary steel", (0.72, 0.73, 0.75), 0.12, 1.0)
    lathe(
        room, "armillary foot", foot,
        [
            (0.0, 0.0), (0.045, 0.0), (0.042, 0.008), (0.012, 0.02), (0.008, 0.05), (0.014, 0.06),
            (0.007, 0.075), (0.0, 0.08),
        ],
        brass, 32,
    )  # fmt: skip
    centre = Vector(foot) + Vector((0.0, 0.0, 0.145))
    for axis, radius, metal in (
        ((1.0, 0.25, 0.0), 0.072, brass),
        ((0.2, 1.0, 0.1), 0.069, brass),
        ((0.15, 0.1, 1.0), 0.072, brass),
        ((0.35, -0.2, 0.9), 0.064, steel),
    ):
        ring(room, "armillary ring", centre, radius, 0.0035, metal, axis)
    pole = Vector((0.35, -0.2, 0.9)).normalized() * 0.085
    rod(room, "armillary axis", centre - pole, centre + pole, 0.002, steel, sides=8)
    ball(room, "armillary globe", centre, 0.026, steel, 4)


def books(room: Collection, start: Place, dice: random.Random) -> None:
    """A row of books from ``start`` to the right, a steel bookend, two more lying on the desk."""
    colours = [
        (0.42, 0.05, 0.04), (0.62, 0.54, 0.38), (0.05, 0.11, 0.28), (0.06, 0.20, 0.12), (0.60, 0.32, 0.05),
        (0.10, 0.10, 0.11), (0.55, 0.53, 0.48), (0.10, 0.27, 0.30),
    ]  # fmt: skip
    gold = m.plain("title", (0.75, 0.58, 0.25), 0.3, 1.0)
    x, y, z = start
    for k, colour in enumerate(colours):
        thick, tall, deep = dice.uniform(0.022, 0.042), dice.uniform(0.19, 0.25), dice.uniform(0.14, 0.17)
        cover = m.plain(f"book {k}", colour, 0.5)
        lean = 0.0 if k < len(colours) - 1 else -0.13
        middle = x + thick / 2 + (0.016 if lean else 0.0)
        stand = Assembly(room, "book", (middle, y, z))
        stand.hub.rotation_euler = (0.0, lean, 0.0)
        box(stand, "book", (0.0, deep / 2, tall / 2), (thick - 0.002, deep, tall), cover, bevel=0.003)
        box(
            stand,
            "pages",
            (0.0, deep / 2 + 0.004, tall / 2),
            (thick - 0.008, deep - 0.004, tall + 0.0015),
            m.plain("pages", (0.62, 0.57, 0.45), 0.9),
        )
        for height in (0.80, 0.74, 0.16) if k % 2 == 0 else (0.70, 0.62):
            box(stand, "title", (0.0, -0.0005, tall * height), (thick - 0.006, 0.002, 0.007), gold)
        x += thick + 0.001
    end = m.plain("bookend", (0.62, 0.63, 0.65), 0.2, 1.0)
    box(room, "bookend", (start[0] - 0.004, y + 0.07, z + 0.08), (0.004, 0.13, 0.16), end)


def papers(room: Collection, dice: random.Random) -> None:
    """An open notebook with a fountain pen on the left, loose letters on the right, an apple."""
    place = Assembly(room, "notebook", (-0.44, -0.17, TOP), 0.16)
    for side in (-1, 1):

        def page(u: float, v: float, side: int = side) -> Place:
            swell = 0.020 * math.sin(math.pi * min(1.0, u * 1.15 + 0.04)) ** 0.55 * (1.0 - 0.35 * u)
            return side * 0.148 * u, (v - 0.5) * 0.21, 0.004 + swell

        sheet(place, "page", page, md.written(f"page {side}", seed=7.0 * side), steps=(16, 2))
    box(
        place,
        "notebook cover",
        (0.0, 0.0, 0.002),
        (0.305, 0.218, 0.004),
        md.leather("notebook", (0.16, 0.05, 0.03)),
    )
    lacquer, gold = m.plain("pen", (0.012, 0.012, 0.03), 0.12), m.plain("nib", (0.80, 0.58, 0.25), 0.2, 1.0)
    a, b = Vector((0.02, -0.05, 0.034)), Vector((0.14, 0.02, 0.030))
    rod(place, "pen", a, a.lerp(b, 0.55), 0.0058, lacquer, 0.0066, 14)
    rod(place, "pen band", a.lerp(b, 0.55), a.lerp(b, 0.59), 0.0070, gold, sides=14)
    rod(place, "pen cap", a.lerp(b, 0.59), b, 0.0068, lacquer, 0.005, 14)
    rod(place, "nib", a, a - (b - a) * 0.15, 0.004, gold, 0.0004, 8)
    for k in range(4):
        at = (
            0.52 + dice.uniform(-0.015, 0.015),
            -0.20 + dice.uniform(-0.012, 0.012),
            TOP + 0.0015 + 0.0015 * k,
        )
        item = box(
            room,
            "letter",
            at,
            (0.20, 0.28, 0.001),
            md.written(f"letter {k}", (0.04, 0.04, 0.05), 17.0, 3.0 * k),
        )
        item.rotation_euler = (0.0, 0.0, -0.18 + 0.13 * k)
    skin = m.speckled("apple", (0.45, 0.025, 0.015), (0.50, 0.12, 0.02), 45.0, 0.2)
    profile = [
        (0.0, 0.008),
        (0.014, 0.0),
        (0.03, 0.012),
        (0.039, 0.04),
        (0.035, 0.063),
        (0.018, 0.074),
        (0.005, 0.068),
        (0.0, 0.062),
    ]
    lathe(room, "apple", (0.60, -0.02, TOP), profile, skin, 32)
    tube(
        room,
        "apple stalk",
        [(0.60, -0.02, TOP + 0.062), (0.602, -0.02, TOP + 0.078), (0.608, -0.018, TOP + 0.088)],
        0.0016,
        m.plain("stalk", (0.12, 0.07, 0.03), 0.8),
        6,
    )


def plants(room: Collection, pot_foot: Place, dice: random.Random) -> None:
    """A lily in a pot on the desk."""
    pot = [
        (0.0, 0.0),
        (0.05, 0.0),
        (0.058, 0.012),
        (0.072, 0.105),
        (0.076, 0.108),
        (0.076, 0.118),
        (0.067, 0.118),
        (0.062, 0.1),
        (0.0, 0.1),
    ]
    lathe(
        room,
        "desk pot",
        pot_foot,
        pot,
        m.speckled("desk pot", (0.55, 0.26, 0.15), (0.40, 0.16, 0.09), 40.0, 0.7),
        36,
    )
    disk(
        room,
        "soil",
        Vector(pot_foot) + Vector((0, 0, 0.104)),
        0.066,
        m.fabric("soil", (0.02, 0.012, 0.008), (0.07, 0.045, 0.03), 60.0),
    )
    leaf, stem = (
        leaf_colour("lily leaf", (0.015, 0.07, 0.02), (0.09, 0.26, 0.06)),
        m.plain("lily stem", (0.10, 0.20, 0.05), 0.6),
    )
    blade = leaf_mesh(room, "lily blade", leaf, 0.46, 0.55, 0.02)
    foot = (pot_foot[0], pot_foot[1], pot_foot[2] + 0.10)
    arching(room, "lily", foot, blade, stem, dice, 30, 0.27, 0.13, 0.12)


def ivy(room: Collection, foot: Place, dice: random.Random) -> None:
    """A pot on a board, ivy hanging down from it."""
    oak = m.wood("board oak", (0.20, 0.10, 0.05), (0.42, 0.25, 0.12), "X", 8.0)
    x, y, z = foot
    box(room, "board", (x, y, z - 0.012), (0.62, 0.16, 0.024), oak, bevel=0.004)
    glaze = m.speckled("ivy pot", (0.55, 0.52, 0.45), (0.20, 0.24, 0.26), 35.0, 0.3)
    lathe(
        room, "ivy pot", foot, [(0.0, 0.0), (0.05, 0.0), (0.065, 0.09), (0.06, 0.09), (0.0, 0.08)], glaze, 32
    )
    leaf, stem = (
        leaf_colour("ivy leaf", (0.015, 0.06, 0.02), (0.10, 0.24, 0.07)),
        m.plain("ivy stem", (0.10, 0.12, 0.04), 0.7),
    )
    blade = leaf_mesh(room, "ivy blade", leaf, 0.8, 0.25)
    paths = []
    for k in range(9):
        side = -0.26 + 0.065 * k + dice.uniform(-0.02, 0.02)
        down = dice.uniform(0.14, 0.36)
        paths.append(
            [
                Vector((x, y, z + 0.085)),
                Vector((x + 0.5 * side, y - 0.05, z + 0.10)),
                Vector((x + side, y - 0.095, z + 0.01)),
                Vector((x + side + dice.uniform(-0.03, 0.03), y - 0.10, z - 0.5 * down)),
                Vector((x + side + dice.uniform(-0.05, 0.05), y - 0.085, z - down)),
            ]
        )
    trailing(room, "ivy", paths, blade, stem, dice, 0.024, 0.046)


def wall_clock(room: Collection, centre: Place) -> None:
    """A round clock in a chromed rim on the wall at y of ``centre``: half past ten."""
    clock = Assembly(room, "wall clock", centre)
    chrome = m.plain("clock chrome", (0.75, 0.76, 0.78), 0.1, 1.0)
    ink = m.plain("clock ink", (0.02, 0.02, 0.022), 0.5)
    white = m.plain("clock dial", (0.66, 0.63, 0.55), 0.4)
    disk(clock, "clock dial", (0.0, -0.02, 0.0), 0.125, white, (0.0, -1.0, 0.0))
    ring(clock, "clock rim", (0.0, -0.018, 0.0), 0.128, 0.014, chrome, (0.0, 1.0, 0.0))
    for k in range(12):
        s, c = math.sin(math.pi * k / 6), math.cos(math.pi * k / 6)
        inner, thick = (0.088, 0.0045) if k % 3 == 0 else (0.098, 0.0028)
        rod(
            clock, "hour", (inner * s, -0.022, inner * c), (0.111 * s, -0.022, 0.111 * c), thick, ink, sides=6
        )
    for angle, length, thick in ((2.0 * math.pi * 10.5 / 12, 0.062, 0.005), (math.pi, 0.095, 0.0035)):
        end = (length * math.sin(angle), -0.026, length * math.cos(angle))
        rod(clock, "hand", (0.0, -0.026, 0.0), end, thick, ink, sides=6)


def pin_board(room: Collection, centre: Place, size: tuple[float, float], dice: random.Random) -> None:
    """Cork in an oak frame: letters, notes, photographs, a map, each on its pin."""
    board = Assembly(room, "pin board", centre)
    wide, high = size
    oak = m.wood("frame oak", (0.22, 0.11, 0.05), (0.45, 0.27, 0.13), "X", 8.0)
    upright = m.wood("frame oak upright", (0.22, 0.11, 0.05), (0.45, 0.27, 0.13), "Z", 8.0)
    box(board, "cork", (0.0, 0.0, 0.0), (wide, 0.012, high), md.cork("cork"))
    for side in (-1, 1):
        box(
            board,
            "board frame",
            (0.0, -0.006, side * high / 2),
            (wide + 0.03, 0.028, 0.026),
            oak,
            bevel=0.004,
        )
        box(board, "board frame", (side * wide / 2, -0.006, 0.0), (0.026, 0.028, high), upright, bevel=0.004)
    cards = [
        (-0.22, 0.17, 0.14, 0.11, 0.06, m.painting("postcard", "landscape")),
        (-0.05, 0.15, 0.12, 0.16, -0.05, None),
        (0.16, 0.18, 0.17, 0.12, 0.03, m.painting("print", "abstract")),
        (-0.23, -0.02, 0.11, 0.13, -0.08, m.plain("note yellow", (0.75, 0.60, 0.12), 0.8)),
        (-0.08, -0.08, 0.13, 0.17, 0.05, None),
        (0.07, 0.00, 0.10, 0.10, 0.12, m.plain("note rose", (0.70, 0.22, 0.24), 0.8)),
        (
            0.20,
            -0.02,
            0.11,
            0.15,
            -0.10,
            m.speckled("map", (0.62, 0.60, 0.48), (0.16, 0.34, 0.42), 26.0, 0.8),
        ),
        (-0.22, -0.20, 0.16, 0.10, 0.02, m.painting("photograph", "landscape")),
        (0.06, -0.20, 0.10, 0.10, -0.06, m.plain("note blue", (0.20, 0.42, 0.60), 0.8)),
        (0.21, -0.20, 0.14, 0.10, 0.04, m.cloth("swatch", (0.45, 0.08, 0.06), (0.60, 0.52, 0.40), 14.0)),
    ]
    heads = [
        m.plain(f"pin {k}", c, 0.2)
        for k, c in enumerate([(0.7, 0.04, 0.03), (0.05, 0.2, 0.6), (0.75, 0.6, 0.05)])
    ]
    for k, (x, z, w, h, turn, paint) in enumerate(cards):
        c, s, curl = math.cos(turn), math.sin(turn), dice.uniform(0.006, 0.018)

        def paper(
            u: float,
            v: float,
            x: float = x,
            z: float = z,
            w: float = w,
            h: float = h,
            c: float = c,
            s: float = s,
            curl: float = curl,
        ) -> Place:
            a, b = (u - 0.5) * w, -v * h
            return (
                x + a * c - b * s,
                -0.009 - curl * v * v - 0.3 * curl * (2 * u - 1) ** 2 * v,
                z + h / 2 + a * s + b * c,
            )

        if paint is None:
            paint = md.written(f"pinned {k}", (0.05, 0.05, 0.06), 12.0, 5.0 * k)
            paint_object = sheet(
                board,
                "pinned",
                lambda u, v, w=w, h=h, curl=curl: ((u - 0.5) * w, (v - 0.5) * h, curl * (1.0 - v) ** 2),
                paint,
                steps=(4, 8),
            )
            paint_object.location, paint_object.rotation_euler = (x, -0.009, z), (math.pi / 2, turn, 0.0)
        else:
            sheet(board, "pinned", paper, paint, steps=(4, 8))
        ball(board, "pin", (x - 0.46 * h * s, -0.018, z + 0.46 * h * c), 0.0085, heads[k % 3], 2)
