# SPDX-License-Identifier: GPL-3.0-or-later
"""The dog of ``dog``: a tricoloured hound that lies with its head up, after nature rather than any model.

Body, head and ears are each a heap of tapered capsules, made one skin by a voxel remesh and smoothing; the
fur is a geometry-nodes modifier that sets thin cones on that skin.
"""

import math
from collections.abc import Sequence

import bmesh
import bpy
from mathutils import Euler, Matrix, Vector

from . import materials as m
from . import materials_hearth as mh
from . import materials_table as mt
from .forms import move, ring
from .props import ball, finish, modified
from .shading import Socket, geometry_nodes
from .tubes import bent_tube

Collection = bpy.types.Collection
Capsule = tuple[tuple[float, float, float], float, tuple[float, float, float], float]

TAN, DARK, WHITE = (0.36, 0.155, 0.055), (0.028, 0.018, 0.014), (0.62, 0.56, 0.47)
VOXEL = 0.010  # metres


def dog(room: Collection, place: Matrix) -> None:
    """Lay the dog down at ``place``; it faces the place's −Y, about 0.5 × 1.15 × 0.62 m."""
    body_coat = mh.coat(
        "body coat",
        TAN,
        [
            (DARK, [(2, 0.17, 0.21), (1, -0.20, -0.14)]),
            (WHITE, [(1, -0.25, -0.30), (0, 0.14, 0.09)]),
            (WHITE, [(2, 0.075, 0.045)]),
            (WHITE, [(1, 0.60, 0.66)]),
        ],
    )
    made = [_skin(room, "dog body", _body(), body_coat, 0.024, 40_000.0)]
    claws = m.plain("claws", (0.05, 0.04, 0.035), 0.4)
    for s in (-1, 1):
        for k in (-1, 0, 1):
            x, y = s * 0.115 + 0.022 * k, -0.555 + 0.012 * abs(k)
            made.append(ball(room, "claw", (x, y, 0.018), 0.008, claws, 2))
    leather = mh.leather("collar", (0.26, 0.03, 0.02), (0.44, 0.06, 0.04))
    tilt = (math.radians(33.0), 0.0, 0.0)
    for k in range(3):
        made.append(
            ring(
                room,
                "collar",
                (0, -0.285 - 0.008 * k, 0.345 + 0.012 * k),
                0.114 - 0.002 * k,
                0.011,
                leather,
                tilt,
            )
        )
    tag = mt.metal("tag", (0.80, 0.58, 0.22), 0.2)
    made.append(ball(room, "tag", (0.0, -0.405, 0.285), 0.024, tag, 3))
    made[-1].scale = (1.0, 0.25, 1.0)
    head = _head(room)
    nod = Euler((math.radians(6.0), math.radians(-5.0), math.radians(32.0))).to_matrix().to_4x4()
    move(head, Matrix.Translation((0.0, -0.355, 0.505)) @ nod)
    move([*made, *head], place)


def _body() -> list[Capsule]:
    shapes: list[Capsule] = [
        ((0, -0.20, 0.215), 0.152, (0, 0.05, 0.185), 0.150),  # chest
        ((0, 0.02, 0.185), 0.148, (0, 0.34, 0.155), 0.142),  # loins
        ((0, -0.23, 0.26), 0.125, (0, -0.335, 0.42), 0.088),  # neck
        ((0, -0.30, 0.16), 0.095, (0, -0.26, 0.24), 0.11),  # breast
        ((0.02, 0.45, 0.12), 0.042, (0.14, 0.56, 0.05), 0.034),  # tail
        ((0.14, 0.56, 0.05), 0.034, (0.30, 0.52, 0.04), 0.028),
        ((0.30, 0.52, 0.04), 0.028, (0.36, 0.40, 0.035), 0.017),
    ]
    for s in (-1, 1):
        shapes += [
            ((s * 0.085, -0.18, 0.24), 0.09, (s * 0.13, -0.23, 0.13), 0.08),  # shoulder
            ((s * 0.13, -0.22, 0.12), 0.068, (s * 0.15, -0.12, 0.055), 0.052),  # upper arm
            ((s * 0.15, -0.12, 0.052), 0.050, (s * 0.118, -0.42, 0.043), 0.038),  # forearm
            ((s * 0.118, -0.44, 0.040), 0.042, (s * 0.115, -0.515, 0.034), 0.040),  # paw
            ((s * 0.11, 0.31, 0.16), 0.125, (s * 0.165, 0.17, 0.10), 0.085),  # thigh
            ((s * 0.165, 0.17, 0.10), 0.082, (s * 0.185, 0.08, 0.07), 0.055),  # knee
            ((s * 0.19, 0.08, 0.055), 0.045, (s * 0.215, 0.30, 0.042), 0.034),  # shank
            ((s * 0.215, 0.30, 0.038), 0.034, (s * 0.22, 0.10, 0.032), 0.033),  # hind foot
        ]
        for k in (-1, 0, 1):  # toes
            x, y = s * 0.115 + 0.022 * k, -0.535 + 0.010 * abs(k)
            shapes.append(((x, y + 0.04, 0.030), 0.018, (x, y, 0.024), 0.019))
    return shapes


