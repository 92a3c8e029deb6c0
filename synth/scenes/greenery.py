# SPDX-License-Identifier: GPL-3.0-or-later
"""Plants whose leaves are set by geometry nodes: one leaf, many points with a rotation and a size each."""

import itertools
import math
import random
from collections.abc import Sequence
from typing import Any

import bmesh
import bpy
import numpy as np
from mathutils import Euler, Vector

from .props import finish, modified
from .shading import Colour, begin, geometry_nodes
from .tubes import tube

Collection = bpy.types.Collection


def leaf_mesh(
    room: Collection,
    name: str,
    material: bpy.types.Material,
    width: float = 0.42,
    droop: float = 0.35,
    waves: float = 0.0,
) -> bpy.types.Object:
    """A leaf one metre long from its origin along +Y, folded along its rib, drooping; hidden itself."""
    mesh = bmesh.new()
    steps, across = 12, (-1.0, -0.5, 0.0, 0.5, 1.0)
    rows = []
    for k in range(steps + 1):
        t = k / steps
        half = width / 2 * math.sin(math.pi * (0.02 + 0.97 * t) ** 0.8) ** 0.75
        sag = -droop * t * t
        rows.append(
            [
                mesh.verts.new(
                    (s * half, t, sag + 0.35 * half * abs(s) + waves * math.sin(9.0 * t + 1.5 * s) * abs(s))
                )
                for s in across
            ]
        )
    for lower, upper in itertools.pairwise(rows):
        for j in range(len(across) - 1):
            mesh.faces.new((lower[j], lower[j + 1], upper[j + 1], upper[j]))
    item = finish(room, name, mesh, material, smooth=True)
    item.hide_render = item.hide_viewport = True
    return item


def leaf_colour(name: str, dark: Colour, light: Colour) -> bpy.types.Material:
    """For ``leaf_mesh``: a pale rib, darker flanks, broad clouds. Finer veins would be below a pixel."""
    material, graph = begin(name)
    vector = graph.coordinates()
    aside = graph.math("ABSOLUTE", graph.add("ShaderNodeSeparateXYZ", {"Vector": vector}).outputs["X"], 0.0)
    tone = graph.math("ADD", graph.math("MULTIPLY", aside, 2.2), graph.noise(vector, 2.2, 1.0))
    colour = graph.ramp(tone, [(0.42, light), (0.85, dark)])
    graph.surface(colour, 0.42, specular=0.35)
    return material


def foliage(
    room: Collection,
    name: str,
    leaf: bpy.types.Object,
    leaves: Sequence[tuple[Vector, Euler, float]],
) -> bpy.types.Object:
    """``leaf`` at each (place, rotation, length in metres), instanced by a geometry nodes modifier."""
    cloud = bpy.data.meshes.new(name)
    cloud.vertices.add(len(leaves))
    cloud.vertices.foreach_set("co", np.array([place for place, _, _ in leaves], np.float32).ravel())
    turns: Any = cloud.attributes.new("turn", "FLOAT_VECTOR", "POINT")
    turns.data.foreach_set("vector", np.array([[*turn] for _, turn, _ in leaves], np.float32).ravel())
    sizes: Any = cloud.attributes.new("size", "FLOAT", "POINT")
    sizes.data.foreach_set("value", np.array([size for _, _, size in leaves], np.float32))
    item = bpy.data.objects.new(name, cloud)
    room.objects.link(item)
    modified(item, "leaves", "NODES", node_group=_instancer(name, leaf))
    return item


def _instancer(name: str, leaf: bpy.types.Object) -> bpy.types.NodeTree:
    graph = geometry_nodes(f"leaves of {name}")
    source = graph.add("NodeGroupInput")
    blade = graph.add("GeometryNodeObjectInfo", {"Object": leaf})
    turn = graph.add("GeometryNodeInputNamedAttribute", {"Name": "turn"}, data_type="FLOAT_VECTOR")
    size = graph.add("GeometryNodeInputNamedAttribute", {"Name": "size"}, data_type="FLOAT")
    placed = graph.add("GeometryNodeInstanceOnPoints")
    sink = graph.add("NodeGroupOutput")
    link = graph.tree.links.new
    link(source.outputs[0], placed.inputs["Points"])
    link(blade.outputs["Geometry"], placed.inputs["Instance"])
    link(next(s for s in turn.outputs if s.enabled), placed.inputs["Rotation"])
    link(next(s for s in size.outputs if s.enabled), placed.inputs["Scale"])
    link(placed.outputs[0], sink.inputs[0])
    return graph.tree


def arching(
    room: Collection,
    name: str,
    foot: Sequence[float],
    leaf: bpy.types.Object,
    stem: bpy.types.Material,
    dice: random.Random,
    stems: int,
    height: float,
    length: float,
    spread: float = 0.35,
) -> None:
    """A tuft of ``stems`` from ``foot``, each an arc that ends in one broad leaf (fig, monstera, lily)."""
    leaves = []
    for k in range(stems):
        angle = k * 2.399963 + dice.uniform(-0.25, 0.25)  # golden angle
        rise = height * dice.uniform(0.45, 1.0) * (1.0 - 0.35 * k / stems)
        out = spread * dice.uniform(0.5, 1.0) * (0.35 + 0.65 * k / stems)
        heading = Vector((math.cos(angle), math.sin(angle), 0.0))
        path = [
            Vector(foot) + heading * (0.02 + out * t**1.6) + Vector((0.0, 0.0, rise * t))
            for t in (0.0, 0.3, 0.55, 0.8, 1.0)
        ]
        tube(room, f"{name} stem", path, 0.007, stem, 7, 0.004)
        tilt = dice.uniform(-0.45, 0.35)
        turn = Euler((tilt, dice.uniform(-0.3, 0.3), angle - math.pi / 2))
        leaves.append((path[-1], turn, length * dice.uniform(0.75, 1.1)))
    foliage(room, f"{name} leaves", leaf, leaves)


def trailing(
    room: Collection,
    name: str,
    paths: Sequence[Sequence[Vector]],
    leaf: bpy.types.Object,
    stem: bpy.types.Material,
    dice: random.Random,
    spacing: float,
    length: float,
) -> None:
    """Vines along ``paths`` with leaves to both sides every ``spacing`` metres (ivy, pothos)."""
    leaves = []
    for path in paths:
        tube(room, f"{name} vine", path, 0.003, stem, 6, 0.002)
        for start, end in itertools.pairwise(path):
            steps = max(1, round((end - start).length / spacing))
            for k in range(steps):
                angle = dice.uniform(0.0, 2.0 * math.pi)
                turn = Euler((dice.uniform(-0.9, 0.1), dice.uniform(-0.4, 0.4), angle))
                leaves.append((start.lerp(end, (k + 0.5) / steps), turn, length * dice.uniform(0.7, 1.15)))
    foliage(room, f"{name} leaves", leaf, leaves)
