# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers for the object index pass: each object with a surface gets one of its own, put back afterwards.

Where a material of the user's reads them (a colour for each object, say), they stay as they are: pictures
come first, and the mask then has the user's numbers.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any

import bpy

from .blender import instanced
from .progress import Report
from .stage import Stage

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}
MOST = 32767  # Blender's pass_index


@contextmanager
def numbered(stage: Stage, report: Report) -> Iterator[dict[str, int]]:
    """Object → its number in the index pass, from 1 in the order they were built; a user's scene by name.

    0 is where there is none. Copies of one object (instances) have its number. Where materials read the
    numbers, objects keep theirs, and several may have the same.
    """
    objects = [item for item in _objects(stage) if item.type in SURFACES]
    if stage.source and _are_read():
        report.warn(
            "materials read the objects' index: objects keep the numbers they have in the object mask"
        )
        yield {item.name_full: item.pass_index for item in objects if item.pass_index}
        return
    numbers: dict[str, int] = {}
    undo = []
    try:
        for item in objects[:MOST]:
            former = item.pass_index
            try:
                item.pass_index = len(numbers) + 1
            except (AttributeError, RuntimeError):  # of a library, and not to be written
                report.warn(f"the object '{item.name_full}' cannot be numbered: it is 0 in the object mask")
                continue
            undo.append((item, former))
            numbers[_name(item, stage, numbers)] = item.pass_index
        if len(objects) > MOST:
            report.warn(f"only the first {MOST} of {len(objects)} objects are in the object mask")
        yield numbers
    finally:
        for item, former in undo:
            item.pass_index = former


def _are_read() -> bool:
    """Whether nodes of any material read the index of what they shade."""
    trees = [material.node_tree for material in bpy.data.materials if material.node_tree is not None]
    node: Any  # each kind has attributes of its own
    for node in chain.from_iterable(tree.nodes for tree in (*trees, *bpy.data.node_groups)):
        if node.mute:
            continue
        if node.bl_idname == "ShaderNodeObjectInfo" and node.outputs["Object Index"].is_linked:
            return True
        if node.bl_idname == "ShaderNodeAttribute" and node.attribute_name == "pass_index":
            return True
    return False


def _name(item: bpy.types.Object, stage: Stage, taken: dict[str, int]) -> str:
    """A user's object's own name; of built ones as in an empty file, whatever else is open in this one."""
    if stage.source:
        return item.name_full
    made = plain = re.sub(r"\.\d{3,}$", "", item.name)
    count = 0
    while made in taken:
        count += 1
        made = f"{plain}.{count:03d}"
    return made


def _objects(stage: Stage) -> list[bpy.types.Object]:
    if not stage.source:
        return list(stage.scene.collection.all_objects)
    shown = list(stage.scene.objects)
    shown += instanced(stage.view_layer)
    return sorted(dict.fromkeys(shown), key=lambda item: item.name_full)
