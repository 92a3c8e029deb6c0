# SPDX-License-Identifier: GPL-3.0-or-later
"""The architecture of ``sponza``: two storeys of arches on columns round a court, aisles behind them.

Each side is built along its own X from 0 to its length, the court at −Y, and then turned into place.
"""

import itertools
import math

import bmesh
import bpy
from mathutils import Matrix, Vector

from ..blender import Point
from . import materials as m
from . import materials_stone as stone
from .props import box, doubled, finish, lathe, repeated, rod
from .shapes import copy, turned

Collection = bpy.types.Collection

#: The lines of the columns.
HALF_X, HALF_Y = 3.0, 7.0
BAY, AISLE = 2.0, 2.3
#: Of the lower arches: height of the capitals, radius, top of their wall.
SPRING, RADIUS, STOREY = 2.5, 0.78, 3.85
GALLERY, RAIL, UPPER_SPRING, UPPER_RADIUS, UPPER_TOP = 4.05, 4.85, 5.75, 0.36, 6.45
THICK = 0.5
OUT_X, OUT_Y = HALF_X + AISLE, HALF_Y + AISLE

PALE, SAND = (0.70, 0.61, 0.47), (0.52, 0.43, 0.31)


def build_court(room: Collection) -> None:
    """Floors, the four sides of the court, the outer walls, galleries and roofs."""
    limestone = stone.rock("limestone", SAND, PALE)
    columns = _columns(limestone)
    ashlar = stone.masonry("ashlar", (PALE, SAND), (0.26, 0.21, 0.15), (0.62, 0.27), 0.012, "XZ", 0.015)
    sides = (
        ("left", (-HALF_X, -HALF_Y), math.pi / 2, 7),
        ("right", (HALF_X, HALF_Y), -math.pi / 2, 7),
        ("far", (-HALF_X, HALF_Y), 0.0, 3),
        ("near", (HALF_X, -HALF_Y), math.pi, 3),
    )
    for name, (x, y), turn, bays in sides:
        with turned(room, f"side {name}", (x, y, 0.0), turn):
            _lower_storey(room, bays, limestone, ashlar, columns)
            _upper_storey(room, bays, limestone, ashlar, columns)
    for sx in (-1, 1):
        for sy in (-1, 1):
            box(
                room,
                "corner pier",
                (sx * HALF_X, sy * HALF_Y, UPPER_TOP / 2),
                (0.62, 0.62, UPPER_TOP),
                ashlar,
            )
    _behind(room)


def _columns(limestone: bpy.types.Material) -> dict[str, bpy.types.Object]:
    """The two orders, in no collection: copies share their meshes."""
    return {
        "lower": _column("column", SPRING, 0.20, limestone),
        "upper": _column("small column", UPPER_SPRING - RAIL, 0.095, limestone),
    }


def _column(name: str, height: float, r: float, material: bpy.types.Material) -> bpy.types.Object:
    """Plinth, base, a shaft of radius ``r`` that swells and tapers, a capital of two rows of leaves."""
    mesh = bmesh.new()
    plinth, abacus, capital = 0.7 * r, 0.45 * r, 2.4 * r
    neck = height - abacus - capital

    def block(z0: float, z1: float, half: float) -> None:
        place = Matrix.Translation((0, 0, (z0 + z1) / 2)) @ Matrix.Diagonal(
            (2 * half, 2 * half, z1 - z0, 1.0)
        )
        bmesh.ops.create_cube(mesh, size=1.0, matrix=place)

    block(0.0, plinth, 1.45 * r)
    block(height - abacus, height - 0.5 * abacus, 1.35 * r)
    block(height - 0.5 * abacus, height, 1.5 * r)
    profile = [(1.35 * r, plinth)]
    profile += [
        (1.35 * r + 0.12 * r * math.sin(a), plinth + 0.14 * r * (1 - math.cos(a))) for a in (0.8, 1.6, 2.4)
    ]
    profile += [(1.16 * r, plinth + 0.34 * r), (1.14 * r, plinth + 0.5 * r), (1.28 * r, plinth + 0.62 * r)]
    foot = plinth + 0.8 * r
    profile += [(1.05 * r, foot)]
    for k in range(1, 7):
        t = k / 6
        profile.append((r * (1.0 + 0.05 * math.sin(math.pi * t) - 0.15 * t), foot + (neck - foot) * t))
    profile += [(1.0 * r, neck + 0.02), (1.0 * r, neck + 0.16 * r), (0.84 * r, neck + 0.2 * r)]
    profile += [(0.9 * r, neck + 0.6 * capital), (1.2 * r, height - abacus)]
    sides, rings = 24, []
    for ring, z in profile:
        angles = [math.tau * k / sides for k in range(sides)]
        rings.append([mesh.verts.new((ring * math.cos(a), ring * math.sin(a), z)) for a in angles])
    for lower, upper in itertools.pairwise(rings):
        for k in range(sides):
            face = mesh.faces.new((lower[k], lower[(k + 1) % sides], upper[(k + 1) % sides], upper[k]))
            face.smooth = True
    for row, (start, tall) in enumerate(((0.2 * r, 0.5 * capital), (0.2 * r, 0.85 * capital))):
        for k in range(8):
            _acanthus(mesh, math.tau * (k + 0.5 * row) / 8, 0.9 * r, neck + start, tall - start, 0.62 * r)
    data = bpy.data.meshes.new(name)
    mesh.to_mesh(data)
    mesh.free()
    data.materials.append(material)
    return bpy.data.objects.new(name, data)


