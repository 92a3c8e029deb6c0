# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in ``bathroom``: washstand and mirror, bathtub, shelf, towels, plants, stool, door."""

import itertools
import math
import random

import bpy
from mathutils import Matrix, Vector

from ..assets import Assets
from ..blender import Point
from . import materials as m
from . import materials_bathroom as mb
from . import plush
from .curved import leaf_tuft
from .props import ball, box, lathe, leaf_blade, modified, rod, sheet
from .small_room import Room
from .tubes import bent_tube

Collection = bpy.types.Collection
Material = bpy.types.Material

MIRROR = (-0.46, 1.66)  # its middle, x and z
MIRROR_SIZE = (0.66, 0.78)
WASHSTAND = (-0.46, 1.33)  # x, y of its middle
TOP = 0.84  # height of the washstand
TUB = (1.06, 1.04)  # x, y of its middle
TUB_HALF = (0.76, 0.37)
RIM = 0.60  # height of the tub's rim
TRAY = 0.85  # x of the tray's middle

BULB_RADIUS = 0.042
BULBS = [
    (MIRROR[0] + side * (MIRROR_SIZE[0] / 2 + 0.13), 1.475, MIRROR[1] + dz)
    for side in (-1, 1)
    for dz in (-0.17, 0.17)
]
FLAMES = [(TRAY - 0.02, TUB[1] + 0.17, RIM + 0.185), (TRAY + 0.05, TUB[1] + 0.25, RIM + 0.135)]


def furnish(room: Collection, at: Room, assets: Assets, dice: random.Random) -> None:
    """Put everything in its place (metres, the room's own axes)."""
    brass = m.plain("brass", (0.72, 0.48, 0.18), 0.22, 1.0)
    chrome = m.plain("chrome", (0.66, 0.67, 0.68), 0.14, 1.0)
    enamel = m.plain("enamel", (0.70, 0.69, 0.65), 0.1)

    def tub() -> None:
        _bathtub(room, enamel, brass)

    def basin() -> None:
        _basin(room, enamel)

    assets.place("bathtub", room, (*TUB, 0.0), (2 * TUB_HALF[0], 2 * TUB_HALF[1], RIM), 0.0, tub)
    _bath_taps(room, brass)
    _tray(room)
    _washstand(room, brass)
    assets.place("washbasin", room, (WASHSTAND[0], WASHSTAND[1], TOP), (0.5, 0.38, 0.14), 0.0, basin)
    _basin_tap(room, brass)
    _mirror(room, at, brass)
    _toilet_things(room, dice)
    _shelf(room, dice)
    _towels(room, at, chrome)
    _stool(room)
    _plants(room, dice)
    _curtain(room, at, brass)
    _door(room, at, brass)
    mat = box(
        room,
        "bath mat",
        (0.72, 0.28, 0.012),
        (0.86, 0.52, 0.024),
        plush.pelt("bath mat", (0.30, 0.10, 0.07), (0.58, 0.26, 0.18)),
    )
    mat.rotation_euler.z = math.radians(-7.0)
    plush.tufted(mat, 0.024, 0.009, 16000.0, 0.4, 0.0, 5)


def _oval(turn: float, half: Point, power: float = 2.6) -> tuple[float, float]:
    """A superellipse: rounder than a box, fuller than an ellipse."""
    c, s = math.cos(turn), math.sin(turn)
    return (
        half[0] * math.copysign(abs(c) ** (2 / power), c),
        half[1] * math.copysign(abs(s) ** (2 / power), s),
    )


