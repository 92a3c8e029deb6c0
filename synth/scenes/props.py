# SPDX-License-Identifier: GPL-3.0-or-later
"""Building blocks of furniture: each function adds one mesh object to a collection and returns it.

Only bmesh and the data API are used, no operators: they work without a window or an active object.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import bmesh
import bpy
from mathutils import Matrix, Vector

from ..blender import Point


class Links(Protocol):
    """Where objects are put."""

    def link(self, item: bpy.types.Object, /) -> None: ...


class Holder(Protocol):
    """A collection, or what stands in for one."""

    @property
    def objects(self) -> Links: ...


def finish(
    collection: Holder,
    name: str,
    mesh: bmesh.types.BMesh,
    material: bpy.types.Material,
    smooth: bool = False,
) -> bpy.types.Object:
    """Turn a bmesh into an object of ``collection`` and free the bmesh."""
    data = bpy.data.meshes.new(name)
    bmesh.ops.recalc_face_normals(mesh, faces=list(mesh.faces))
    mesh.to_mesh(data)
    mesh.free()
    if smooth:
        data.shade_smooth()
    data.materials.append(material)
    item = bpy.data.objects.new(name, data)
    collection.objects.link(item)
    return item


def modified(item: bpy.types.Object, name: str, kind: str, **settings: Any) -> None:
    """Give an object a modifier of Blender's type ``kind``."""
    new: Any = item.modifiers.new
    modifier = new(name, kind)
    for key, value in settings.items():
        setattr(modifier, key, value)


def repeated(item: bpy.types.Object, count: int, step: Point, name: str = "array") -> bpy.types.Object:
    """Show an object ``count`` times, each ``step`` metres (its own axes) further."""
    offset = {"use_relative_offset": False, "use_constant_offset": True, "constant_offset_displace": step}
    modified(item, name, "ARRAY", count=count, **offset)
    return item


def doubled(mesh: bmesh.types.BMesh, faces: Sequence[bmesh.types.BMFace]) -> list[bmesh.types.BMVert]:
    """Make a sheet the closed skin of a slab: copies of its vertices, which are returned to be moved, of its
    faces, and walls along its rim.

    ``bmesh.ops.extrude_face_region`` does it in the order of memory addresses: other bits in every run.
    """
    corners = list(dict.fromkeys(vertex for face in faces for vertex in face.verts))
    copies = {vertex: mesh.verts.new(vertex.co) for vertex in corners}
    rim = [loop for face in faces for loop in face.loops if len(loop.edge.link_faces) == 1]
    walls = [(loop.link_loop_next.vert, loop.vert) for loop in rim]
    for face in faces:
        mesh.faces.new([copies[vertex] for vertex in reversed(face.verts)])
    for start, end in walls:
        mesh.faces.new((start, end, copies[end], copies[start]))
    return list(copies.values())


def box(
    collection: Holder,
    name: str,
    centre: Point,
    size: Point,
    material: bpy.types.Material,
    rotation: Point = (0.0, 0.0, 0.0),
    bevel: float = 0.0,
) -> bpy.types.Object:
    """A box (full ``size`` in metres), its edges rounded where ``bevel`` > 0."""
    mesh = bmesh.new()
    bmesh.ops.create_cube(mesh, size=1.0, matrix=Matrix.Diagonal((*size, 1.0)))
    item = finish(collection, name, mesh, material)
    item.location, item.rotation_euler = centre, rotation
    if bevel > 0.0:
        modified(item, "bevel", "BEVEL", width=bevel, segments=2)
    return item


def rod(
    collection: Holder,
    name: str,
    start: Point,
    end: Point,
    radius: float,
    material: bpy.types.Material,
    end_radius: float | None = None,
    sides: int = 12,
) -> bpy.types.Object:
    """A round bar from ``start`` to ``end``: legs, poles, cords. Its own Z is its length."""
    a, b = Vector(start), Vector(end)
    mesh = bmesh.new()
    bmesh.ops.create_cone(
        mesh,
        cap_ends=True,
        segments=sides,
        radius1=radius,
        radius2=radius if end_radius is None else end_radius,
        depth=(b - a).length,
    )
    item = finish(collection, name, mesh, material, smooth=sides > 8)
    item.location = (a + b) / 2
    item.rotation_mode = "QUATERNION"
    item.rotation_quaternion = (b - a).to_track_quat("Z", "Y")
    return item