def _acanthus(
    mesh: bmesh.types.BMesh, angle: float, radius: float, z: float, tall: float, width: float
) -> None:
    """One leaf that stands against the bell and curls outward at its tip."""
    out = Vector((math.cos(angle), math.sin(angle), 0.0))
    side, rows = Vector((-out.y, out.x, 0.0)), []
    for t, away, high, wide in (
        (0.0, 0.02, 0.0, 0.9),
        (0.5, 0.10, 0.55, 1.0),
        (0.8, 0.22, 0.9, 0.8),
        (0.95, 0.42, 1.0, 0.55),
        (1.0, 0.52, 0.84, 0.3),
    ):
        centre = out * (radius * (1.0 + away)) + Vector((0, 0, z + tall * high))
        fold = out * (0.12 * radius * (1.0 - t))
        half = 0.5 * width * wide
        points: list[Point] = [centre + side * (s * half) + fold * (1 - abs(s)) for s in (-1, 0, 1)]
        rows.append([mesh.verts.new(point) for point in points])
    for lower, upper in itertools.pairwise(rows):
        for k in (0, 1):
            mesh.faces.new((lower[k], lower[k + 1], upper[k + 1], upper[k])).smooth = True


def _arch(width: float, spring: float, radius: float, top: float, thick: float) -> bmesh.types.BMesh:
    """One bay of wall over an arch, X 0 … width, Z from the capitals to ``top``, Y about 0."""
    mesh, steps = bmesh.new(), 20
    low = [(0.0, spring), (width / 2 - radius, spring)]
    for k in range(1, steps):
        a = math.pi * (1.0 - k / steps)
        low.append((width / 2 + radius * math.cos(a), spring + radius * math.sin(a)))
    low += [(width / 2 + radius, spring), (width, spring)]
    below = [mesh.verts.new((x, -thick / 2, z)) for x, z in low]
    above = [mesh.verts.new((x, -thick / 2, top)) for x, _ in low]
    faces = [mesh.faces.new((below[k], below[k + 1], above[k + 1], above[k])) for k in range(len(low) - 1)]
    bmesh.ops.translate(mesh, vec=(0, thick, 0), verts=doubled(mesh, faces))
    return mesh


def _voussoirs(
    width: float, spring: float, radius: float, deep: float, thick: float, parity: int, count: int
) -> bmesh.types.BMesh:
    """Every second wedge of an arch's ring: it stands out from the wall."""
    mesh = bmesh.new()
    for k in range(parity, count, 2):
        start, end = math.pi * k / count + 0.008, math.pi * (k + 1) / count - 0.008
        corners = []
        for y in (-thick / 2, thick / 2):
            for r, a in ((radius, start), (radius, end), (radius + deep, end), (radius + deep, start)):
                x, z = width / 2 + r * math.cos(a), spring + r * math.sin(a)
                corners.append(mesh.verts.new((x, y, z)))
        a, b = corners[:4], corners[4:]
        mesh.faces.new(a)
        mesh.faces.new(b[::-1])
        for i in range(4):
            j = (i + 1) % 4
            mesh.faces.new((a[i], b[i], b[j], a[j]))
    return mesh


def _repeat(item: bpy.types.Object, count: int, step: float) -> None:
    repeated(item, count, (step, 0.0, 0.0), "along the side")


def _course(
    room: Collection,
    name: str,
    length: float,
    z: float,
    tall: float,
    out: float,
    material: bpy.types.Material,
) -> None:
    """A moulding all along a side, standing out from both faces of the wall."""
    size = (length + THICK + 2 * out, THICK + 2 * out, tall)
    box(room, name, (length / 2, 0.0, z + tall / 2), size, material, bevel=min(0.3 * tall, 0.02))