def _bathtub(room: Collection, enamel: Material, brass: Material) -> None:
    """Cast iron: painted outside, white inside, a rolled rim, four feet."""
    paint = m.plain("tub paint", (0.025, 0.075, 0.075), 0.3)
    outside = [(0.0, 0.13), (0.55, 0.13), (0.78, 0.17), (0.88, 0.30), (0.93, 0.45), (0.95, RIM - 0.03)]
    inside = [
        (0.95, RIM - 0.03),
        (0.985, RIM - 0.025),
        (1.0, RIM - 0.005),
        (0.985, RIM + 0.008),
        (0.93, RIM),
        (0.89, RIM - 0.05),
    ]
    inside += [(0.85, 0.42), (0.78, 0.28), (0.62, 0.20), (0.0, 0.18)]
    for name, profile, material in (("tub", outside, paint), ("tub enamel", inside, enamel)):

        def surface(u: float, v: float, profile: list[tuple[float, float]] = profile) -> Point:
            x, y = _oval(2.0 * math.pi * u, TUB_HALF)
            k = min(int(v * (len(profile) - 1)), len(profile) - 2)
            t = v * (len(profile) - 1) - k
            (r0, z0), (r1, z1) = profile[k], profile[k + 1]
            r, z = r0 + (r1 - r0) * t, z0 + (z1 - z0) * t
            slipper = 0.10 * max(x / TUB_HALF[0], 0.0) ** 2 * max(z - 0.3, 0.0) / 0.3  # its head rises
            return TUB[0] + x * r, TUB[1] + y * r, z + slipper

        shell = sheet(room, name, surface, material, steps=(64, 3 * (len(profile) - 1)))
        modified(shell, "weld", "WELD", merge_threshold=1e-4)
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = TUB[0] + sx * 0.48, TUB[1] + sy * 0.22
            ball(room, "tub claw", (x + sx * 0.03, y + sy * 0.02, 0.036), 0.036, brass, 2)
            rod(room, "tub foot", (x + sx * 0.03, y + sy * 0.02, 0.05), (x, y, 0.17), 0.026, brass, 0.045)


def _bath_taps(room: Collection, brass: Material) -> None:
    """Standing pipes at the tub's left end, with two cross handles and a spout."""
    x, y, top = TUB[0] - TUB_HALF[0] - 0.07, TUB[1], RIM + 0.20
    for dy in (-0.07, 0.07):
        rod(room, "riser", (x, y + dy, 0.0), (x, y + dy, top), 0.013, brass)
        rod(room, "rosette", (x, y + dy, 0.0), (x, y + dy, 0.015), 0.035, brass)
        rod(room, "valve", (x, y + dy, top - 0.02), (x, y + dy, top + 0.05), 0.02, brass)
        for turn in (0.3, 0.3 + math.pi / 2):
            arm = Vector((math.cos(turn), math.sin(turn), 0.0)) * 0.04
            hub = Vector((x, y + dy, top + 0.06))
            rod(room, "cross", hub - arm, hub + arm, 0.008, brass)
    rod(room, "bridge", (x, y - 0.09, top), (x, y + 0.09, top), 0.016, brass)
    spout = [(x, y, top), (x + 0.06, y, top + 0.03), (x + 0.13, y, top + 0.01), (x + 0.155, y, top - 0.06)]
    bent_tube(room, "bath spout", spout, 0.014, brass)
    hose = [(x, y + 0.02, top), (x - 0.05, y + 0.05, top + 0.15), (x - 0.02, y + 0.06, top + 0.34)]
    bent_tube(room, "shower pipe", [*hose, (x + 0.06, y + 0.05, top + 0.43)], 0.009, brass)
    rod(
        room,
        "shower head",
        (x + 0.05, y + 0.05, top + 0.45),
        (x + 0.10, y + 0.05, top + 0.38),
        0.018,
        brass,
        0.05,
    )


def _tray(room: Collection) -> None:
    """Across the tub: a board with a soap, a brush, an open book and two candles."""
    teak = m.wood("tray teak", (0.20, 0.09, 0.04), (0.42, 0.22, 0.10), "Y")
    for k in range(4):
        box(
            room,
            "tray slat",
            (TRAY - 0.105 + 0.07 * k, TUB[1], RIM + 0.03),
            (0.055, 0.86, 0.018),
            teak,
            bevel=0.004,
        )
    wax = m.plain("wax", (0.72, 0.62, 0.46), 0.5)
    for (x, y, z), radius in zip(FLAMES, (0.034, 0.028), strict=True):
        rod(room, "candle", (x, y, RIM + 0.04), (x, y, z - 0.03), radius, wax, sides=20)
        rod(
            room,
            "wick",
            (x, y, z - 0.035),
            (x, y, z - 0.012),
            0.003,
            m.plain("wick", (0.02, 0.02, 0.02)),
            sides=6,
        )
    dish = [(0.0, 0.0), (0.04, 0.0), (0.058, 0.022), (0.052, 0.022), (0.036, 0.008), (0.0, 0.008)]
    lathe(
        room, "soap dish", (TRAY, TUB[1] - 0.26, RIM + 0.04), dish, m.plain("dish", (0.05, 0.20, 0.26), 0.15)
    )
    soap = m.plain("soap", (0.62, 0.38, 0.34), 0.4)
    box(room, "soap", (TRAY, TUB[1] - 0.26, RIM + 0.062), (0.06, 0.04, 0.028), soap, (0, 0, 0.5), 0.012)
    paper = m.plain("pages", (0.62, 0.59, 0.50), 0.8)
    for side in (-1, 1):
        centre = (TRAY + 0.005, TUB[1] - 0.06 + side * 0.058, RIM + 0.053)
        box(room, "page", centre, (0.17, 0.115, 0.018), paper, (side * 0.12, 0, 0.0), 0.004)


