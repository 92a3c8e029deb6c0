# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers for the object index pass: each object with a surface gets one of its own, put back afterwards."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from .blender import instanced
from .progress import Report
from .stage import Stage

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}
MOST = 32767  # Blender's pass_index


@contextmanager
def numbered(stage: Stage, report: Report) -> Iterator[dict[str, int]]:
    """Object → its number in the index pass, from 1 in the order they were built; a user's scene by name.

    0 is where there is none. Copies of one object (instances) have its number.
    """
    objects = [item for item in _objects(stage) if item.type in SURFACES]
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
