# SPDX-License-Identifier: GPL-3.0-or-later
"""A model's bounds in the 3D view while the shader draws it: those of a capture without what is far away.

A few Gaussians stand for the sky and for what is behind windows, hundreds of metres away. Blender's bounds
have all points in them, and so *View Selected* would show a room as a dot. A modifier of the 3D view alone
puts out two points instead, the corners of a box around the others; no files, edits or renders know it.
"""

from typing import Any

import bpy
import numpy as np

from ..blender import cloud_of, marked_when_whole
from ..model.attributes import POSITION
from ..model.node_builder import GeometryBuilder
from ..model.nodes import set_input
from ..model.point_cloud import read_attribute

NAME = "PhysHDR Bounds (3D View)"
LOW, HIGH = "Low", "High"
#: Far away: so many times farther from the middle of all points than half of them are.
FAR = 3.0
#: Points that tell the middle.
SAMPLED = 20_000
_MARK = "physhdr_bounds"
_RECIPE = 1


def box_of(position: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners ``[3]`` of the box around what is not far away, of ``[N, 3]``; None where nothing is far."""
    if not len(position):
        return None
    sampled = position[:: -(-len(position) // SAMPLED)]
    middle = np.median(sampled, axis=0)
    near = FAR * np.median(np.linalg.norm(sampled - middle, axis=1))
    is_near = np.linalg.norm(position - middle, axis=1) <= near
    if near == 0.0 or is_near.all():
        return None
    return position[is_near].min(axis=0), position[is_near].max(axis=0)


def limit(target: bpy.types.Object) -> None:
    """Let Blender take a model for as large as what is not far away of it, by its points as they are now."""
    box = box_of(read_attribute(cloud_of(target), POSITION.name))
    modifier = _find(target)
    if box is None or target.library is not None:
        remove(target)
        return
    if modifier is None:
        modifier: Any = target.modifiers.new(NAME, "NODES")
        modifier.node_group = _tree()
        modifier.show_render = modifier.show_in_editmode = modifier.show_expanded = False
    for label, corner in zip((LOW, HIGH), box, strict=True):
        set_input(modifier, label, corner.tolist())


def remove(target: bpy.types.Object) -> None:
    """Let Blender take a model for as large as all of its points."""
    if (modifier := _find(target)) is not None and target.library is None:
        target.modifiers.remove(modifier)


def _find(target: bpy.types.Object) -> bpy.types.Modifier | None:
    for modifier in target.modifiers:
        tree = modifier.node_group if isinstance(modifier, bpy.types.NodesModifier) else None
        if tree is not None and _MARK in tree:
            return modifier
    return None


def _tree() -> bpy.types.NodeTree:
    """The file's tree: two points of no size."""
    for tree in bpy.data.node_groups:
        if tree.get(_MARK) == _RECIPE and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(NAME, "GeometryNodeTree")
    assert isinstance(tree, bpy.types.GeometryNodeTree)
    with marked_when_whole(tree, _MARK, _RECIPE):
        tree.is_modifier = True
        interface: Any = tree.interface
        interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
        for label in (LOW, HIGH):
            interface.new_socket(label, in_out="INPUT", socket_type="NodeSocketVector")
        make = GeometryBuilder(tree)
        inputs = make.node("NodeGroupInput")
        low, high = (make.output(inputs, label) for label in (LOW, HIGH))
        which = make.field("GeometryNodeInputIndex")
        points = make.field("GeometryNodePoints", 2, low + (high - low) * which, 0.0)
        make.node("NodeGroupOutput", points)
        make.arrange()
    return tree