def _washstand(room: Collection, brass: Material) -> None:
    """A frame of walnut with two drawers under a marble slab; open below, with towels and a basket."""
    walnut = m.wood("walnut", (0.055, 0.026, 0.014), (0.15, 0.075, 0.038), "X")
    upright = m.wood("walnut upright", (0.055, 0.026, 0.014), (0.15, 0.075, 0.038), "Z")
    cx, cy = WASHSTAND
    width, depth = 1.16, 0.50
    slab = mb.marble("marble", (0.62, 0.60, 0.57), (0.17, 0.17, 0.18))
    box(room, "slab", (cx, cy, TOP - 0.018), (width + 0.05, depth + 0.04, 0.036), slab, bevel=0.006)
    box(
        room,
        "splash",
        (cx, cy + depth / 2 + 0.005, TOP + 0.06),
        (width + 0.05, 0.022, 0.12),
        slab,
        bevel=0.004,
    )
    box(room, "carcass", (cx, cy + 0.02, TOP - 0.136), (width - 0.06, depth - 0.06, 0.20), walnut)
    for side in (-1, 1):
        front = (cx + side * (width / 4 - 0.005), cy - depth / 2 + 0.028, TOP - 0.136)
        box(room, "drawer", front, (width / 2 - 0.09, 0.03, 0.155), walnut, bevel=0.006)
        for dx in (-0.11, 0.11):
            knob = (front[0] + dx, front[1] - 0.03, front[2])
            ball(room, "knob", knob, 0.016, brass, 2)
        for dy in (-depth / 2 + 0.035, depth / 2 - 0.035):
            x, y = cx + side * (width / 2 - 0.035), cy + dy
            box(room, "leg", (x, y, (TOP - 0.036) / 2), (0.052, 0.052, TOP - 0.036), upright, bevel=0.006)
    for k in range(6):
        y = cy - depth / 2 + 0.05 + 0.08 * k
        box(room, "low shelf", (cx, y, 0.17), (width - 0.08, 0.062, 0.02), walnut)
    dark = m.plain("back panel", (0.022, 0.018, 0.016), 0.8)
    box(room, "back panel", (cx, cy + depth / 2 - 0.015, 0.40), (width - 0.08, 0.015, 0.46), dark)
    colours = [(0.44, 0.21, 0.05), (0.50, 0.47, 0.40), (0.06, 0.17, 0.18), (0.42, 0.12, 0.08)]
    for k, colour in enumerate(colours):
        towel = mb.terry(f"folded towel {k}", colour, colour)
        at = (cx + 0.30, cy - 0.04, 0.212 + 0.062 * k)
        box(room, "folded towel", at, (0.36 - 0.012 * k, 0.30, 0.056), towel, (0, 0, 0.04 * (-1) ** k), 0.024)
    _basket(room, (cx - 0.28, cy - 0.02, 0.18), 0.17, 0.24)


def _basket(room: Collection, foot: tuple[float, float, float], radius: float, height: float) -> None:
    """Coiled rope: rings that bulge."""
    straw = m.cloth("basket", (0.36, 0.22, 0.09), (0.17, 0.09, 0.035), 9.0)
    profile = [(0.0, 0.0), (radius * 0.82, 0.0)]
    for k in range(33):
        t = k / 32
        profile.append(
            (radius * (0.84 + 0.2 * math.sin(1.9 * t)) + 0.005 * math.sin(16 * math.pi * t), height * t)
        )
    profile += [(radius * 0.9, height), (radius * 0.8, 0.02), (0.0, 0.02)]
    lathe(room, "basket", foot, profile, straw)


