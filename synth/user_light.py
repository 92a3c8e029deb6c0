# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights of a user's scene, told apart by Cycles' light groups, without a change to their own data.

Ambient light is the world and the suns: for the time of rendering they are in a light group of ours. The
user's own light groups are further lights, as far as anything in them shines; what is in no group is what
remains of the picture.
"""

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import bpy

from ..bridge.lights import AMBIENT
from .blender import cycles, instanced, light_of
from .passes import RESERVED

STRENGTHS = ("Strength", "Emission Strength")
OURS = "physhdr ambient"
LAMPS = "lamps"


@dataclass(frozen=True)
class Grouped:
    """How the lights of a scene are told apart."""

    #: Light → light group of Cycles; ``""`` for what remains. ``AMBIENT`` first.
    groups: dict[str, str]
    has_ambient: bool
    #: What could not be done, for the user.
    notes: list[str] = field(default_factory=list)


@contextmanager
def grouped(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Iterator[Grouped]:
    """Put world and suns into a light group of ours; all is put back on the way out."""
    notes: list[str] = []
    with ExitStack() as undo:
        undo.callback(setattr, layer, "active_lightgroup_index", layer.active_lightgroup_index)
        theirs = [group.name for group in layer.lightgroups]
        ours = layer.lightgroups.add(name=OURS)
        name = ours.name
        undo.callback(lambda: layer.lightgroups.remove(layer.lightgroups[name]))
        shining = False
        holder, attribute = (layer, "world_override") if layer.world_override else (scene, "world")
        world = getattr(holder, attribute)
        if world is not None:
            shining = world.node_tree is not None and _shines(world.node_tree)
            copy = world.copy()
            copy.lightgroup = name
            undo.callback(setattr, holder, attribute, world)
            setattr(holder, attribute, copy)
        for sun in _suns(scene, layer):
            if not light_of(sun).energy:
                continue
            former = sun.lightgroup
            try:
                sun.lightgroup = name
            except (AttributeError, RuntimeError):
                notes.append(
                    f"the sun '{sun.name}' belongs to a linked library and counts as a lamp "
                    "(make it local to change that)"
                )
                continue
            undo.callback(setattr, sun, "lightgroup", former)
            shining = True
        groups = {AMBIENT: name}
        for theirs_name in _lit_groups(scene, layer, theirs):
            groups[_layer_name(theirs_name, groups)] = theirs_name
        groups[_layer_name(LAMPS, groups)] = ""
        yield Grouped(groups, shining, notes)


def _lit_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, names: list[str]) -> list[str]:
    """Those light groups of the user's in which anything but the ambient light shines."""
    lit = {item.lightgroup for item in _rendered(scene, layer) if item.lightgroup and _is_lamp(item)}
    return [name for name in names if name in lit]


def _is_lamp(item: bpy.types.Object) -> bool:
    if item.type == "LIGHT":
        return light_of(item).type != "SUN" and _gives_light(light_of(item))
    return any(
        slot.material and slot.material.node_tree and _shines(slot.material.node_tree)
        for slot in item.material_slots
    )


def _layer_name(name: str, taken: dict[str, str]) -> str:
    """A name for layers of EXR files, folders and sliders: ``Key Light`` → ``key_light``."""
    plain = re.sub(r"\W+", "_", name.lower()).strip("_") or "light"
    made, count = plain, 2
    while made in taken or made in RESERVED:
        made, count = f"{plain}_{count}", count + 1
    return made


def _suns(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    return [item for item in _rendered(scene, layer) if item.type == "LIGHT" and light_of(item).type == "SUN"]


def _rendered(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """All objects that are rendered, those in instances of collections included, each once."""
    found = [*scene.objects, *instanced(layer)]
    return [item for item in dict.fromkeys(found) if not item.hide_render]


def lights(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[Any]:
    """The data of all lights that are rendered, those in instances of collections included, each once."""
    return list(dict.fromkeys(light_of(item) for item in _rendered(scene, layer) if item.type == "LIGHT"))


def _gives_light(light: Any) -> bool:
    """Whether a light is on; a portal only lets the sky's in."""
    return light.energy > 0.0 and not cycles(light).is_portal


def any_light(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether anything shines: a light, the world, or a material on an object that is rendered."""
    if any(_gives_light(light) for light in lights(scene, layer)):
        return True
    world = layer.world_override or scene.world
    if world is not None and world.node_tree is not None and _shines(world.node_tree):
        return True
    return any(
        material.node_tree is not None and _shines(material.node_tree) for material in materials(scene, layer)
    )


def materials(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Material]:
    """The materials of all objects that are rendered, each once."""
    items = [item for item in scene.objects if not item.hide_render]
    items += instanced(layer)
    found = [slot.material for item in dict.fromkeys(items) for slot in item.material_slots if slot.material]
    return list(dict.fromkeys(found))


def _strength(node: bpy.types.Node) -> Any:
    """The input that the light of an emitting node is linear in; ``None`` of one that emits none."""
    if not any(socket.type == "SHADER" for socket in node.outputs):
        return None
    return next((node.inputs[name] for name in STRENGTHS if name in node.inputs), None)


def _shines(tree: bpy.types.NodeTree) -> bool:
    node: Any  # each kind has inputs of its own
    for node in tree.nodes:
        if node.mute:
            continue
        if node.type == "GROUP" and node.node_tree is not None and _shines(node.node_tree):
            return True
        strength = _strength(node)
        colour = next(
            (node.inputs[name] for name in ("Color", "Emission Color") if name in node.inputs), None
        )
        if strength is None or not (strength.is_linked or strength.default_value > 0.0):
            continue
        if node.type == "BSDF_PRINCIPLED":
            colour = node.inputs["Emission Color"]
        if (
            colour is None
            or colour.is_linked
            or any(value > 0.0 for value in tuple(colour.default_value)[:3])
        ):
            return True
    return False
