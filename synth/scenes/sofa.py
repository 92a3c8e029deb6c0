# SPDX-License-Identifier: GPL-3.0-or-later
"""``sofa``: a flat at golden hour, 4.6 × 5.4 × 2.65 m, with a leather corner sofa and a television on.

The sun comes low through a large window in the left wall, over herringbone parquet and a carpet, on to the
sofa in the right corner. Lamps: ``arc``, a bare bulb on a bent pole; ``string``, a chain of small bulbs along
the back and right walls; ``screen``, the television. Ambient is sky, sun and a soft fill behind the camera.
"""

import itertools
import math
import random

import bmesh
import bpy
from mathutils import Matrix, Vector

from ..assets import Assets
from ..stage import CameraHints, Stage
from . import materials as m
from . import materials_stone as stone
from . import materials_upholstery as soft
from . import sofa_furniture as furniture
from .lighting import Lighting
from .props import ball, box, finish, repeated, rod, sheet
from .shapes import hanging
from .skies import clouded
from .tubes import tube

LEFT, RIGHT, FRONT, BACK, HEIGHT = -2.3, 2.3, -3.1, 2.3, 2.65
WINDOW = (-0.25, 1.95, 0.42, 2.32)  # y0, y1, z0, z1 in the left wall
WALL = 0.14

SKY_RADIANCE = 11.0
SUN_IRRADIANCE = 44.0
FILL_POWER = 15.0  # watts
STRING_RADIANCE = 400.0
WARM = (1.0, 0.68, 0.36)

#: Evening: peach at the horizon, blue above, long thin clouds.
SKY = clouded(
    [(0.0, (1.0, 0.74, 0.50)), (0.12, (0.85, 0.80, 0.80)), (0.55, (0.28, 0.44, 0.78))],
    clouds=(1.5, 1.2, 0.95),
    cover=(0.5, 0.72),
    scale=3.2,
    flat=4.5,
    distortion=0.4,
)


