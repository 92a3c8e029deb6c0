# SPDX-License-Identifier: GPL-3.0-or-later
"""The fireplace of ``chair``: chimney breast, marble surround, a fire on a grate, mirror and candles."""

import math
import random

import bpy
from mathutils import Vector

from . import materials as m
from . import materials_fireside as hearth
from .assembly import Assembly, disk, ring
from .lighting import Lighting
from .props import ball, box, lathe, repeated, rod, sheet
from .tubes import tube

Collection = bpy.types.Collection

BREAST = (-0.56, 0.92, 1.24)  # x0, x1 and front y of the chimney breast
OPENING = (-0.22, 0.58, 0.70)  # x0, x1 and top of the fire's opening
MANTEL = 1.10
FIRE_COLOUR = (1.0, 0.46, 0.14)
FIRE_RADIANCE = 200.0
CANDLE_RADIANCE = 260.0


def fireplace(
    room: Collection, lighting: Lighting, paper: bpy.types.Material, back: float, height: float
) -> None:
    """Against the wall at y = ``back``, up to the ceiling."""
    x0, x1, front = BREAST
    left, right, top = OPENING
    deep = back - front
    y = (front + back) / 2
    for name, a, b in (("left", x0, left), ("right", right, x1)):
        box(room, f"breast {name}", ((a + b) / 2, y, height / 2), (b - a, deep, height), paper)
    middle = (left + right) / 2
    box(room, "breast above", (middle, y, (top + height) / 2), (right - left, deep, height - top), paper)
    bricks = hearth.soot_bricks("fire bricks")
    box(room, "fire back", (middle, back - 0.01, top / 2), (right - left, 0.02, top), bricks)
    for x in (left + 0.006, right - 0.006):
        box(room, "fire cheek", (x, y, top / 2), (0.012, deep, top), bricks)
    _surround(room, middle, front)
    _fire(room, lighting, (middle, back - 0.16, 0.04))
    _mantelpiece(room, lighting, middle, front)


def _surround(room: Collection, middle: float, front: float) -> None:
    """Two fluted pilasters, a lintel with a panel, a mantel shelf, a slate hearth with a brass rail."""
    left, right = OPENING[:2]
    stone = hearth.marble("marble", (0.72, 0.69, 0.63), (0.26, 0.24, 0.23))
    slate = hearth.marble("slate", (0.055, 0.058, 0.062), (0.16, 0.16, 0.16))
    for x in (left - 0.11, right + 0.11):
        box(room, "pilaster", (x, front - 0.035, 0.52), (0.20, 0.07, 1.04), stone, bevel=0.008)
        box(room, "plinth", (x, front - 0.05, 0.07), (0.23, 0.10, 0.14), stone, bevel=0.01)
        box(room, "capital", (x, front - 0.05, 1.0), (0.23, 0.10, 0.06), stone, bevel=0.01)
        flute = rod(
            room, "flute", (x - 0.05, front - 0.072, 0.2), (x - 0.05, front - 0.072, 0.92), 0.014, stone
        )
        repeated(flute, 3, (0.05, 0.0, 0.0))
    wide = right - left
    box(room, "lintel", (middle, front - 0.03, 0.87), (wide + 0.04, 0.06, 0.32), stone, bevel=0.008)
    box(room, "lintel panel", (middle, front - 0.065, 0.88), (wide - 0.16, 0.02, 0.16), stone, bevel=0.008)
    box(room, "mantel", (middle, front - 0.07, MANTEL - 0.02), (wide + 0.60, 0.26, 0.045), stone, bevel=0.014)
    box(
        room,
        "mantel cove",
        (middle, front - 0.05, MANTEL - 0.06),
        (wide + 0.52, 0.16, 0.04),
        stone,
        bevel=0.012,
    )
    box(room, "hearth", (middle, front - 0.10, 0.02), (wide + 0.52, 0.62, 0.04), slate, bevel=0.008)
    brass = m.plain("fender brass", (0.78, 0.55, 0.22), 0.2, 1.0)
    x0, x1, y = middle - 0.56, middle + 0.56, front - 0.37
    path = [(x0, front - 0.12, 0.13), (x0, y + 0.03, 0.13), (x0 + 0.03, y, 0.13)]
    path += [(x1 - 0.03, y, 0.13), (x1, y + 0.03, 0.13), (x1, front - 0.12, 0.13)]
    tube(room, "fender", path, 0.011, brass)
    for k in range(9):
        x = x0 + 0.03 + (x1 - x0 - 0.06) * k / 8
        rod(room, "fender post", (x, y, 0.04), (x, y, 0.13), 0.007, brass, sides=8)