def _head(room: Collection) -> list[bpy.types.Object]:
    """About the middle of the skull, facing −Y."""
    shapes: list[Capsule] = [
        ((0, 0.01, 0.012), 0.083, (0, -0.035, 0.005), 0.078),  # skull
        ((0, -0.05, -0.022), 0.060, (0, -0.150, -0.038), 0.043),  # muzzle
        ((0, -0.06, 0.002), 0.035, (0, -0.155, -0.018), 0.026),  # bridge of the nose
        ((0, -0.04, -0.068), 0.042, (0, -0.130, -0.080), 0.024),  # jaw
        ((0, 0.03, -0.05), 0.075, (0, 0.075, -0.15), 0.088),  # neck
    ]
    for s in (-1, 1):
        shapes += [
            ((s * 0.042, -0.03, -0.035), 0.050, (s * 0.030, -0.06, -0.05), 0.042),  # cheek
            ((s * 0.022, -0.12, -0.045), 0.036, (s * 0.020, -0.150, -0.052), 0.030),  # flews
            ((s * 0.034, -0.062, 0.040), 0.024, (s * 0.050, -0.045, 0.036), 0.020),  # brow
        ]
    coat = mh.coat(
        "head coat",
        TAN,
        [
            (WHITE, [(1, -0.095, -0.125)]),
            (WHITE, [(0, 0.022, 0.008), (1, 0.03, -0.01)]),
            (WHITE, [(2, -0.10, -0.13)]),
        ],
    )
    made = [_skin(room, "dog head", shapes, coat, 0.013, 60_000.0)]
    ear_coat = mh.coat("ear coat", (0.16, 0.06, 0.024), [(DARK, [(2, -0.06, -0.12)])])
    for s in (-1, 1):
        flap: list[Capsule] = [
            ((0.0, 0.0, 0.02), 0.026, (0.0, -0.004, -0.03), 0.046),
            ((0.0, -0.004, -0.03), 0.046, (0.0, -0.018, -0.105), 0.036),
        ]
        ear = _skin(room, "dog ear", flap, ear_coat, 0.014, 45_000.0, thin=0.30)
        ear.matrix_basis = (
            Matrix.Translation((s * 0.083, 0.012, 0.042))
            @ Euler((0.06, s * -0.24, s * 0.25)).to_matrix().to_4x4()
        )
        made.append(ear)
    wet = m.plain("nose", (0.012, 0.010, 0.010), 0.22)
    nose = ball(room, "nose", (0, -0.192, -0.016), 0.025, wet, 3)
    nose.scale = (1.1, 0.72, 0.85)
    iris, pupil = m.plain("iris", (0.11, 0.045, 0.012), 0.06), m.plain("pupil", (0.004, 0.003, 0.003), 0.05)
    lid = m.plain("lid", (0.015, 0.01, 0.008), 0.6)
    made.append(nose)
    for s in (-1, 1):
        made.append(ball(room, "eye", (s * 0.041, -0.090, 0.020), 0.0185, iris, 3))
        made.append(ball(room, "pupil", (s * 0.0425, -0.100, 0.0205), 0.0105, pupil, 3))
        glance = (math.radians(72.0), 0.0, s * 0.30)
        made.append(ring(room, "lid", (s * 0.042, -0.096, 0.0205), 0.0165, 0.0035, lid, glance, 20))
    mouth = [(0.0, -0.195, -0.066), (0.022, -0.180, -0.078), (0.045, -0.130, -0.078), (0.060, -0.085, -0.066)]
    for s in (-1, 1):
        made.append(bent_tube(room, "mouth", [(s * x, y, z) for x, y, z in mouth], 0.0035, lid, 6, 4))
    return made