def _lower_storey(
    room: Collection,
    bays: int,
    limestone: bpy.types.Material,
    ashlar: bpy.types.Material,
    columns: dict[str, bpy.types.Object],
) -> None:
    length = bays * BAY
    wall = finish(room, "arches", _arch(BAY, SPRING, RADIUS, STOREY, THICK), ashlar)
    _repeat(wall, bays, BAY)
    red = stone.rock("red stone", (0.27, 0.105, 0.07), (0.40, 0.175, 0.11))
    for parity, material in ((0, limestone), (1, red)):
        ring = _voussoirs(BAY, SPRING, RADIUS, 0.2, THICK + 0.05, parity, 15)
        _repeat(finish(room, "voussoirs", ring, material), bays, BAY)
    for k in range(1, bays):
        copy(room, columns["lower"], (k * BAY, 0.0, 0.0))
    porphyry = m.speckled("porphyry", (0.17, 0.03, 0.045), (0.36, 0.13, 0.12), 16.0, 0.25)
    disc = [(0.0, 0.035), (0.10, 0.035), (0.115, 0.02), (0.15, 0.03), (0.16, 0.0)]
    roundel = lathe(room, "roundel", (0, 0, 0), [(r, z) for r, z in disc[:3]], porphyry, 24)
    frame = lathe(room, "roundel frame", (0, 0, 0), disc[2:], limestone, 24)
    for item in (roundel, frame):
        item.rotation_euler, item.location = (math.pi / 2, 0, 0), (BAY, -THICK / 2, 3.42)
        _repeat(item, bays - 1, BAY)
    _course(room, "string course", length, STOREY, 0.07, 0.05, limestone)
    dentil = box(room, "dentil", (0.05, -THICK / 2 - 0.05, STOREY + 0.11), (0.09, 0.10, 0.08), limestone)
    _repeat(dentil, int(length / 0.18), 0.18)
    _course(room, "cornice", length, STOREY + 0.15, 0.08, 0.14, limestone)


def _upper_storey(
    room: Collection,
    bays: int,
    limestone: bpy.types.Material,
    ashlar: bpy.types.Material,
    columns: dict[str, bpy.types.Object],
) -> None:
    length, bay = bays * BAY, BAY / 2
    baluster = [(0.045, 0.0), (0.03, 0.04), (0.062, 0.18), (0.03, 0.40), (0.045, 0.46), (0.045, 0.56)]
    turned_stone = lathe(room, "baluster", (0.125, 0.0, GALLERY + 0.05), baluster, limestone, 10)
    _repeat(turned_stone, int(length / 0.25), 0.25)
    box(room, "plinth course", (length / 2, 0, GALLERY + 0.03), (length, 0.3, 0.06), limestone)
    box(room, "handrail", (length / 2, 0, RAIL - 0.1), (length, 0.34, 0.2), limestone, bevel=0.03)
    post = box(room, "post", (bay, 0, (GALLERY + RAIL) / 2), (0.26, 0.3, RAIL - GALLERY), limestone)
    _repeat(post, 2 * bays - 1, bay)
    for k in range(1, 2 * bays):
        copy(room, columns["upper"], (k * bay, 0.0, RAIL))
    arches = _arch(bay, UPPER_SPRING, UPPER_RADIUS, UPPER_TOP, 0.34)
    _repeat(finish(room, "small arches", arches, ashlar), 2 * bays, bay)
    ring = _voussoirs(bay, UPPER_SPRING, UPPER_RADIUS, 0.10, 0.39, 0, 21)
    _repeat(finish(room, "small voussoirs", ring, limestone), 2 * bays, bay)
    _course(room, "frieze", length, UPPER_TOP, 0.12, -0.04, limestone)
    oak = m.wood("rafter", (0.06, 0.033, 0.02), (0.14, 0.08, 0.045), "Y")
    rafter = box(room, "rafter", (0.2, -0.30, UPPER_TOP + 0.17), (0.09, 0.75, 0.10), oak)
    _repeat(rafter, int(length / 0.4), 0.4)
    tiles = m.fabric("roof tiles", (0.28, 0.10, 0.05), (0.46, 0.20, 0.10), 4.0)
    slope = math.radians(16.0)
    start = Vector((0.07, -0.72, UPPER_TOP + 0.24))
    end = start + Vector((0.0, 3.3 * math.cos(slope), 3.3 * math.sin(slope)))
    _repeat_world(rod(room, "roof tile", start, end, 0.075, tiles, sides=10), int(length / 0.14) + 1, 0.14)
    roof = box(
        room, "roof", (length / 2, 0.92, UPPER_TOP + 0.66), (length + 1.4, 3.3, 0.06), tiles, (slope, 0, 0)
    )
    roof.name = "roof"