def lathe(
    collection: Holder,
    name: str,
    location: Point,
    profile: Sequence[tuple[float, float]],
    material: bpy.types.Material,
    sides: int = 32,
) -> bpy.types.Object:
    """A turned body: ``profile`` is (radius, height) from the foot to the rim."""
    mesh = bmesh.new()
    rings = []
    for radius, height in profile:
        angles = [2.0 * math.pi * k / sides for k in range(sides)]
        ring = [
            mesh.verts.new((max(radius, 1e-4) * math.cos(a), max(radius, 1e-4) * math.sin(a), height))
            for a in angles
        ]
        rings.append(ring)
    for lower, upper in itertools.pairwise(rings):
        for k in range(sides):
            mesh.faces.new((lower[k], lower[(k + 1) % sides], upper[(k + 1) % sides], upper[k]))
    item = finish(collection, name, mesh, material, smooth=True)
    item.location = location
    return item


def ball(
    collection: Holder,
    name: str,
    centre: Point,
    radius: float,
    material: bpy.types.Material,
    subdivisions: int = 3,
    lumps: float = 0.0,
    seed: float = 0.0,
) -> bpy.types.Object:
    """A sphere, or with ``lumps`` (metres) a crown of a tree."""
    mesh = bmesh.new()
    bmesh.ops.create_icosphere(mesh, subdivisions=subdivisions, radius=radius)
    if lumps > 0.0:
        for vertex in mesh.verts:
            p = vertex.co / radius * 3.0
            wobble = math.sin(p.x * 2.1 + seed) * math.sin(p.y * 2.7 + 2 * seed) + 0.6 * math.sin(
                p.z * 3.3 + seed
            )
            vertex.co += vertex.co.normalized() * lumps * wobble
    item = finish(collection, name, mesh, material, smooth=True)
    item.location = centre
    return item


def cushion(
    collection: Holder,
    name: str,
    centre: Point,
    size: Point,
    material: bpy.types.Material,
    rotation: Point = (0.0, 0.0, 0.0),
    plump: float = 0.6,
) -> bpy.types.Object:
    """A soft block: full in the middle, thin toward its seams (``plump`` 0: a block, 1: a pillow)."""
    mesh = bmesh.new()
    bmesh.ops.create_grid(mesh, x_segments=10, y_segments=10, size=0.5)
    top = set(doubled(mesh, mesh.faces[:]))
    for vertex in mesh.verts:
        x, y = vertex.co.x, vertex.co.y
        fall = (1.0 - (2 * x) ** 4) * (1.0 - (2 * y) ** 4)
        thickness = 0.5 * (1.0 - plump + plump * max(fall, 0.0) ** 0.5)
        vertex.co.z = thickness if vertex in top else -thickness
        pinch = 1.0 - 0.06 * plump * ((2 * x) ** 2 + (2 * y) ** 2 - (4 * x * y) ** 2)
        vertex.co.x, vertex.co.y = x * pinch, y * pinch
    bmesh.ops.scale(mesh, vec=size, verts=list(mesh.verts))
    item = finish(collection, name, mesh, material, smooth=True)
    item.location, item.rotation_euler = centre, rotation
    modified(item, "round", "SUBSURF", render_levels=1)
    return item


def sheet(
    collection: Holder,
    name: str,
    surface: Callable[[float, float], Point],
    material: bpy.types.Material,
    steps: tuple[int, int] = (24, 24),
    thickness: float = 0.0,
) -> bpy.types.Object:
    """A surface over (u, v) in 0…1: curtains, a throw, terrain."""
    mesh = bmesh.new()
    nu, nv = steps
    grid = [[mesh.verts.new(surface(i / nu, j / nv)) for j in range(nv + 1)] for i in range(nu + 1)]
    for i in range(nu):
        for j in range(nv):
            mesh.faces.new((grid[i][j], grid[i + 1][j], grid[i + 1][j + 1], grid[i][j + 1]))
    item = finish(collection, name, mesh, material, smooth=True)
    if thickness > 0.0:
        modified(item, "thick", "SOLIDIFY", thickness=thickness)
    return item


def leaf_blade(
    collection: Holder,
    name: str,
    root: Point,
    direction: float,
    length: float,
    width: float,
    material: bpy.types.Material,
    rise: float = 0.7,
    droop: float = 0.6,
) -> bpy.types.Object:
    """A lance-shaped leaf from ``root``: rises, arches and droops toward ``direction`` (radians about Z)."""
    heading = Vector((math.cos(direction), math.sin(direction), 0.0))
    side = Vector((-heading.y, heading.x, 0.0))

    def surface(u: float, v: float) -> Point:
        along = heading * (length * u * (1.0 - 0.25 * u))
        height = length * (rise * u - droop * u * u)
        half = width * (math.sin(math.pi * min(u * 0.97 + 0.03, 1.0)) ** 0.8) * (v - 0.5)
        fold = abs(v - 0.5) * width * 0.5 * math.sin(math.pi * u)
        return Vector(root) + along + side * half + Vector((0.0, 0.0, height + fold))

    return sheet(collection, name, surface, material, steps=(10, 2))
