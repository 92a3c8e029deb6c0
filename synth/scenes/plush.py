# SPDX-License-Identifier: GPL-3.0-or-later
"""Plush: geometry nodes that grow tufts of cloth on a mesh. Stuffed toys, bath mats, towels.

A tuft is a cone of three sides, some millimetres wide: about half a pixel of a picture of 400 × 400, so that
a pelt has its soft outline and its grain, at a fraction of the cost of hair.
"""

from __future__ import annotations

from collections.abc import Sequence

import bmesh
import bpy
from mathutils import Euler, Matrix, Vector

from . import materials as m
from .props import Point, finish

Colour = m.Colour
Blob = tuple[Point, Point, Point]
"""An ellipsoid: centre, half axes (metres), rotation (radians)."""


def pelt(name: str, root: Colour, tip: Colour, scale: float = 9.0) -> bpy.types.Material:
    """Every tuft has its own tone between ``root`` and ``tip``; patches of some centimetres."""
    material = bpy.data.materials.new(name)
    graph = m.Graph(material.node_tree)
    own = graph.add("ShaderNodeNewGeometry").outputs["Random Per Island"]
    patch = graph.noise(graph.coordinates(), scale, 2.0)
    tone = graph.math("ADD", graph.math("MULTIPLY", own, 0.55), graph.math("MULTIPLY", patch, 0.5))
    colour = graph.ramp(tone, [(0.15, root), (0.85, tip)])
    graph.finish(graph.add("ShaderNodeBsdfDiffuse", {"Color": colour}).outputs[0])
    return material


def blobs(
    room: bpy.types.Collection, name: str, parts: Sequence[Blob], place: Matrix, material: bpy.types.Material
) -> bpy.types.Object:
    """One mesh of ellipsoids that run into each other: the stuffed body under a pelt."""
    mesh = bmesh.new()
    for centre, axes, turn in parts:
        where = Matrix.LocRotScale(Vector(centre), Euler(turn), Vector(axes))
        bmesh.ops.create_icosphere(mesh, subdivisions=4, radius=1.0, matrix=where)
    item = finish(room, name, mesh, material, smooth=True)
    item.matrix_world = place
    return item


def tufted(
    item: bpy.types.Object,
    length: float,
    width: float,
    density: float,
    unruly: float = 0.35,
    fall: float = 0.35,
    seed: int = 0,
) -> None:
    """Grow tufts on ``item`` (a mesh that is not scaled), of the item's own material.

    ``length``, ``width``: of a tuft, metres; ``density``: tufts a square metre; ``unruly``: how far each
    leaves the normal; ``fall``: how far all hang down (0 straight out, 1 at 45°).
    """
    tree = bpy.data.node_groups.new(f"plush {item.name}", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    graph = m.Graph(tree)
    skin = graph.add("NodeGroupInput").outputs[0]
    spread = graph.add(
        "GeometryNodeDistributePointsOnFaces", {"Mesh": skin, "Density": density, "Seed": seed}
    )
    tuft = graph.add(
        "GeometryNodeMeshCone",
        {"Vertices": 3, "Radius Top": 0.0, "Radius Bottom": width / 2, "Depth": length},
        fill_type="NONE",
    )
    stray = graph.add(
        "FunctionNodeRandomValue",
        {"Min": (-unruly,) * 3, "Max": (unruly, unruly, unruly - fall), "Seed": seed + 1},
        data_type="FLOAT_VECTOR",
    )
    lean = graph.add(
        "ShaderNodeVectorMath", {"Vector": spread.outputs["Normal"], "Vector_001": stray.outputs[0]}
    )
    turn = graph.add("FunctionNodeAlignRotationToVector", {"Vector": lean.outputs[0]}, axis="Z")
    sizes = graph.add(
        "FunctionNodeRandomValue", {"Min": 0.6, "Max": 1.15, "Seed": seed + 2}, data_type="FLOAT"
    )
    placed = graph.add(
        "GeometryNodeInstanceOnPoints",
        {
            "Points": spread.outputs["Points"],
            "Instance": tuft.outputs["Mesh"],
            "Rotation": turn.outputs[0],
            "Scale": sizes.outputs[0],
        },
    )
    real = graph.add("GeometryNodeRealizeInstances", {"Geometry": placed.outputs[0]})
    coat = graph.add(
        "GeometryNodeSetMaterial", {"Geometry": real.outputs[0], "Material": item.data.materials[0]}
    )
    both = graph.add("GeometryNodeJoinGeometry")
    tree.links.new(coat.outputs[0], both.inputs[0])
    tree.links.new(skin, both.inputs[0])
    graph.add("NodeGroupOutput")
    tree.links.new(both.outputs[0], tree.nodes[-1].inputs[0])
    item.modifiers.new("plush", "NODES").node_group = tree
