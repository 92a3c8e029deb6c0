# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights of a user's scene have a level of their own: chosen by light group, or by collection.

A choice takes all that shines in its group or collection: lamps, suns, objects with an emitting material, and
what its instances bring. The world is never chosen: it is the ambient light, with the suns that nobody chose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..bridge.lights import AMBIENT
from ..bridge.words import counted
from .blender import cycles, evaluated, light_of
from .errors import SceneError, UnknownNameError
from .light_names import COLLECTION, GROUP, KINDS, LAMPS, LightChoice, layer_name
from .own_objects import photographed

#: What a node's light is linear in → the colour that tints this light alone, where the node has it.
STRENGTHS = {
    "Strength": "Color",
    "Emission Strength": "Emission Color",
    "Emission Coefficients": "",
    "Blackbody Intensity": "Blackbody Tint",  # fire: it glows whatever its emission's colour
}
#: Inputs of geometry nodes that ask what a material is, and set none: kind of node → name of the input.
_ASKED = {"GeometryNodeMaterialSelection": "Material", "GeometryNodeReplaceMaterial": "Old"}


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
        return ", ".join(counted(count, name) for count, name in counts if count)


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
    """What shines of all that is photographed → what shows it: itself, and those that instance it."""
    found, materials = photographed(scene, layer), Materials(layer)
    return {item: set(by) for item, by in found.items() if is_lamp(item, materials) or is_sun(item)}


def is_sun(item: bpy.types.Object) -> bool:
    """Whether an object is a sun that is on."""
    return item.type == "LIGHT" and light_of(item).type == "SUN" and light_of(item).energy != 0.0


def is_lamp(item: bpy.types.Object, materials: "Materials") -> bool:
    """Whether an object shines and is no sun: a lamp that is on, or something of a material that glows."""
    if item.type == "LIGHT":
        return light_of(item).type != "SUN" and gives_light(light_of(item))
    return any(materials.glows(material) for material in materials.of(item))


class Materials:
    """The materials of a layer's objects, and which of them glow.

    It is for one look at many objects: a material and a tree of nodes are read once, however many have them.
    ``depsgraph``: in which they are looked at, as views show them if ``None``.
    """

    def __init__(self, layer: bpy.types.ViewLayer, depsgraph: bpy.types.Depsgraph | None = None) -> None:
        self._depsgraph = depsgraph or evaluated(layer)
        self._glow: dict[bpy.types.Material, bool] = {}
        self._set_by: dict[bpy.types.NodeTree, list[bpy.types.Material]] = {}
        self._asked_by: dict[bpy.types.NodeTree, list[str]] = {}

    def of(self, item: bpy.types.Object) -> list[bpy.types.Material]:
        """An object's materials, each once: those in its slots, and those that its geometry nodes set."""
        found = [slot.material for slot in item.material_slots]
        modifier: Any  # each kind has attributes of its own
        for modifier in item.modifiers:
            if modifier.type == "NODES" and modifier.show_render and modifier.node_group is not None:
                # What views hide is not evaluated, and instances of mere geometry are in no slot: so the
                # nodes are read, too. They in turn do not tell what comes from other objects' geometry.
                slots = item.evaluated_get(self._depsgraph).material_slots
                found += [slot.material.original for slot in slots if slot.material]
                found += self._given(modifier) + self._set(modifier.node_group)
        return list(dict.fromkeys(filter(None, found)))

    def glows(self, material: bpy.types.Material) -> bool:
        """Whether anything in the nodes of a material emits light."""
        if material not in self._glow:
            self._glow[material] = material.node_tree is not None and shines(material.node_tree)
        return self._glow[material]

    def _given(self, modifier: Any) -> list[bpy.types.Material | None]:
        """The materials that a modifier gives its nodes."""
        tree = modifier.node_group
        if tree not in self._asked_by:
            self._asked_by[tree] = [
                each.identifier
                for each in tree.interface.items_tree
                if each.item_type == "SOCKET"
                and each.in_out == "INPUT"
                and each.socket_type == "NodeSocketMaterial"
            ]
        inputs = modifier.properties.inputs if self._asked_by[tree] else None
        return [getattr(inputs, name).value for name in self._asked_by[tree]]

    def _set(self, tree: bpy.types.NodeTree) -> list[bpy.types.Material]:
        """The materials that a tree of geometry nodes and the groups in it name to set them."""
        if tree not in self._set_by:
            found: list[bpy.types.Material | None] = []
            node: Any
            for node in tree.nodes:
                if node.mute or not any(socket.is_linked for socket in node.outputs):
                    continue
                if node.type == "GROUP" and node.node_tree is not None:
                    found += self._set(node.node_tree)
                if node.bl_idname == "GeometryNodeInputMaterial":
                    found.append(node.material)
                found += [
                    socket.default_value
                    for socket in node.inputs
                    if socket.type == "MATERIAL"
                    and not socket.is_linked
                    and socket.identifier != _ASKED.get(node.bl_idname)
                ]
            self._set_by[tree] = list(dict.fromkeys(filter(None, found)))
        return self._set_by[tree]


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
        if any(socket.type == "SHADER" for socket in node.outputs) and any(
            _above_zero(node.inputs.get(strength), False) and _above_zero(node.inputs.get(colour), True)
            for strength, colour in STRENGTHS.items()
        ):
            return True
    return False


def _above_zero(socket: Any, where_none: bool) -> bool:
    """Whether a strength or a colour is not black, or may be, because it is linked."""
    if socket is None:
        return where_none
    # The fourth number of a colour is its alpha.
    return socket.is_linked or bool((np.ravel(socket.default_value)[:3] > 0.0).any())
