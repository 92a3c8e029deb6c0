# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights of a user's scene, distinguished by Cycles' light groups, without a change to their own data.

Ambient light is the world and the suns: for the time of rendering they are in a light group of ours. What the
user chose (``light_choice``) is in groups of ours, too; where nothing was chosen, the user's own light groups
are further lights, as far as anything in them shines. What is in no group is what remains of the picture.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import bpy

from ..bridge.lights import AMBIENT
from .blender import light_of
from .light_choice import (
    LAMPS,
    LightChoice,
    Materials,
    gives_light,
    is_lamp,
    is_sun,
    layer_name,
    shares,
    shines,
)
from .own_objects import photographed

OURS = "physhdr"
#: Bytes of a light group's name: more do not fit behind ``Combined_`` in the name of its pass.
LONGEST = 54


@dataclass(frozen=True)
class Grouped:
    """How the lights of a scene are distinguished."""

    #: Light → light group of Cycles; ``""`` for what remains. ``AMBIENT`` first.
    groups: dict[str, str]
    has_ambient: bool
    #: What could not be done, for the user.
    notes: list[str] = field(default_factory=list)


@contextmanager
def grouped(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, chosen: Sequence[LightChoice] = ()
) -> Iterator[Grouped]:
    """Put world, suns and what was ``chosen`` into light groups of ours; all is put back on the way out.

    Raises what ``light_choice.shares`` does.
    """
    theirs = [group.name for group in layer.lightgroups]
    taken, notes = shares(scene, layer, chosen)
    with ExitStack() as undo:
        undo.callback(setattr, layer, "active_lightgroup_index", layer.active_lightgroup_index)
        ambient = _added(layer, undo)
        shining = False
        holder, attribute = (layer, "world_override") if layer.world_override else (scene, "world")
        world = getattr(holder, attribute)
        if world is not None:
            shining = world.node_tree is not None and shines(world.node_tree)
            copy = world.copy()
            copy.lightgroup = ambient
            undo.callback(setattr, holder, attribute, world)
            setattr(holder, attribute, copy)
        elsewhere = {item for items in taken.values() for item in items}
        for sun in _suns(scene, layer):
            if sun in elsewhere:
                continue
            if not _put(sun, ambient, undo):
                notes.append(_linked(f"the sun '{sun.name}'"))
                continue
            shining = True
        groups = {AMBIENT: ambient}
        for name, items in taken.items():
            groups[name] = _added(layer, undo)
            notes += _moved(items, name, groups[name], undo)
        for theirs_name in () if chosen else _lit_groups(scene, layer, theirs):
            name = layer_name(theirs_name, groups)
            groups[name] = theirs_name
            if len(theirs_name.encode()) > LONGEST:
                groups[name] = _added(layer, undo)
                items = [item for item in photographed(scene, layer) if item.lightgroup == theirs_name]
                notes += _moved(items, name, groups[name], undo)
        groups[layer_name(LAMPS, groups)] = ""
        notes += _negative(scene, layer)
        yield Grouped(groups, shining, notes)


def _added(layer: bpy.types.ViewLayer, undo: ExitStack) -> str:
    """The name of a new light group, a short one whatever lights are called; it goes when ``undo`` closes."""
    made = layer.lightgroups.add(name=f"{OURS} {len(layer.lightgroups)}").name
    undo.callback(lambda: layer.lightgroups.remove(layer.lightgroups[made]))
    return made


def _moved(items: list[bpy.types.Object], light: str, group: str, undo: ExitStack) -> list[str]:
    """Put objects into the group of their light; notes of those that cannot be."""
    left = [item for item in items if not _put(item, group, undo)]
    return [_linked(f"'{item.name}' of the light {light}") for item in left]


def _put(item: bpy.types.Object, group: str, undo: ExitStack) -> bool:
    """Put an object into a light group until ``undo`` closes; False where it cannot be written to."""
    former = item.lightgroup
    try:
        item.lightgroup = group
    except (AttributeError, RuntimeError):
        return False
    undo.callback(setattr, item, "lightgroup", former)
    return True


def _linked(what: str) -> str:
    return f"{what} belongs to a linked library and counts as a lamp (make it local to change that)"


def _negative(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[str]:
    """A note of the lights that take light away: ``Renderer`` gives no less than 0 of a light."""
    found = [item for item in photographed(scene, layer) if item.type == "LIGHT"]
    names = [item.name for item in found if light_of(item).energy < 0.0]
    if not names:
        return []
    return [
        "a data set cannot hold negative light, which becomes 0 (give these lights a positive strength, or "
        f"hide them in renders): {', '.join(names)}"
    ]


def _lit_groups(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, names: list[str]) -> list[str]:
    """Those light groups of the user's in which anything but the ambient light shines."""
    found, known = photographed(scene, layer), Materials(layer)
    lit = {item.lightgroup for item in found if item.lightgroup and is_lamp(item, known)}
    return [name for name in names if name in lit]


def _suns(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    return [item for item in photographed(scene, layer) if is_sun(item)]


def lights(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[Any]:
    """The data of all lights that are rendered, those in instances of collections included, each once."""
    return list(dict.fromkeys(light_of(item) for item in photographed(scene, layer) if item.type == "LIGHT"))


def any_light(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether anything shines: a light, the world, or a material on an object that is rendered."""
    if any(gives_light(light) for light in lights(scene, layer)):
        return True
    world = layer.world_override or scene.world
    if world is not None and world.node_tree is not None and shines(world.node_tree):
        return True
    return any(
        material.node_tree is not None and shines(material.node_tree) for material in materials(scene, layer)
    )


def materials(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Material]:
    """The materials of all objects that are rendered, those that geometry nodes set included, each once."""
    found, known = photographed(scene, layer), Materials(layer)
    return list(dict.fromkeys(material for item in found for material in known.of(item)))
