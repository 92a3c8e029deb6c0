# SPDX-License-Identifier: GPL-3.0-or-later
"""A short name for the state of a user's scene, so that a resumed run does not mix two states in one folder.

It is no proof of sameness (texture files and single vertices are not looked at), but it notices what one
does between two runs: things moved, added, hidden, lit or coloured otherwise.
"""

import hashlib
import json
from typing import Any

import bpy
import numpy as np

from .blender import evaluated, mesh_of
from .user_light import lights, materials

DIGITS = 4  # significant; drivers and constraints need not give the last bits twice


def fingerprint(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, poses: list[np.ndarray], angle_x: float
) -> str:
    """16 hexadecimal digits of objects, lights, materials and world at the current frame, and of the cameras.

    ``poses``: camera to world [4, 4]; ``angle_x``: their horizontal field of view in radians.
    """
    depsgraph = evaluated(layer)
    world = layer.world_override or scene.world
    state = [
        [[round(value, DIGITS) + 0.0 for value in pose.ravel().tolist()] for pose in poses],
        _rounded([angle_x]),
        [_object(item.evaluated_get(depsgraph)) for item in _sorted(scene.objects) if not item.hide_render],
        [_light(light) for light in _sorted(lights(scene, layer))],
        [_tree(material.node_tree) for material in _sorted(materials(scene, layer))],
        _tree(world.node_tree) if world else None,
        [group.name for group in layer.lightgroups],
    ]
    return hashlib.sha256(json.dumps(state).encode()).hexdigest()[:16]


def _sorted(blocks: Any) -> list[Any]:
    return sorted(blocks, key=lambda block: block.name_full)


def _rounded(values: Any) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") + 0.0 for value in values]


def _object(item: bpy.types.Object) -> list[Any]:
    size = len(mesh_of(item).vertices) if item.type == "MESH" else 0
    # The translation may be a small rest of large numbers: metres with as many digits behind the point.
    matrix = [round(value, DIGITS) + 0.0 for row in item.matrix_world for value in row]
    slots = [slot.name for slot in item.material_slots]
    return [item.name_full, item.type, matrix, size, slots, item.lightgroup]


def _light(light: Any) -> list[Any]:
    return [light.name_full, light.type, _rounded([light.energy, *light.color])]


def _tree(tree: bpy.types.NodeTree | None) -> list[Any]:
    if tree is None:
        return []
    rows = []
    node: Any  # each kind of node and of socket has attributes of its own
    for node in tree.nodes:
        inputs = []
        for socket in node.inputs:
            value = getattr(socket, "default_value", None)
            if socket.is_linked:
                inputs.append(
                    [f"{link.from_node.name}.{link.from_socket.identifier}" for link in socket.links]
                )
            elif isinstance(value, float | int):
                inputs.append(_rounded([value]))
            elif hasattr(value, "__len__") and not isinstance(value, str):
                inputs.append(_rounded(value))
        image = getattr(getattr(node, "image", None), "name_full", "")
        inside = _tree(node.node_tree) if node.type == "GROUP" else []
        rows.append([node.name, node.bl_idname, node.mute, inputs, image, inside])
    return sorted(rows, key=lambda row: row[0])