def _fire(room: Collection, lighting: Lighting, at: tuple[float, float, float]) -> None:
    """Logs on an iron grate, flames above them; a lamp within gives the light that they seem to give."""
    iron = m.plain("iron", (0.03, 0.028, 0.026), 0.5, 0.6)
    coals, heat = hearth.embers("embers", 34.0)
    tongue, strength = hearth.flame("flames", 15.0)
    x, y, z = at
    bar = rod(
        room, "grate", (x - 0.2, y - 0.12, z + 0.07), (x - 0.2, y + 0.10, z + 0.07), 0.008, iron, sides=8
    )
    repeated(bar, 9, (0.05, 0.0, 0.0))
    for dx in (-0.2, 0.2):
        rod(room, "andiron", (x + dx, y - 0.13, z), (x + dx, y - 0.13, z + 0.24), 0.011, iron, sides=8)
        ball(room, "andiron", (x + dx, y - 0.13, z + 0.26), 0.024, iron, 2)
    for start, end, radius in (
        ((-0.22, -0.06, 0.12), (0.21, -0.04, 0.13), 0.045),
        ((-0.19, 0.05, 0.12), (0.22, 0.04, 0.12), 0.05),
        ((-0.15, 0.02, 0.21), (0.17, -0.03, 0.20), 0.042),
        ((-0.02, -0.08, 0.20), (0.15, 0.06, 0.26), 0.034),
    ):
        foot = Vector(at)
        log = rod(room, "log", foot + Vector(start), foot + Vector(end), radius, coals, radius * 0.85, 14)
        lighting.glow("fire", log, heat)
    for k, (dx, dy, tall, wide) in enumerate(
        (
            (-0.15, 0.02, 0.20, 0.040),
            (-0.08, -0.04, 0.33, 0.046),
            (-0.01, 0.03, 0.42, 0.052),
            (0.05, -0.03, 0.30, 0.044),
            (0.12, 0.02, 0.36, 0.044),
            (0.18, -0.01, 0.17, 0.034),
        )
    ):
        lick = _flame(room, Vector((x + dx, y + dy, z + 0.16)), tall, wide, 1.9 * k, tongue)
        for ray in ("diffuse", "shadow"):
            setattr(lick, f"visible_{ray}", False)
        lighting.glow("fire", lick, strength)
    core = lighting.bulb("fire", "fire", (x + 0.01, y - 0.06, z + 0.30), 0.11, FIRE_RADIANCE, FIRE_COLOUR)
    core.scale = (0.15, 0.15, 0.5)


def _flame(
    room: Collection, foot: Vector, tall: float, wide: float, phase: float, material: bpy.types.Material
) -> bpy.types.Object:
    """A tongue of fire: round at its foot, drawn to a point that sways."""

    def surface(u: float, v: float) -> Vector:
        radius = wide * (0.35 + 1.3 * v) * (1.0 - v) ** 0.8 * (1.0 + 0.25 * math.sin(11.0 * v + phase))
        sway = 0.10 * tall * v * math.sin(5.5 * v + phase) + 0.05 * tall * v * math.sin(
            13.0 * v + 2.0 * phase
        )
        angle = 2.0 * math.pi * u
        return foot + Vector((radius * math.cos(angle) + sway, 0.6 * radius * math.sin(angle), tall * v))

    return sheet(room, "flame", surface, material, steps=(14, 22))