def _basin(room: Collection, enamel: Material) -> None:
    """An oval bowl on the slab."""
    profile = [
        (0.0, 0.0),
        (0.55, 0.0),
        (0.78, 0.03),
        (0.93, 0.08),
        (1.0, 0.135),
        (0.985, 0.142),
        (0.95, 0.138),
    ]
    profile += [(0.88, 0.09), (0.70, 0.045), (0.4, 0.025), (0.0, 0.02)]
    bowl = lathe(room, "basin", (WASHSTAND[0], WASHSTAND[1] - 0.03, TOP), profile, enamel, 48)
    bowl.scale = (0.25, 0.185, 1.0)


def _basin_tap(room: Collection, brass: Material) -> None:
    """A gooseneck behind the basin, with two handles."""
    x, y = WASHSTAND[0], WASHSTAND[1] + 0.185
    neck = [
        (x, y, TOP),
        (x, y, TOP + 0.19),
        (x, y - 0.03, TOP + 0.265),
        (x, y - 0.09, TOP + 0.27),
        (x, y - 0.13, TOP + 0.20),
    ]
    bent_tube(room, "gooseneck", neck, 0.013, brass)
    rod(room, "rosette", (x, y, TOP), (x, y, TOP + 0.02), 0.03, brass)
    for side in (-1, 1):
        at = Vector((x + side * 0.12, y, TOP))
        rod(room, "tap body", at, at + Vector((0, 0, 0.06)), 0.016, brass)
        rod(room, "tap foot", at, at + Vector((0, 0, 0.012)), 0.027, brass)
        for turn in (0.4 * side, 0.4 * side + math.pi / 2):
            arm = Vector((math.cos(turn), math.sin(turn), 0.0)) * 0.036
            hub = at + Vector((0, 0, 0.07))
            rod(room, "tap cross", hub - arm, hub + arm, 0.007, brass)


def _mirror(room: Collection, at: Room, brass: Material) -> None:
    """A real mirror in a brass frame, a glass shelf under it, two bars with bare bulbs."""
    (cx, cz), (w, h), y = MIRROR, MIRROR_SIZE, at.back - 0.03
    box(room, "mirror", (cx, y, cz), (w, 0.012, h), mb.mirror("mirror"))
    box(
        room,
        "mirror back",
        (cx, y + 0.016, cz),
        (w + 0.02, 0.018, h + 0.02),
        m.plain("mirror back", (0.1, 0.07, 0.05)),
    )
    for dx, dz, sx, sz in (
        (0, h / 2, w + 0.05, 0.026),
        (0, -h / 2, w + 0.05, 0.026),
        (w / 2, 0, 0.026, h),
        (-w / 2, 0, 0.026, h),
    ):
        box(room, "mirror frame", (cx + dx, y - 0.004, cz + dz), (sx, 0.034, sz), brass, bevel=0.007)
    for side in (-1, 1):
        x = BULBS[0][0] if side < 0 else BULBS[2][0]
        rod(room, "lamp bar", (x, y, cz - 0.27), (x, y, cz + 0.27), 0.022, brass)
    for x, by, z in BULBS:
        rod(room, "socket", (x, y, z), (x, by + BULB_RADIUS * 0.8, z), 0.018, brass, 0.024)


def _bottle(room: Collection, foot: Point, scale: Point, glass: Material, stopper: Material) -> None:
    """Thin glass, half full of something, with a stopper."""
    r, h = scale
    profile = [(0.0, 0.002), (r, 0.002), (r, 0.6 * h), (0.35 * r, 0.78 * h), (0.32 * r, h)]
    lathe(room, "bottle", foot, profile, glass, 20)
    ball(room, "stopper", (foot[0], foot[1], foot[2] + h), 0.42 * r, stopper, 2)


def _glasses() -> list[Material]:
    return [
        mb.thin_glass(f"glass {k}", tint)
        for k, tint in enumerate(
            [(0.35, 0.70, 0.62), (0.80, 0.45, 0.12), (0.75, 0.80, 0.82), (0.25, 0.38, 0.75)]
        )
    ]


