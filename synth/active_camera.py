# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes that ask for the active camera are given the user's, whichever camera is rendered with.

Else what they make would follow our camera, and each view would show another scene.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy

from .in_render import rendered
from .progress import Report

_ASKS, _GIVES = "GeometryNodeInputActiveCamera", "GeometryNodeInputObject"


@contextmanager
def replaced(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, camera: bpy.types.Object, report: Report
) -> Iterator[None]:
    """Put ``camera`` in place of the active one in all geometry nodes; put back on the way out.

    Where nodes of a linked library ask for it, which cannot be changed, ``report`` names the objects.
    """
    asking = [tree for tree in bpy.data.node_groups if _nodes(tree)]
    with ExitStack() as undo:
        for tree in asking:
            if tree.is_editable:
                for node in _nodes(tree):
                    _replace(tree, node, camera, undo)
        fixed = {tree for tree in asking if not tree.is_editable}
        if names := [item.name for item in rendered(scene, layer) if _uses(item, fixed)]:
            report.warn(
                "geometry nodes of a linked library follow the active camera and look otherwise in each view "
                f"(make them local to change that): {', '.join(names)}"
            )
        yield


def _nodes(tree: bpy.types.NodeTree) -> list[bpy.types.Node]:
    return [node for node in tree.nodes if node.bl_idname == _ASKS and node.outputs[0].is_linked]


def _replace(
    tree: bpy.types.NodeTree, node: bpy.types.Node, camera: bpy.types.Object, undo: ExitStack
) -> None:
    camera_node: Any = tree.nodes.new(_GIVES)
    camera_node.object = camera
    undo.callback(tree.nodes.remove, camera_node)
    links: Any = node.outputs[0].links
    for link in [link for link in links if not link.is_muted]:
        asked, into = link.from_socket, link.to_socket
        tree.links.new(camera_node.outputs[0], into)
        undo.callback(tree.links.new, asked, into)


def _uses(item: bpy.types.Object, trees: set[bpy.types.NodeTree]) -> bool:
    modifiers: list[Any] = [each for each in item.modifiers if each.type == "NODES" and each.show_render]
    return any(_holds(modifier.node_group, trees) for modifier in modifiers)


def _holds(tree: Any, trees: set[bpy.types.NodeTree]) -> bool:
    """Whether a tree of nodes is one of ``trees``, or has one of them in a group."""
    if tree is None or not trees:
        return False
    return tree in trees or any(_holds(node.node_tree, trees) for node in tree.nodes if node.type == "GROUP")
