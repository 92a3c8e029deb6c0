# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights of a user's scene have a level of their own: chosen by light group, or by collection.

A choice takes all that shines in its group or collection: lamps, suns, objects with an emitting material, and
what its instances bring. The world is never chosen: it is the ambient light, with the suns that nobody chose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import bpy

from ..bridge.lights import AMBIENT
from .blender import cycles, light_of
from .errors import SceneError, UnknownNameError
from .in_render import rendered
from .light_names import COLLECTION, GROUP, KINDS, LAMPS, LightChoice, layer_name

STRENGTHS = ("Strength", "Emission Strength")


@dataclass(frozen=True)
class Candidate:
    """What could be chosen: a choice, and how many lamps, suns and glowing objects it would take."""

    choice: LightChoice
    lamps: int
    suns: int
    glowing: int

    @property
    def in_words(self) -> str:
        """``2 lamps, 1 sun``."""
        counts = (self.lamps, "lamp"), (self.suns, "sun"), (self.glowing, "glowing object")
        return ", ".join(f"{count} {name}{'s' * (count > 1)}" for count, name in counts if count)


def candidates(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[Candidate]:
    """The light groups and then the collections of a scene in which anything shines that is rendered."""
    shining = emitters(scene, layer)
    wanted = [(GROUP, group.name) for group in layer.lightgroups]
    wanted += [(COLLECTION, each.name) for each in scene.collection.children_recursive]
    names: set[str] = {AMBIENT, LAMPS}
    found = []
    for kind, what in dict.fromkeys(wanted):
        taken = _taken(LightChoice("", kind, what), shining)
        if not taken:
            continue
        name = layer_name(what, names)
        names.add(name)
        suns = sum(is_sun(item) for item in taken)
        lamps = sum(item.type == "LIGHT" for item in taken) - suns
        found.append(Candidate(LightChoice(name, kind, what), lamps, suns, len(taken) - suns - lamps))
    return found


def shares(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, choices: Sequence[LightChoice]
) -> tuple[dict[str, list[bpy.types.Object]], list[str]]:
    """Light → what shines for it, and notes for the user. What several choose goes to the one that takes
    least, so that a collection within another has its own.

    Raises:
        UnknownNameError: there is no such group or collection.
        SceneError: nothing shines in it, or others take all of it.
    """
    shining = emitters(scene, layer)
    groups = [group.name for group in layer.lightgroups]
    takes: dict[LightChoice, list[bpy.types.Object]] = {}
    for choice in choices:
        known = groups if choice.kind == GROUP else [each.name for each in bpy.data.collections]
        if choice.what not in known:
            raise UnknownNameError(KINDS[choice.kind], choice.what, known)
        takes[choice] = _taken(choice, shining)
        if not takes[choice]:
            raise SceneError(
                f"nothing that is rendered shines in the {choice.kind} '{choice.what}'",
                "choose another one, or switch its lights on",
            )
    claims: dict[bpy.types.Object, list[LightChoice]] = {}
    for choice, items in takes.items():
        for item in items:
            claims.setdefault(item, []).append(choice)
    made: dict[str, list[bpy.types.Object]] = {choice.name: [] for choice in choices}
    notes = []
    for item, by in claims.items():
        least, *others = sorted(by, key=lambda choice: len(takes[choice]))
        made[least.name].append(item)
        for other in others:
            if not set(takes[least]) <= set(takes[other]):
                notes.append(
                    f"'{item.name}' is in '{least.what}' and in '{other.what}': it counts as the first"
                )
    for choice in choices:
        if not made[choice.name]:
            raise SceneError(
                f"all that shines in the {choice.kind} '{choice.what}' is in others that are chosen, too",
                "choose fewer",
            )
    return made, notes


def _taken(
    choice: LightChoice, shining: Mapping[bpy.types.Object, set[bpy.types.Object]]
) -> list[bpy.types.Object]:
    if choice.kind == GROUP:
        return [item for item in shining if item.lightgroup == choice.what]
    held = set(bpy.data.collections[choice.what].all_objects)
    return [item for item, holders in shining.items() if item in held or holders & held]


def emitters(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer
) -> dict[bpy.types.Object, set[bpy.types.Object]]:
    """What shines of all that is rendered → the objects that show it: itself, and those that instance it."""
    return {
        item: set(by)
        for item, by in rendered(scene, layer).items()
        if not item.hide_render and (is_lamp(item) or is_sun(item))
    }


def is_sun(item: bpy.types.Object) -> bool:
    """Whether an object is a sun that is on."""
    return item.type == "LIGHT" and light_of(item).type == "SUN" and light_of(item).energy != 0.0


def is_lamp(item: bpy.types.Object) -> bool:
    """Whether an object shines and is no sun: a lamp that is on, or something of a material that glows."""
    if item.type == "LIGHT":
        return light_of(item).type != "SUN" and gives_light(light_of(item))
    return any(
        slot.material and slot.material.node_tree and shines(slot.material.node_tree)
        for slot in item.material_slots
    )


def gives_light(light: Any) -> bool:
    """Whether a light is on; a portal only lets the sky's in."""
    return light.energy > 0.0 and not cycles(light).is_portal


def shines(tree: bpy.types.NodeTree) -> bool:
    """Whether anything in a tree of nodes emits light."""
    node: Any  # each kind has inputs of its own
    for node in tree.nodes:
        if node.mute:
            continue
        if node.type == "GROUP" and node.node_tree is not None and shines(node.node_tree):
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


def _strength(node: bpy.types.Node) -> Any:
    """The input that the light of an emitting node is linear in; ``None`` of one that emits none."""
    if not any(socket.type == "SHADER" for socket in node.outputs):
        return None
    return next((node.inputs[name] for name in STRENGTHS if name in node.inputs), None)