def _toilet_things(room: Collection, dice: random.Random) -> None:
    """On the slab and on the glass shelf: bottles, a cup with brushes, a soap pump, a small succulent."""
    glasses, dark = _glasses(), m.plain("stopper", (0.04, 0.03, 0.03), 0.3)
    cx, cy = WASHSTAND
    for k, (dx, dy, r, h) in enumerate(
        (
            (0.36, 0.14, 0.035, 0.17),
            (0.44, 0.08, 0.028, 0.12),
            (0.50, 0.15, 0.04, 0.22),
            (0.40, 0.0, 0.022, 0.10),
        )
    ):
        _bottle(room, (cx + dx, cy + dy, TOP), (r, h), glasses[k], dark)
    cup = [(0.0, 0.0), (0.034, 0.0), (0.038, 0.1), (0.033, 0.1), (0.03, 0.01), (0.0, 0.01)]
    white = m.banded("cup", [(0.62, 0.60, 0.54), (0.05, 0.16, 0.30), (0.62, 0.60, 0.54)])
    foot = Vector((cx - 0.36, cy + 0.12, TOP))
    lathe(room, "cup", foot, cup, white)
    for k, colour in enumerate([(0.65, 0.12, 0.06), (0.05, 0.35, 0.42)]):
        brush = m.plain(f"toothbrush {k}", colour, 0.3)
        tip = foot + Vector((0.04 * (-1) ** k, 0.02 * k, 0.19))
        rod(room, "toothbrush", foot + Vector((0, 0, 0.02)), tip, 0.006, brush, sides=8)
        box(room, "bristles", tip, (0.012, 0.02, 0.03), m.plain("bristles", (0.7, 0.7, 0.66)), (0, 0.2, 0))
    pump = [(0.0, 0.0), (0.04, 0.0), (0.042, 0.1), (0.03, 0.13), (0.014, 0.14), (0.014, 0.16), (0.0, 0.16)]
    at = Vector((cx - 0.46, cy + 0.02, TOP))
    lathe(room, "soap pump", at, pump, m.speckled("pump glaze", (0.10, 0.26, 0.24), (0.30, 0.44, 0.38), 40.0))
    rod(
        room, "pump spout", at + Vector((0, 0, 0.175)), at + Vector((0.02, -0.05, 0.17)), 0.007, dark, sides=8
    )
    rod(room, "pump stem", at + Vector((0, 0, 0.15)), at + Vector((0, 0, 0.18)), 0.006, dark, sides=8)
    hand = mb.terry("hand towel", (0.48, 0.45, 0.38), (0.40, 0.14, 0.07))

    def draped(u: float, v: float) -> Point:
        path = v * 0.42 - 0.10  # over the slab's edge
        y = cy - 0.275
        x = cx - 0.47 + 0.17 * u + 0.01 * math.sin(9 * v)
        if path < 0:
            return x, y - path, TOP + 0.006
        return x, y - 0.006 - 0.008 * math.sin(7 * u + 1.0), TOP + 0.004 - path

    sheet(room, "hand towel", draped, hand, steps=(14, 24), thickness=0.008)


