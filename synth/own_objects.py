# SPDX-License-Identifier: GPL-3.0-or-later
"""Hides what the extension put into a user's scene while that is photographed, and reports it.

Trained models; the light that a capture gives the world, for which the former world is restored; the planes
that take the shadow of CG. Probes and a data set's cameras, which no picture shows, would let the scene look
changed.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import bpy

from ..bridge.blend_file import CG, FORMER_WORLD, LIGHT_MODEL, MODEL_IDENTITY, PROBE, SPLIT
from .blender import instanced
from .in_render import rendered
from .progress import Report


@contextmanager
def hidden(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, report: Report) -> Iterator[list[str]]:
    """Hide what is ours in a scene, in instances of collections too; shown again on the way out.

    Yields the names of the objects that a picture would have shown.
    """
    models, planes = [], []
    with ExitStack() as undo:
        for item in dict.fromkeys([*scene.objects, *instanced(layer)]):
            if item.hide_render or item == scene.camera or not is_ours(item):
                continue
            item.hide_render = True
            undo.callback(setattr, item, "hide_render", False)
            if is_model(item):
                models.append(item.name)
            elif CG in item:
                planes.append(item.name)
        if models:
            report.say(f"left out of what is photographed, trained models: {', '.join(models)}")
        if planes:
            report.say(f"left out of what is photographed, planes for the shadow of CG: {', '.join(planes)}")
        for owner, attribute in ((scene, "world"), (layer, "world_override")):
            if _give_back(owner, attribute, undo):
                report.say("left out of what is photographed, the light of a capture: the world is as before")
        yield [*models, *planes]


def photographed(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph | None = None
) -> dict[bpy.types.Object, Counter[bpy.types.Object]]:
    """What is rendered (``in_render.rendered``, to which ``depsgraph`` goes) and is not ours and put away."""
    found = rendered(scene, layer, depsgraph)
    return {item: by for item, by in found.items() if not (item.hide_render and is_ours(item))}


def is_model(item: bpy.types.Object) -> bool:
    """Whether an object is a trained model that the extension imported, or a copy of one."""
    return item.type == "POINTCLOUD" and item.data is not None and MODEL_IDENTITY in item.data


def is_ours(item: bpy.types.Object) -> bool:
    """Whether the extension put an object into the scene."""
    return is_model(item) or any(mark in item for mark in (CG, PROBE, SPLIT))


def _give_back(owner: bpy.types.Scene | bpy.types.ViewLayer, attribute: str, undo: ExitStack) -> bool:
    """Put the former world in place of one that a capture lights, and say whether there was such a one."""
    world = getattr(owner, attribute)
    if world is None or LIGHT_MODEL not in world:
        return False
    former = world.get(FORMER_WORLD)
    undo.callback(setattr, owner, attribute, world)
    setattr(owner, attribute, former if isinstance(former, bpy.types.World) else None)
    return True
