# SPDX-License-Identifier: GPL-3.0-or-later
"""Plush: geometry nodes that grow tufts of cloth on a mesh. Stuffed toys, bath mats, towels.

A tuft is a cone of three sides, some millimetres wide: about half a pixel of a picture of 400 × 400, so that
a pelt has its soft outline and its grain, at a fraction of the cost of hair.
"""

from collections.abc import Sequence

import bmesh
import bpy
from mathutils import Euler, Matrix

from ..blender import Point, mesh_of
from .props import finish, modified
from .shading import Colour, Graph, Socket, begin, geometry_nodes

#: An ellipsoid: centre, half axes (metres), rotation (radians).
Blob = tuple[Point, Point, Point]

#: Attribute of a tuft: the normal where it stands.
SKIN = "skin normal"
#: Attribute of a tuft: 0 at its root, 1 at its tip.
ALONG = "along tuft"


def pelt(name: str, root: Colour, tip: Colour, scale: float = 9.0) -> bpy.types.Material:
    """Every tuft has its own tone between ``root`` and ``tip``; patches of some centimetres."""
    material, graph = begin(name)
    own = graph.add("ShaderNodeNewGeometry").outputs["Random Per Island"]
    patch = graph.noise(graph.coordinates(), scale, 2.0)
    tone = graph.math("ADD", graph.math("MULTIPLY", own, 0.35), graph.math("MULTIPLY", patch, 0.65))
    colour = shaded(graph, graph.ramp(tone, [(0.2, root), (0.8, tip)]))
    graph.finish(graph.add("ShaderNodeBsdfDiffuse", {"Color": colour, "Normal": soft(graph)}).outputs[0])
    return material


def shaded(graph: Graph, colour: Socket) -> Socket:
    """``colour`` darker toward the root of each tuft: tufts throw no shadows on each other (``tufted``)."""
    along = graph.add("ShaderNodeAttribute", attribute_name=ALONG).outputs["Fac"]
    return graph.mix(1.0, colour, graph.ramp(along, [(0.0, (0.66,) * 3), (0.8, (1.06,) * 3)]), "MULTIPLY")


def soft(graph: Graph) -> Socket:
    """Shading normals mostly of the skin that a tuft stands on: fur is lit as a whole, with less noise."""
    skin = graph.add("ShaderNodeAttribute", attribute_name=SKIN).outputs["Vector"]
    world = graph.add(
        "ShaderNodeVectorTransform",
        {"Vector": skin},
        vector_type="VECTOR",  # "NORMAL" divides by the length, which is 0 on the skin
        convert_from="OBJECT",
        convert_to="WORLD",
    ).outputs[0]
    own = graph.add("ShaderNodeNewGeometry").outputs["Normal"]
    doubled = graph.add("ShaderNodeVectorMath", {"Vector": world, "Scale": 1.6}, operation="SCALE").outputs[0]
    # Where there is no such attribute, on the skin itself, its own normal remains.
    both = graph.add("ShaderNodeVectorMath", {"Vector": doubled, "Vector_001": own}).outputs[0]
    return graph.add("ShaderNodeVectorMath", {"Vector": both}, operation="NORMALIZE").outputs[0]


def blobs(
    room: bpy.types.Collection, name: str, parts: Sequence[Blob], place: Matrix, material: bpy.types.Material
) -> bpy.types.Object:
    """One mesh of ellipsoids that run into each other: the stuffed body under a pelt."""
    mesh = bmesh.new()
    for centre, axes, turn in parts:
        where = Matrix.LocRotScale(centre, Euler(turn), axes)
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
) -> bpy.types.Object:
    """Grow tufts on ``item`` (a mesh that is not scaled), of the item's own material; they are returned.

    They throw no shadows, the skin under them does: what single tufts shade is finer than a pixel, and was
    most of the noise of the picture (30 dB at 64 samples; ``shaded`` makes up for it).

    ``length``, ``width``: of a tuft, metres; ``density``: tufts a square metre; ``unruly``: how far each
    leaves the normal; ``fall``: how far all hang down (0 straight out, 1 at 45°).
    """
    graph = geometry_nodes(f"plush {item.name}")
    skin = graph.add("NodeGroupInput").outputs[0]
    spread = graph.add(
        "GeometryNodeDistributePointsOnFaces", {"Mesh": skin, "Density": density, "Seed": seed}
    )
    tuft = graph.add(
        "GeometryNodeMeshCone",
        {"Vertices": 3, "Radius Top": 0.0, "Radius Bottom": width / 2, "Depth": length},
        fill_type="NONE",
    )
    height = graph.add("ShaderNodeSeparateXYZ", {"Vector": graph.add("GeometryNodeInputPosition").outputs[0]})
    measured = graph.add(
        "GeometryNodeStoreNamedAttribute",
        {
            "Geometry": tuft.outputs["Mesh"],
            "Name": ALONG,
            "Value": graph.math("DIVIDE", height.outputs["Z"], length),
        },
        data_type="FLOAT",
        domain="POINT",
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
    rooted = graph.add(
        "GeometryNodeStoreNamedAttribute",
        {"Geometry": spread.outputs["Points"], "Name": SKIN, "Value": spread.outputs["Normal"]},
        data_type="FLOAT_VECTOR",
        domain="POINT",
    )
    placed = graph.add(
        "GeometryNodeInstanceOnPoints",
        {
            "Points": rooted.outputs[0],
            "Instance": measured.outputs[0],
            "Rotation": turn.outputs[0],
            "Scale": sizes.outputs[0],
        },
    )
    real = graph.add("GeometryNodeRealizeInstances", {"Geometry": placed.outputs[0]})
    coat = graph.add(
        "GeometryNodeSetMaterial", {"Geometry": real.outputs[0], "Material": mesh_of(item).materials[0]}
    )
    graph.tree.links.new(coat.outputs[0], graph.add("NodeGroupOutput").inputs[0])
    coated = bpy.data.objects.new(f"{item.name} plush", item.data)
    coated.parent = item
    coated.visible_shadow = False
    modified(coated, "plush", "NODES", node_group=graph.tree)
    item.users_collection[0].objects.link(coated)
    return coated
