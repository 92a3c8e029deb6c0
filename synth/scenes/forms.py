# SPDX-License-Identifier: GPL-3.0-or-later
"""More building blocks: tubes along curves, rings, copies that share a mesh, frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import bmesh
import bpy
from mathutils import Matrix, Vector

from .props import Point, box, finish

Collection = bpy.types.Collection


def smooth_path(points: Sequence[Point], steps: int = 6) -> list[Vector]:
    """Catmull–Rom spline through ``points``, ``steps`` segments between two of them."""
    p = [Vector(q) for q in points]
    p = [2 * p[0] - p[1], *p, 2 * p[-1] - p[-2]]
    path = []
    for a, b, c, d in zip(p, p[1:], p[2:], p[3:], strict=False):
        for k in range(steps):
            t = k / steps
            cubic = 2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
            path.append(0.5 * cubic)
    return [*path, p[-2]]


def tube(
    collection: Collection,
    name: str,
    points: Sequence[Point],
    radius: float | Sequence[float],
    material: bpy.types.Material,
    sides: int = 10,
    steps: int = 6,
) -> bpy.types.Object:
    """A bent bar along a smooth curve through ``points``; ``radius``: one, or one a point."""
    path = smooth_path(points, steps)
    given = [radius] * len(points) if isinstance(radius, (int, float)) else [*radius]
    mesh = bmesh.new()
    side = (path[1] - path[0]).orthogonal().normalized()
    rings = []
    for k, at in enumerate(path):
        along = (path[min(k + 1, len(path) - 1)] - path[max(k - 1, 0)]).normalized()
        side = (side - along * side.dot(along)).normalized()  # carried along without a twist
        across = along.cross(side)
        whole, part = divmod(k, steps)
        r, following = given[whole], given[min(whole + 1, len(given) - 1)]
        r += (following - r) * part / steps
        angles = [2.0 * math.pi * j / sides for j in range(sides)]
        rings.append([mesh.verts.new(at + r * (math.cos(a) * side + math.sin(a) * across)) for a in angles])
    for lower, upper in itertools.pairwise(rings):
        for j in range(sides):
            mesh.faces.new((lower[j], lower[(j + 1) % sides], upper[(j + 1) % sides], upper[j]))
    mesh.faces.new(rings[0])
    mesh.faces.new(rings[-1])
    return finish(collection, name, mesh, material, smooth=sides > 4)


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
        round_it = [
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
