# SPDX-License-Identifier: GPL-3.0-or-later
"""Further building blocks: things turned together, leaves scattered by geometry nodes."""

import itertools
import math
from collections.abc import Iterator
from contextlib import contextmanager

import bmesh
import bpy
from mathutils import Vector

from ..blender import Point
from .props import modified
from .shading import geometry_nodes


def hanging(start: Point, end: Point, sag: float, steps: int = 12) -> list[Vector]:
    """Points of a cord between two hooks; the parabola differs from the catenary by less than its width."""
    a, b = Vector(start), Vector(end)
    return [
        a.lerp(b, k / steps) - Vector((0.0, 0.0, 4.0 * sag * (k / steps) * (1.0 - k / steps)))
        for k in range(steps + 1)
    ]


def copy(
    collection: bpy.types.Collection, item: bpy.types.Object, location: Point, turn: float = 0.0
) -> bpy.types.Object:
    """The same mesh once more, upright at another place: Cycles keeps it only once."""
    twin = item.copy()
    twin.location, twin.rotation_euler = location, (0.0, 0.0, turn)
    collection.objects.link(twin)
    return twin


@contextmanager
def turned(collection: bpy.types.Collection, name: str, at: Point, turn: float) -> Iterator[None]:
    """What is built within, about the origin, is moved to ``at`` and turned about Z (radians)."""
    before = set(collection.objects)
    yield
    pivot = bpy.data.objects.new(name, None)
    pivot.location, pivot.rotation_euler = at, (0.0, 0.0, turn)
    for item in collection.objects:
        if item not in before and item.parent is None:
            item.parent = pivot
    collection.objects.link(pivot)


def scatter(
    host: bpy.types.Object,
    item: bpy.types.Object,
    density: float,
    scale: tuple[float, float] = (0.7, 1.2),
    tilt: float = 0.6,
    seed: int = 0,
) -> None:
    """Strew ``item`` over ``host``'s faces by geometry nodes: ``density`` a square metre, Z along the normal.

    ``tilt``: up to how far they lean, in radians; about the normal they turn at random.
    """
    graph = geometry_nodes(f"scatter {host.name}")
    new, link = graph.add, graph.tree.links.new
    source, result = new("NodeGroupInput"), new("NodeGroupOutput")
    points = new("GeometryNodeDistributePointsOnFaces")
    points.inputs["Density"].default_value = density
    points.inputs["Seed"].default_value = seed
    thing = new("GeometryNodeObjectInfo")
    thing.inputs["Object"].default_value = item
    spin = new("FunctionNodeRandomValue")
    spin.data_type = "FLOAT_VECTOR"
    spin.inputs["Min"].default_value = (-tilt, -tilt, 0.0)
    spin.inputs["Max"].default_value = (tilt, tilt, 2.0 * math.pi)
    spin.inputs["Seed"].default_value = seed + 1
    leaning = new("FunctionNodeRotateRotation")
    leaning.rotation_space = "LOCAL"
    sizes = new("FunctionNodeRandomValue")
    lowest, highest = (socket for socket in sizes.inputs if socket.type == "VALUE")
    lowest.default_value, highest.default_value = scale
    sizes.inputs["Seed"].default_value = seed + 2
    placed, both = new("GeometryNodeInstanceOnPoints"), new("GeometryNodeJoinGeometry")
    link(source.outputs[0], points.inputs["Mesh"])
    link(points.outputs["Points"], placed.inputs["Points"])
    link(points.outputs["Rotation"], leaning.inputs["Rotation"])
    link(spin.outputs["Value"], leaning.inputs["Rotate By"])
    link(thing.outputs["Geometry"], placed.inputs["Instance"])
    link(leaning.outputs["Rotation"], placed.inputs["Rotation"])
    link(next(socket for socket in sizes.outputs if socket.enabled), placed.inputs["Scale"])
    link(source.outputs[0], both.inputs[0])
    link(placed.outputs["Instances"], both.inputs[0])
    link(both.outputs[0], result.inputs[0])
    modified(host, "scatter", "NODES", node_group=graph.tree)


def leaf(name: str, length: float, width: float, material: bpy.types.Material) -> bpy.types.Object:
    """One small leaf for ``scatter``, folded along its rib, rooted at the origin; in no collection itself."""
    mesh = bmesh.new()
    rows = []
    for k in range(5):
        t = k / 4
        half = 0.5 * width * math.sin(math.pi * (0.12 + 0.88 * t)) ** 0.8
        up = length * (0.5 * t - 0.35 * t * t)
        rows.append([mesh.verts.new((length * t, s * half, up + abs(s) * half * 0.5)) for s in (-1, 0, 1)])
    for lower, upper in itertools.pairwise(rows):
        for k in (0, 1):
            mesh.faces.new((lower[k], lower[k + 1], upper[k + 1], upper[k]))
    data = bpy.data.meshes.new(name)
    mesh.to_mesh(data)
    mesh.free()
    data.shade_smooth()
    data.materials.append(material)
    return bpy.data.objects.new(name, data)