def build(scene: bpy.types.Scene, assets: Assets) -> Stage:
    """Fill ``scene`` and return its lights and camera hints."""
    room = scene.collection
    dice = random.Random(11)
    lighting = Lighting(scene)
    _floor(room, dice)
    _walls(room)
    _window(room)
    _outside(room, dice)
    furniture.furnish(room, assets, lighting, dice)
    _light(room, lighting)
    hints = CameraHints(
        centre=(0.15, -2.3, 1.35),
        target=(0.13, 1.0, 0.84),
        extent=(1.6, 0.8),
        angle_x=math.radians(64.0),
        orbit_radius=3.2,
        orbit_arc=math.radians(46.0),
        elevation=(math.radians(1.0), math.radians(22.0)),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


def _floor(room: bpy.types.Collection, dice: random.Random) -> None:
    """Herringbone parquet: every block is a face of its own, 45 × 9 cm, with joints of 3 mm to a dark bed."""
    width, ratio, joint = 0.09, 5, 0.0015
    box(
        room,
        "bed",
        ((LEFT + RIGHT) / 2, (FRONT + BACK) / 2, -0.06),
        (RIGHT - LEFT + 0.2, BACK - FRONT + 0.2, 0.116),
        m.plain("bed", (0.02, 0.012, 0.008), 0.9),
    )
    mesh = bmesh.new()
    plank = mesh.verts.layers.float_vector.new("plank")
    turn = Matrix.Rotation(math.pi / 4, 2)
    reach = int(3.4 * math.sqrt(2.0) / width)

    def block(i: int, j: int, across: bool) -> None:
        size = (1, ratio) if across else (ratio, 1)
        middle = turn @ Vector(((i + size[0] / 2) * width, (j + size[1] / 2) * width))
        middle.y += (FRONT + BACK) / 2
        if not (LEFT - 0.3 < middle.x < RIGHT + 0.3 and FRONT - 0.3 < middle.y < BACK + 0.3):
            return
        tone, offset, corners = min(max(dice.gauss(0.5, 0.22), 0.0), 1.0), dice.uniform(0.0, 9.0), []
        half_u, half_v = size[0] * width / 2 - joint, size[1] * width / 2 - joint
        for su, sv in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            place = middle + turn @ Vector((su * half_u, sv * half_v))
            corner = mesh.verts.new((place.x, place.y, 0.0))
            u, v = (sv * half_v, su * half_u) if across else (su * half_u, sv * half_v)
            corner[plank] = (offset + u, v, tone)
            corners.append(corner)
        mesh.faces.new(corners)

    for row in range(-reach, reach):
        for step in range(-reach // (2 * ratio) - 1, reach // (2 * ratio) + 2):
            block(row + 2 * ratio * step, row, False)
            block(row, row + 1 + 2 * ratio * step, True)
    for x, y, nx, ny in ((LEFT, 0, -1, 0), (RIGHT, 0, 1, 0), (0, FRONT, 0, -1), (0, BACK, 0, 1)):
        everything = [*mesh.verts, *mesh.edges, *mesh.faces]
        bmesh.ops.bisect_plane(
            mesh, geom=everything, plane_co=(x, y, 0), plane_no=(nx, ny, 0), clear_outer=True
        )
    finish(room, "parquet", mesh, soft.parquet("parquet"))


def _walls(room: bpy.types.Collection) -> None:
    """Left: plaster round the window. Back: green panels. Right: whitened brick. Ceiling, cornice, door."""
    depth, middle = BACK - FRONT, (BACK + FRONT) / 2
    chalk = m.plaster("chalk", (0.66, 0.60, 0.52), 0.14)
    y0, y1, z0, z1 = WINDOW
    x = LEFT - WALL / 2
    pieces = {
        "near": ((FRONT + y0) / 2, HEIGHT / 2, y0 - FRONT, HEIGHT),
        "far": ((y1 + BACK) / 2, HEIGHT / 2, BACK - y1, HEIGHT),
        "below": ((y0 + y1) / 2, z0 / 2, y1 - y0, z0),
        "above": ((y0 + y1) / 2, (z1 + HEIGHT) / 2, y1 - y0, HEIGHT - z1),
    }
    for name, (y, z, sy, sz) in pieces.items():
        box(room, f"wall left {name}", (x, y, z), (WALL, sy, sz), chalk)
    green = m.plaster("green paint", (0.085, 0.15, 0.13), 0.18)
    box(room, "wall back", (0, BACK + 0.06, HEIGHT / 2), (RIGHT - LEFT + 0.28, 0.12, HEIGHT), green)
    batten = box(room, "batten", (LEFT + 0.3, BACK - 0.011, 0.66), (0.07, 0.022, 1.06), green, bevel=0.006)
    repeated(batten, 9, (0.5, 0.0, 0.0), "along the wall")
    for z, tall, out in ((0.09, 0.18, 0.03), (1.2, 0.06, 0.036), (1.15, 0.03, 0.022)):
        box(room, "panel rail", (0, BACK - out / 2, z), (RIGHT - LEFT, out, tall), green, bevel=0.008)
    brick = stone.masonry(
        "white brick",
        ((0.56, 0.50, 0.44), (0.40, 0.33, 0.28)),
        (0.24, 0.21, 0.18),
        (0.24, 0.075),
        0.011,
        "YZ",
        relief=0.012,
    )
    box(room, "wall right", (RIGHT + 0.06, middle, HEIGHT / 2), (0.12, depth + 0.24, HEIGHT), brick)
    box(room, "wall front", (0, FRONT - 0.06, HEIGHT / 2), (RIGHT - LEFT + 0.28, 0.12, HEIGHT), chalk)
    white = m.plaster("ceiling", (0.74, 0.71, 0.67), 0.10)
    box(room, "ceiling", (0, middle, HEIGHT + 0.05), (RIGHT - LEFT + 0.28, depth + 0.24, 0.1), white)
    trim = m.plain("trim", (0.68, 0.65, 0.60), 0.4)
    for out, z in ((0.11, HEIGHT - 0.02), (0.07, HEIGHT - 0.06), (0.035, HEIGHT - 0.095)):
        box(room, "cornice", (0, BACK - out / 2, z), (RIGHT - LEFT, out, 0.04), trim, bevel=0.008)
        for side in (-1, 1):
            box(room, "cornice", (side * (RIGHT - out / 2), middle, z), (out, depth, 0.04), trim, bevel=0.008)
    for side in (-1, 1):
        box(room, "skirting", (side * (RIGHT - 0.011), middle, 0.06), (0.022, depth, 0.12), trim, bevel=0.005)
    # Behind the camera, where the mirror looks: a door in its frame, and a picture.
    walnut = m.wood("door", (0.07, 0.035, 0.02), (0.16, 0.085, 0.045), "Z", 3.0)
    box(room, "door frame", (-0.4, FRONT + 0.02, 1.06), (1.06, 0.04, 2.12), trim, bevel=0.01)
    box(room, "door", (-0.4, FRONT + 0.035, 1.02), (0.88, 0.04, 2.04), walnut, bevel=0.008)
    box(
        room,
        "far picture",
        (1.3, FRONT + 0.02, 1.5),
        (0.8, 0.03, 0.6),
        m.painting("far picture", "abstract"),
    )


def _window(room: bpy.types.Collection) -> None:
    """A steel window of three by three panes without glass, a deep sill, a linen curtain at either side."""
    y0, y1, z0, z1 = WINDOW
    steel = m.plain("window steel", (0.03, 0.032, 0.035), 0.4)
    cy, cz, x = (y0 + y1) / 2, (z0 + z1) / 2, LEFT - 0.08
    for y in (y0 + 0.02, y1 - 0.02):
        box(room, "stile", (x, y, cz), (0.07, 0.045, z1 - z0), steel, bevel=0.006)
    for z in (z0 + 0.02, z1 - 0.02):
        box(room, "rail", (x, cy, z), (0.07, y1 - y0, 0.045), steel, bevel=0.006)
    for k in (1, 2):
        box(room, "bar", (x, y0 + (y1 - y0) * k / 3, cz), (0.045, 0.032, z1 - z0), steel)
    for z in (z0 + 0.62, z0 + 1.26):
        box(room, "bar", (x, cy, z), (0.04, y1 - y0, 0.028), steel)
    sill = m.wood("sill", (0.22, 0.12, 0.06), (0.42, 0.26, 0.13), "Y")
    box(room, "sill", (LEFT + 0.06, cy, z0 - 0.02), (0.32, y1 - y0 + 0.12, 0.04), sill, bevel=0.012)
    iron = m.plain("curtain iron", (0.04, 0.035, 0.03), 0.35, 1.0)
    rod(room, "curtain pole", (LEFT + 0.1, y0 - 0.45, 2.45), (LEFT + 0.1, y1 + 0.32, 2.45), 0.014, iron)
    for y in (y0 - 0.46, y1 + 0.32):
        ball(room, "finial", (LEFT + 0.1, y, 2.45), 0.03, iron, 3)
    linen = m.curtain("linen", (0.70, 0.62, 0.50), (0.62, 0.52, 0.40))
    for start, stop, folds in ((y0 - 0.42, y0 + 0.05, 6.0), (y1 + 0.02, y1 + 0.32, 5.5)):

        def folded(u: float, v: float, a: float = start, b: float = stop, n: float = folds):
            deep = 0.042 * math.sin(2.0 * math.pi * n * u + 0.5 * math.sin(3.0 * v)) * (0.55 + 0.45 * v)
            y = a + (b - a) * (0.5 + (u - 0.5) * (0.86 + 0.14 * math.cos(2.4 * v)))
            return LEFT + 0.1 + deep, y, 2.43 - 2.40 * v

        sheet(room, "curtain", folded, linen, steps=(80, 20))


def _outside(room: bpy.types.Collection, dice: random.Random) -> None:
    """What the window shows: a balcony's railing, tree tops, a row of houses."""
    slab = stone.rock("balcony slab", (0.30, 0.28, 0.25), (0.42, 0.40, 0.36))
    box(room, "balcony", (LEFT - 0.75, 0.6, -0.12), (1.2, 5.4, 0.12), slab)
    iron = m.plain("railing", (0.05, 0.06, 0.055), 0.5)
    bar = box(room, "railing bar", (LEFT - 1.25, -1.9, 0.40), (0.022, 0.022, 0.95), iron)
    repeated(bar, 42, (0.0, 0.125, 0.0), "along the balcony")
    box(room, "handrail", (LEFT - 1.25, 0.7, 0.88), (0.06, 5.3, 0.035), iron, bevel=0.008)
    crown = m.fabric("crown", (0.025, 0.055, 0.015), (0.12, 0.19, 0.045), 3.0)
    for k in range(7):
        y = 1.0 + 2.6 * k + dice.uniform(-0.5, 0.5)
        ball(room, f"tree {k}", (-11.0 - 0.5 * k, y, -1.6), dice.uniform(1.3, 1.8), crown, 4, 0.4, k * 1.7)
    house = stone.masonry(
        "houses", ((0.46, 0.20, 0.12), (0.34, 0.15, 0.10)), (0.40, 0.36, 0.30), (1.2, 0.4), 0.04, "YZ"
    )
    pane, frame = m.plain("far pane", (0.04, 0.06, 0.09), 0.15), m.plain("far frame", (0.6, 0.56, 0.5), 0.6)
    for k in range(4):
        y, tall = 6.0 + 8.5 * k, 4.5 + dice.uniform(0.0, 2.0)
        box(room, "house", (-25.0, y, tall / 2 - 4.0), (6.0, 8.0, tall + 3.0), house)
        for level in (0, 1):
            for column in (-1, 0, 1):
                at = (-21.95, y + 2.4 * column, 0.4 + 2.6 * level)
                box(room, "far frame", at, (0.1, 1.25, 1.65), frame)
                box(room, "far pane", (-21.88, *at[1:]), (0.1, 1.0, 1.4), pane)


def _light(room: bpy.types.Collection, lighting: Lighting) -> None:
    y0, y1, z0, z1 = WINDOW
    lighting.sky(SKY, SKY_RADIANCE)
    lighting.portal((LEFT - 0.145, (y0 + y1) / 2, (z0 + z1) / 2), (1.0, 0.0, 0.0), (y1 - y0, z1 - z0))
    lighting.sun((0.80, -0.13, -0.38), SUN_IRRADIANCE, (1.0, 0.74, 0.46), angle=1.0)
    lighting.area(
        "fill", (0.2, FRONT + 0.06, 1.8), (0.0, 1.0, -0.12), (2.6, 1.2), FILL_POWER, (0.85, 0.92, 1.0)
    )
    black = m.plain("string cord", (0.015, 0.015, 0.015), 0.6)
    brass = m.plain("string socket", (0.60, 0.42, 0.16), 0.3, 1.0)
    back, right = BACK - 0.07, RIGHT - 0.07
    hooks = [
        (-0.05, back, 2.36),
        (1.12, back, 2.40),
        (right, back, 2.38),
        (right, 1.0, 2.40),
        (right, -0.4, 2.36),
    ]
    bulbs = 0
    for start, end in itertools.pairwise(hooks):
        cord = hanging(start, end, 0.20)
        tube(room, "string cord", cord, 0.006, black, 6)
        for k in (3, 9):
            lighting.bulb(
                "string", f"string {bulbs}", cord[k] - Vector((0, 0, 0.065)), 0.021, STRING_RADIANCE, WARM
            )
            rod(room, "string socket", cord[k], cord[k] - Vector((0, 0, 0.05)), 0.011, brass, sides=9)
            bulbs += 1
        ball(room, "hook", start, 0.016, brass, 2)