def _shelf(room: Collection, dice: random.Random) -> None:
    """Left of the washstand: an open rack with jars, rolled towels, a radio, a fern on top."""
    pine = m.wood("rack pine", (0.26, 0.14, 0.06), (0.46, 0.28, 0.14), "X")
    post = m.wood("rack post", (0.26, 0.14, 0.06), (0.46, 0.28, 0.14), "Z")
    x0, x1, y0, y1 = -1.83, -1.21, 1.24, 1.56
    heights = (0.14, 0.56, 0.98, 1.40)
    cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
    for x in (x0, x1):
        for y in (y0, y1):
            box(room, "rack post", (x, y, 0.73), (0.032, 0.032, 1.46), post, bevel=0.004)
    for z in heights:
        for k in range(4):
            box(room, "rack board", (cx, y0 + 0.035 + 0.083 * k, z), (x1 - x0, 0.07, 0.018), pine)
    rolls = [
        mb.terry(f"rolled {k}", c, c)
        for k, c in enumerate([(0.50, 0.46, 0.38), (0.05, 0.17, 0.18), (0.44, 0.21, 0.05)])
    ]
    z = heights[1] + 0.009
    for k, (dx, dz) in enumerate(
        ((-0.19, 0.06), (-0.065, 0.06), (0.06, 0.06), (-0.125, 0.165), (0.0, 0.165))
    ):
        rod(
            room,
            "rolled towel",
            (cx + dx, y0 + 0.02, z + dz),
            (cx + dx, y1 - 0.03, z + dz),
            0.058,
            rolls[k % 3],
            sides=20,
        )
    glasses, dark = _glasses(), m.plain("rack stopper", (0.05, 0.04, 0.03), 0.4)
    z, x = heights[2] + 0.009, x0 + 0.07
    for k in range(7):
        r = dice.uniform(0.024, 0.042)
        _bottle(
            room,
            (x + r, cy - 0.03 + dice.uniform(-0.04, 0.04), z),
            (r, dice.uniform(0.10, 0.26)),
            glasses[k % 4],
            dark,
        )
        x += 2 * r + 0.012
    _basket(room, (cx, cy, heights[0] + 0.01), 0.15, 0.2)
    sponge = m.speckled("sponge", (0.55, 0.40, 0.12), (0.25, 0.15, 0.04), 60.0, 0.9)
    ball(room, "sponge", (cx + 0.21, cy - 0.04, heights[1] + 0.07), 0.062, sponge, 3, 0.008)
    pot = [(0.0, 0.0), (0.07, 0.0), (0.10, 0.14), (0.105, 0.16), (0.092, 0.16), (0.088, 0.14), (0.0, 0.14)]
    foot = (cx - 0.06, cy, heights[3] + 0.009)
    lathe(room, "fern pot", foot, pot, m.plaster("terracotta", (0.42, 0.17, 0.09), 0.4))
    leaf_tuft(room, (foot[0], foot[1], foot[2] + 0.14), 30, (0.26, 0.40), 0.055, 1.05, dice)
    canister = m.plain("canister", (0.60, 0.62, 0.62), 0.25, 1.0)
    rod(
        room,
        "canister",
        (x1 - 0.10, cy, heights[3] + 0.009),
        (x1 - 0.10, cy, heights[3] + 0.14),
        0.055,
        canister,
        sides=24,
    )


def _plants(room: Collection, dice: random.Random) -> None:
    """One hangs before the window, one stands in the right corner."""
    at = Vector((1.50, 1.30, 1.72))
    rope = m.plain("rope", (0.42, 0.33, 0.20), 0.9)
    pot = [(0.0, 0.0), (0.06, 0.01), (0.10, 0.06), (0.105, 0.13), (0.094, 0.13), (0.09, 0.11), (0.0, 0.11)]
    lathe(room, "hanging pot", at, pot, m.plain("pot glaze", (0.60, 0.56, 0.46), 0.2))
    for k in range(3):
        turn = 2.0 * math.pi * k / 3 + 0.4
        rod(
            room,
            "rope",
            at + Vector((0.1 * math.cos(turn), 0.1 * math.sin(turn), 0.12)),
            (at.x, at.y, 2.5),
            0.005,
            rope,
            sides=6,
        )
    leaf_tuft(room, at + Vector((0, 0, 0.11)), 26, (0.20, 0.34), 0.045, 0.75, dice)
    vine = m.leaf("vine", (0.03, 0.10, 0.02), (0.16, 0.34, 0.09))
    stem = m.plain("vine stem", (0.10, 0.15, 0.04), 0.6)
    for k in range(4):
        turn = 1.7 * k + 0.6
        start = at + Vector((0.1 * math.cos(turn), 0.1 * math.sin(turn), 0.12))
        joints = [start + Vector((0.05 * math.cos(turn), 0.05 * math.sin(turn), 0.02))]
        for _ in range(6):
            joints.append(joints[-1] + Vector((dice.uniform(-0.02, 0.02), dice.uniform(-0.02, 0.02), -0.07)))
        bent_tube(room, "vine stem", [start, *joints], 0.004, stem)
        for joint in joints:
            for _ in range(2):
                leaf_blade(room, "vine leaf", joint, dice.uniform(0, 6.28), 0.075, 0.06, vine, 0.2, 0.6)
    big = Vector((1.72, 0.22, 0.0))
    tall = [(0.0, 0.0), (0.10, 0.0), (0.15, 0.22), (0.155, 0.26), (0.14, 0.26), (0.13, 0.23), (0.0, 0.23)]
    lathe(room, "pot", big, tall, m.speckled("pot", (0.06, 0.12, 0.16), (0.20, 0.30, 0.30), 18.0, 0.3))
    leaf_tuft(room, big + Vector((0, 0, 0.22)), 30, (0.34, 0.52), 0.07, 1.35, dice)