def _repeat_world(item: bpy.types.Object, count: int, step: float) -> None:
    """Repeat along the side's X an item whose own X points elsewhere."""
    turn = item.rotation_quaternion.to_matrix().inverted()
    repeated(item, count, turn @ Vector((step, 0.0, 0.0)), "along the side")


def _behind(room: Collection) -> None:
    """Floors, the outer walls and their doors, the galleries' floors and beams."""
    pale, dark, red = (0.56, 0.50, 0.40), (0.10, 0.105, 0.10), (0.30, 0.10, 0.07)
    court = stone.inlay("court floor", pale, dark, red, 1.0)
    box(room, "court floor", (0, 0, -0.05), (2 * HALF_X - THICK, 2 * HALF_Y - THICK, 0.1), court)
    slabs = stone.masonry("slabs", (PALE, SAND), (0.14, 0.11, 0.08), (0.9, 0.6), 0.014, "XY", 0.008)
    box(room, "aisle floor", (0, 0, -0.056), (2 * OUT_X, 2 * OUT_Y, 0.1), slabs)
    kerb = stone.rock("kerb", SAND, PALE)
    for s in (-1, 1):
        box(room, "kerb", (s * HALF_X, 0, 0.0), (0.66, 2 * HALF_Y + 0.66, 0.06), kerb, bevel=0.015)
        box(room, "kerb", (0, s * HALF_Y, 0.0), (2 * HALF_X, 0.66, 0.06), kerb, bevel=0.015)
    high = UPPER_TOP + 0.9
    walls = {
        plane: stone.masonry(
            f"outer wall {plane}",
            ((0.50, 0.41, 0.29), (0.36, 0.28, 0.19)),
            (0.2, 0.16, 0.11),
            (0.7, 0.32),
            0.014,
            plane,
        )
        for plane in ("XZ", "YZ")
    }
    ochre = m.plaster("ochre plaster", (0.52, 0.30, 0.13), 0.35)
    for s in (-1, 1):
        box(room, "outer wall", (s * (OUT_X + 0.2), 0, high / 2), (0.4, 2 * OUT_Y + 0.8, high), walls["YZ"])
        box(room, "outer wall", (0, s * (OUT_Y + 0.2), high / 2), (2 * OUT_X, 0.4, high), walls["XZ"])
        box(room, "gallery plaster", (s * (OUT_X - 0.01), 0, 5.4), (0.02, 2 * OUT_Y, 2.6), ochre)
        box(room, "gallery plaster", (0, s * (OUT_Y - 0.01), 5.4), (2 * OUT_X, 0.02, 2.6), ochre)
        x, y = s * (HALF_X + AISLE / 2), s * (HALF_Y + AISLE / 2)
        box(room, "gallery floor", (x, 0, STOREY + 0.12), (AISLE, 2 * OUT_Y, 0.12), ochre)
        box(room, "gallery floor", (0, y, STOREY + 0.12), (2 * HALF_X, AISLE, 0.12), ochre)
    oak = m.wood("beam", (0.05, 0.028, 0.017), (0.13, 0.07, 0.04), "X")
    for s in (-1, 1):
        beam = box(
            room, "beam", (s * (HALF_X + AISLE / 2), -OUT_Y + 0.3, STOREY - 0.02), (AISLE, 0.13, 0.17), oak
        )
        repeated(beam, 28, (0.0, 0.66, 0.0), "along the aisle")
    door = m.wood("door", (0.06, 0.03, 0.016), (0.17, 0.085, 0.04), "Z", 3.0)
    iron = m.plain("door iron", (0.03, 0.03, 0.03), 0.45, 1.0)
    arch = _voussoirs(1.6, 2.0, 0.62, 0.18, 0.2, 0, 11), _voussoirs(1.6, 2.0, 0.62, 0.18, 0.2, 1, 11)
    for mesh, material in zip(arch, (kerb, m.plain("door red", (0.30, 0.11, 0.07), 0.8)), strict=True):
        finish(room, "door arch", mesh, material).location = (-0.8, OUT_Y - 0.02, 0.0)
    box(room, "door", (0, OUT_Y - 0.03, 1.0), (1.24, 0.1, 2.0), door)
    rod(room, "door head", (0, OUT_Y + 0.02, 2.0), (0, OUT_Y - 0.07, 2.0), 0.62, door, sides=32)
    for z in (0.5, 1.1, 1.7):
        box(room, "door band", (0, OUT_Y - 0.09, z), (1.2, 0.02, 0.07), iron)
    for x in (-0.7, 0.7):
        box(room, "jamb", (x, OUT_Y - 0.02, 1.0), (0.16, 0.2, 2.0), kerb, bevel=0.02)
