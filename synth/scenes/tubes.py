# SPDX-License-Identifier: GPL-3.0-or-later
"""Round bars along a path: cables, handles, stems, garlands, rolls of cloth."""

import itertools
import math
from collections.abc import Sequence

import bmesh
import bpy
from mathutils import Vector

from ..blender import Point
from .props import Holder, finish


def tube(
    collection: Holder,
    name: str,
    path: Sequence[Point],
    radius: float,
    material: bpy.types.Material,
    sides: int = 10,
    end_radius: float | None = None,
) -> bpy.types.Object:
    """Straight from point to point of ``path``, with closed ends; ``end_radius``: it tapers to that."""
    last = len(path) - 1
    taper = 0.0 if end_radius is None else (end_radius - radius) / last
    radii = [radius + taper * k for k in range(last + 1)]
    return _swept(collection, name, [Vector(point) for point in path], radii, material, sides)


def bent_tube(
    collection: Holder,
    name: str,
    points: Sequence[Point],
    radius: float | Sequence[float],
    material: bpy.types.Material,
    sides: int = 10,
    steps: int = 6,
) -> bpy.types.Object:
    """Along a smooth curve through ``points``; ``radius``: one, or one a point."""
    given = [radius] * len(points) if isinstance(radius, int | float) else [*radius]
    radii = [a + (b - a) * k / steps for a, b in itertools.pairwise(given) for k in range(steps)]
    return _swept(collection, name, smooth_path(points, steps), [*radii, given[-1]], material, sides)


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


def _swept(
    collection: Holder,
    name: str,
    path: list[Vector],
    radii: Sequence[float],
    material: bpy.types.Material,
    sides: int,
) -> bpy.types.Object:
    last = len(path) - 1
    mesh = bmesh.new()
    rings = []
    side = (path[1] - path[0]).orthogonal()
    for k, (at, radius) in enumerate(zip(path, radii, strict=True)):
        along = (path[min(k + 1, last)] - path[max(k - 1, 0)]).normalized()
        side = (side - along * side.dot(along)).normalized()  # carried along, so that nothing twists
        across: Point = along.cross(side)
        angles = [2.0 * math.pi * j / sides for j in range(sides)]
        rim: list[Point] = [at + radius * (math.cos(a) * side + math.sin(a) * across) for a in angles]
        rings.append([mesh.verts.new(point) for point in rim])
    for lower, upper in itertools.pairwise(rings):
        for j in range(sides):
            mesh.faces.new((lower[j], lower[(j + 1) % sides], upper[(j + 1) % sides], upper[j]))
    mesh.faces.new(rings[0][::-1])
    mesh.faces.new(rings[-1])
    return finish(collection, name, mesh, material, smooth=sides > 4)