def _towels(room: Collection, at: Room, chrome: Material) -> None:
    """A ladder of chrome on the left wall with two towels; one more over the tub's rim."""
    x, y0, y1 = -at.half + 0.09, 0.15, 0.72
    for y in (y0, y1):
        rod(room, "warmer post", (x, y, 0.55), (x, y, 1.75), 0.016, chrome)
        for z in (0.62, 1.68):
            rod(room, "warmer arm", (x, y, z), (-at.half, y, z), 0.012, chrome)
    rungs = [0.66 + 0.13 * k for k in range(9)]
    for z in rungs:
        rod(room, "warmer rung", (x, y0, z), (x, y1, z), 0.011, chrome)
    for name, ground, band, z, (a, b), drop in (
        ("bath towel", (0.46, 0.22, 0.04), (0.58, 0.50, 0.36), rungs[7], (0.20, 0.50), 0.62),
        ("small towel", (0.05, 0.19, 0.20), (0.50, 0.46, 0.38), rungs[4], (0.47, 0.68), 0.36),
    ):

        def hanging(
            u: float, v: float, z: float = z, a: float = a, b: float = b, drop: float = drop
        ) -> Point:
            path = v * (drop + 0.32) - 0.30  # behind the rung, over it, down in front
            y = a + (b - a) * u
            ripple = 0.008 * math.sin(13 * u + 2.0 * v)
            out = 0.022 if path > 0 else -0.022
            return x + out + ripple * min(1.0, 4 * abs(path)), y, z + 0.012 - abs(path)

        sheet(room, name, hanging, mb.terry(name, ground, band), steps=(20, 30), thickness=0.008)
    edge = mb.terry("tub towel", (0.52, 0.49, 0.42), (0.38, 0.10, 0.06), (0.80, 0.92))
    rim_y = TUB[1] - TUB_HALF[1]

    def over(u: float, v: float) -> Point:
        path = v * 0.56 - 0.14
        x = TUB[0] + 0.15 + 0.30 * u + 0.012 * math.sin(8 * v)
        ripple = 0.012 * math.sin(12 * u + 3 * v)
        lift = 0.10 * ((x - TUB[0]) / TUB_HALF[0]) ** 2
        if path < 0:
            return x, rim_y + 0.045 + 0.2 * -path, RIM + 0.02 + lift + 0.7 * path
        out = min(path / 0.05, 1.0)
        return x, rim_y + 0.03 - 0.06 * out + ripple * out, RIM + 0.022 + lift - path

    sheet(room, "tub towel", over, edge, steps=(22, 26), thickness=0.01)


def _stool(room: Collection) -> None:
    """Beside the tub: a round stool with a folded towel, a metal jug and a rubber duck."""
    oak = m.wood("stool oak", (0.24, 0.12, 0.05), (0.46, 0.27, 0.13), "X")
    cx, cy, top = -1.30, 0.42, 0.46
    rod(room, "stool seat", (cx, cy, top - 0.035), (cx, cy, top), 0.17, oak, sides=32)
    for k in range(3):
        turn = 2.0 * math.pi * k / 3 + 0.5
        out = Vector((math.cos(turn), math.sin(turn), 0.0))
        base = Vector((cx, cy, 0.0))
        rod(
            room,
            "stool leg",
            base + out * 0.19,
            base + out * 0.11 + Vector((0, 0, top - 0.03)),
            0.014,
            oak,
            0.02,
        )
    steel = m.plain("jug steel", (0.62, 0.60, 0.58), 0.18, 1.0)
    jug = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.075, 0.06),
        (0.06, 0.14),
        (0.045, 0.18),
        (0.06, 0.22),
        (0.052, 0.22),
        (0.0, 0.16),
    ]
    lathe(room, "jug", (cx - 0.04, cy + 0.03, top), jug, steel)
    grip = [
        (cx + 0.015, cy + 0.03, top + 0.20),
        (cx + 0.075, cy + 0.03, top + 0.17),
        (cx + 0.03, cy + 0.03, top + 0.06),
    ]
    bent_tube(room, "jug handle", grip, 0.008, steel)
    duck, beak = m.plain("duck", (0.72, 0.45, 0.02), 0.25), m.plain("beak", (0.65, 0.14, 0.02), 0.3)
    body = ball(room, "duck", (cx + 0.085, cy - 0.075, top + 0.035), 0.045, duck, 3)
    body.scale = (1.15, 0.9, 0.78)
    ball(room, "duck head", (cx + 0.055, cy - 0.09, top + 0.085), 0.03, duck, 3)
    ball(room, "duck beak", (cx + 0.033, cy - 0.108, top + 0.082), 0.011, beak, 2)


