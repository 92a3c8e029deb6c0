# SPDX-License-Identifier: GPL-3.0-or-later
"""Trained models in a user's scene are no part of what is photographed: hidden while it is, and told."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import bpy

from ..bridge.blend_file import MODEL_IDENTITY
from .blender import instanced
from .progress import Report


@contextmanager
def hidden(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, report: Report) -> Iterator[list[str]]:
    """Hide the imported models of a scene, in instances of collections too; shown again on the way out.

    Yields the names of those that are left out.
    """
    found = dict.fromkeys([*scene.objects, *instanced(layer)])
    names = []
    with ExitStack() as undo:
        for item in found:
            if not is_model(item) or item.hide_render:
                continue
            item.hide_render = True
            undo.callback(setattr, item, "hide_render", False)
            names.append(item.name)
        if names:
            report.say(f"left out of what is photographed, trained models: {', '.join(names)}")
        yield names


def is_model(item: bpy.types.Object) -> bool:
    """Whether an object is a trained model that the extension imported, or a copy of one."""
    return item.type == "POINTCLOUD" and item.data is not None and MODEL_IDENTITY in item.data