def _mantelpiece(room: Collection, lighting: Lighting, middle: float, front: float) -> None:
    """The round mirror above, and on the shelf: candles, a clock, a vase with dry grass."""
    gilt = m.plain("gilt", (0.80, 0.56, 0.22), 0.28, 1.0)
    silver = m.plain("looking-glass", (0.90, 0.91, 0.90), 0.015, 1.0)
    z, radius, lean = 1.70, 0.36, (0.0, -1.0, -0.13)  # it hangs leaning into the room
    disk(room, "looking-glass", (middle, front - 0.05, z), radius + 0.012, silver, lean, 64)
    ring(room, "mirror frame", (middle, front - 0.055, z), radius + 0.012, 0.024, gilt, lean, 64)
    ring(room, "mirror bead", (middle, front - 0.055, z), radius - 0.03, 0.006, gilt, lean, 64)
    for k in range(28):
        angle = 2.0 * math.pi * k / 28
        across, up = (radius + 0.05) * math.cos(angle), (radius + 0.05) * math.sin(angle)
        at = (middle + across, front - 0.05 + lean[2] * up, z + up)
        ball(room, "mirror pearl", at, 0.013, gilt, 2)
    y = front - 0.10
    brass = m.plain("candlestick", (0.76, 0.52, 0.20), 0.2, 1.0)
    wax = m.plain("wax", (0.72, 0.66, 0.52), 0.4)
    wick = m.plain("wick", (0.02, 0.02, 0.02), 0.9)
    stick = [
        (0.0, 0.0), (0.05, 0.0), (0.046, 0.012), (0.014, 0.03), (0.018, 0.06), (0.011, 0.08), (0.013, 0.12),
        (0.026, 0.135), (0.017, 0.145), (0.0, 0.145),
    ]  # fmt: skip
    # One burns, one is out: every further light takes samples from the others.
    for x, tall, burns in ((middle - 0.50, 0.19, True), (middle - 0.38, 0.12, False)):
        lathe(room, "candlestick", (x, y, MANTEL), stick, brass, 24)
        foot = MANTEL + 0.14
        rod(room, "candle", (x, y, foot), (x, y, foot + tall), 0.013, wax, 0.012)
        rod(room, "wick", (x, y, foot + tall), (x, y, foot + tall + 0.014), 0.0016, wick, sides=5)
        if burns:
            tip = (x, y, foot + tall + 0.032)
            flame = lighting.bulb("fire", "candle", tip, 0.013, CANDLE_RADIANCE, (1.0, 0.55, 0.2))
            flame.scale = (0.75, 0.75, 2.0)
    _clock(room, (middle, y, MANTEL))
    vase = [
        (0.0, 0.0), (0.05, 0.0), (0.075, 0.05), (0.08, 0.11), (0.055, 0.18), (0.03, 0.22), (0.038, 0.25),
        (0.03, 0.25), (0.02, 0.21), (0.0, 0.2),
    ]  # fmt: skip
    glaze = m.speckled("vase glaze", (0.05, 0.20, 0.26), (0.38, 0.48, 0.42), 30.0, 0.15)
    at = Vector((middle + 0.46, y + 0.01, MANTEL))
    lathe(room, "vase", at, vase, glaze)
    straw = m.plain("dry grass", (0.48, 0.34, 0.15), 0.9)
    plume = m.fabric("plume", (0.52, 0.38, 0.20), (0.75, 0.62, 0.42), 30.0)
    dice = random.Random(3)
    for k in range(9):
        angle, out = k * 2.4, dice.uniform(0.04, 0.16)
        tip = at + Vector((out * math.cos(angle), 0.5 * out * math.sin(angle), dice.uniform(0.42, 0.60)))
        bend = at + Vector((0.0, 0.0, 0.24)).lerp(tip - at, 0.5) + Vector((0.0, 0.0, 0.04))
        tube(room, "dry grass", [at + Vector((0.0, 0.0, 0.2)), bend, tip], 0.003, straw, 5)
        tuft = ball(room, "plume", tip, 0.022, plume, 2)
        tuft.scale = (0.7, 0.7, 2.2)


def _clock(room: Collection, foot: tuple[float, float, float]) -> None:
    """A wooden mantel clock with a round face."""
    clock = Assembly(room, "mantel clock", foot)
    walnut = m.wood("clock walnut", (0.07, 0.03, 0.014), (0.19, 0.09, 0.04), "X", 9.0, 0.3)
    brass = m.plain("clock brass", (0.78, 0.55, 0.22), 0.2, 1.0)
    box(clock, "clock foot", (0.0, 0.0, 0.012), (0.24, 0.10, 0.024), walnut, bevel=0.006)
    box(clock, "clock case", (0.0, 0.0, 0.085), (0.20, 0.08, 0.13), walnut, bevel=0.008)
    rod(clock, "clock case", (0.0, 0.04, 0.15), (0.0, -0.04, 0.15), 0.1, walnut, sides=40)
    face = m.plain("clock dial", (0.74, 0.70, 0.60), 0.4)
    disk(clock, "clock dial", (0.0, -0.042, 0.14), 0.074, face, (0.0, -1.0, 0.0), 40)
    ring(clock, "clock rim", (0.0, -0.044, 0.14), 0.074, 0.006, brass, (0.0, 1.0, 0.0))
    ink = m.plain("clock ink", (0.02, 0.02, 0.02), 0.5)
    for k in range(12):
        s, c = math.sin(math.pi * k / 6), math.cos(math.pi * k / 6)
        rod(
            clock,
            "hour",
            (0.052 * s, -0.046, 0.14 + 0.052 * c),
            (0.064 * s, -0.046, 0.14 + 0.064 * c),
            0.0025,
            ink,
        )
    for angle, length in ((5.1, 0.034), (1.2, 0.05)):
        end = (length * math.sin(angle), -0.047, 0.14 + length * math.cos(angle))
        rod(clock, "hand", (0.0, -0.047, 0.14), end, 0.003, ink, sides=6)