def _skin(
    room: Collection,
    name: str,
    capsules: Sequence[Capsule],
    coat: bpy.types.Material,
    hair: float,
    density: float,
    thin: float = 1.0,
) -> bpy.types.Object:
    """Capsules that become one skin with fur; ``hair``: its length, ``density``: hairs a square metre,
    ``thin``: scale of X."""
    mesh = bmesh.new()
    for a, ra, b, rb in capsules:
        start, end = Vector(a), Vector(b)
        axis = (end - start).normalized()
        for vertex in bmesh.ops.create_icosphere(mesh, subdivisions=3, radius=1.0)["verts"]:
            way = vertex.co.copy()
            vertex.co = end + rb * way if way.dot(axis) > 0.0 else start + ra * way
    bmesh.ops.scale(mesh, vec=(thin, 1.0, 1.0), verts=list(mesh.verts))
    item = finish(room, name, mesh, coat, smooth=True)
    size = VOXEL if thin == 1.0 else 0.6 * VOXEL
    modified(item, "one skin", "REMESH", mode="VOXEL", voxel_size=size, use_smooth_shade=True)
    modified(item, "soft", "SMOOTH", factor=0.5, iterations=7)
    modified(item, "fur", "NODES", node_group=_fur(name, coat, hair, density))
    return item


def _fur(name: str, coat: bpy.types.Material, hair: float, density: float) -> bpy.types.NodeTree:
    """Geometry nodes: thin cones on the skin, combed back and down, ragged."""
    graph = geometry_nodes(f"fur {name}")
    new, link = graph.add, graph.tree.links.new
    source, sink = new("NodeGroupInput"), new("NodeGroupOutput")
    points = new("GeometryNodeDistributePointsOnFaces")
    points.inputs["Density"].default_value = density
    link(source.outputs[0], points.inputs["Mesh"])

    def vector(operation: str, a: Socket, b: Socket, scale: float | None = None) -> Socket:
        node = new("ShaderNodeVectorMath", operation=operation)
        for socket, value in zip(node.inputs, (a, b), strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                link(value, socket)
            elif value is not None:
                socket.default_value = value
        if scale is not None:
            node.inputs["Scale"].default_value = scale
        return node.outputs[0]

    noise = new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 22.0
    link(new("GeometryNodeInputPosition").outputs[0], noise.inputs["Vector"])
    ragged = vector("SUBTRACT", noise.outputs["Color"], (0.5, 0.5, 0.5))
    combed = vector("ADD", vector("SCALE", ragged, None, 1.6), (0.0, 0.75, -0.45))
    upright = vector("SCALE", points.outputs["Normal"], None, 0.62)
    align = new("FunctionNodeAlignRotationToVector")
    align.axis = "Z"
    link(vector("ADD", combed, upright), align.inputs["Vector"])
    cone = new("GeometryNodeMeshCone")
    cone.fill_type = "NONE"
    for socket, value in (("Vertices", 3), ("Radius Bottom", 0.0033), ("Radius Top", 0.0), ("Depth", hair)):
        cone.inputs[socket].default_value = value
    length = new("FunctionNodeRandomValue")
    length.data_type = "FLOAT"
    low, high = [s for s in length.inputs if s.type == "VALUE"][:2]
    low.default_value, high.default_value = 0.55, 1.2
    hairs = new("GeometryNodeInstanceOnPoints")
    link(points.outputs["Points"], hairs.inputs["Points"])
    link(cone.outputs["Mesh"], hairs.inputs["Instance"])
    link(align.outputs[0], hairs.inputs["Rotation"])
    link(next(s for s in length.outputs if s.type == "VALUE"), hairs.inputs["Scale"])
    real, dyed, both = (
        new("GeometryNodeRealizeInstances"),
        new("GeometryNodeSetMaterial"),
        new("GeometryNodeJoinGeometry"),
    )
    dyed.inputs["Material"].default_value = coat
    link(hairs.outputs[0], real.inputs[0])
    link(real.outputs[0], dyed.inputs["Geometry"])
    link(dyed.outputs[0], both.inputs[0])
    link(source.outputs[0], both.inputs[0])
    link(both.outputs[0], sink.inputs[0])
    return graph.tree
