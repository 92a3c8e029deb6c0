# SPDX-License-Identifier: GPL-3.0-or-later
"""More building blocks: rings, copies that share a mesh, frames."""

import math
from collections.abc import Iterable

import bmesh
import bpy
from mathutils import Matrix, Vector

from ..blender import Point
from .props import box, finish

Collection = bpy.types.Collection


def ring(
    collection: Collection,
    name: str,
    centre: Point,
    radius: float,
    thickness: float,
    material: bpy.types.Material,
    rotation: Point = (0.0, 0.0, 0.0),
    sides: int = 32,
) -> bpy.types.Object:
    """A torus about its own Z: rims, collars, links of a chain. ``thickness``: radius of the bar."""
    mesh = bmesh.new()
    rings = []
    for k in range(sides):
        a = 2.0 * math.pi * k / sides
        out = Vector((math.cos(a), math.sin(a), 0.0))
        bar = [2.0 * math.pi * j / 8 for j in range(8)]
        round_it: list[Point] = [
            out * (radius + thickness * math.cos(b)) + Vector((0, 0, thickness * math.sin(b))) for b in bar
        ]
        rings.append([mesh.verts.new(point) for point in round_it])
    for k in range(sides):
        following = rings[(k + 1) % sides]
        for j in range(8):
            mesh.faces.new((rings[k][j], following[j], following[(j + 1) % 8], rings[k][(j + 1) % 8]))
    item = finish(collection, name, mesh, material, smooth=True)
    item.location, item.rotation_euler = centre, rotation
    return item


def standing(at: Point, turn: float = 0.0) -> Matrix:
    """Where something stands: moved to ``at``, turned about Z (radians)."""
    return Matrix.Translation(at) @ Matrix.Rotation(turn, 4, "Z")


def move(items: Iterable[bpy.types.Object], place: Matrix) -> None:
    """Move what was built about the origin."""
    for item in items:
        item.matrix_basis = place @ item.matrix_basis


def copies(
    collection: Collection, items: Iterable[bpy.types.Object], place: Matrix
) -> list[bpy.types.Object]:
    """The same once more, moved by ``place`` from where the first are; meshes are shared."""
    made = []
    for item in items:
        copy = item.copy()
        collection.objects.link(copy)
        copy.matrix_basis = place @ item.matrix_basis
        made.append(copy)
    return made


def framed(
    collection: Collection,
    name: str,
    place: Matrix,
    size: tuple[float, float],
    inside: bpy.types.Material,
    frame: bpy.types.Material,
    width: float = 0.05,
    mount: bpy.types.Material | None = None,
) -> None:
    """A picture or mirror of ``size`` in a frame; it faces the place's −Y. ``mount``: a broad border."""
    w, h = size
    made = [box(collection, name, (0, 0, 0), (w, 0.02, h), inside)]
    for dx, dz, sx, sz in (
        (0, (h + width) / 2, w + 2 * width, width),
        (0, -(h + width) / 2, w + 2 * width, width),
        ((w + width) / 2, 0, width, h),
        (-(w + width) / 2, 0, width, h),
    ):
        made.append(box(collection, f"{name} frame", (dx, -0.005, dz), (sx, 0.045, sz), frame, bevel=0.012))
    if mount is not None:
        for dx, dz, sx, sz in (
            (0, h * 0.44, w, h * 0.12),
            (0, -h * 0.44, w, h * 0.12),
            (w * 0.43, 0, w * 0.14, h * 0.76),
            (-w * 0.43, 0, w * 0.14, h * 0.76),
        ):
            made.append(box(collection, f"{name} mount", (dx, -0.012, dz), (sx, 0.008, sz), mount))
    move(made, place)