def _curtain(room: Collection, at: Room, brass: Material) -> None:
    """Voile before the lower half of the window, on a thin rod."""
    x0, x1, z0, z1 = at.window
    y, z = at.back + 0.03, (z0 + z1) / 2 - 0.01
    rod(room, "curtain rod", (x0, y, z), (x1, y, z), 0.007, brass)
    for a, b in ((x0 + 0.02, x0 + 0.30), (x1 - 0.30, x1 - 0.02)):

        def gathered(u: float, v: float, a: float = a, b: float = b) -> Point:
            depth = 0.016 * math.sin(2.0 * math.pi * 4.5 * u) * (0.5 + 0.5 * v)
            return a + (b - a) * u, y + depth, z - v * (z - z0 - 0.02)

        sheet(room, "voile", gathered, mb.sheer("voile", (0.72, 0.68, 0.60)), steps=(48, 6))


def _door(room: Collection, at: Room, brass: Material) -> None:
    """Behind the cameras, for the mirror: a panelled door with a bathrobe, a picture."""
    paint = m.plain("door paint", (0.10, 0.22, 0.22), 0.35)
    cx, y = -0.95, at.front + 0.02
    box(room, "door", (cx, y, 1.02), (0.82, 0.04, 2.04), paint, bevel=0.004)
    for z, high in ((1.48, 0.80), (0.52, 0.72)):
        for dx in (-0.19, 0.19):
            box(room, "door panel", (cx + dx, y + 0.026, z), (0.27, 0.016, high), paint, bevel=0.008)
    frame = m.plain("door frame", (0.60, 0.58, 0.52), 0.4)
    for dx in (-0.46, 0.46):
        box(room, "door frame", (cx + dx, y, 1.05), (0.10, 0.06, 2.1), frame, bevel=0.008)
    box(room, "door frame", (cx, y, 2.11), (1.02, 0.06, 0.12), frame, bevel=0.008)
    ball(room, "door knob", (cx + 0.34, y + 0.06, 1.02), 0.03, brass, 3)
    robe = mb.terry("robe", (0.52, 0.24, 0.16), (0.60, 0.52, 0.40))

    def hung(u: float, v: float) -> Point:
        spread = 0.10 + 0.17 * min(1.0, 2.4 * v)
        depth = 0.07 + 0.03 * math.sin(15 * u) * v
        return 0.15 + (u - 0.5) * 2 * spread, at.front + depth * (1.0 - (2 * u - 1) ** 4), 1.86 - 1.15 * v

    sheet(room, "robe", hung, robe, steps=(36, 20))
    canvas = Matrix.Translation((0.85, at.front + 0.02, 1.62))
    art = box(room, "print", (0, 0, 0), (0.5, 0.02, 0.66), m.painting("print", "landscape"))
    art.matrix_world = canvas
    for a, b in itertools.pairwise(
        [(-0.26, -0.34), (0.26, -0.34), (0.26, 0.34), (-0.26, 0.34), (-0.26, -0.34)]
    ):
        rod(
            room,
            "print frame",
            canvas @ Vector((a[0], 0.01, a[1])),
            canvas @ Vector((b[0], 0.01, b[1])),
            0.016,
            brass,
        )
