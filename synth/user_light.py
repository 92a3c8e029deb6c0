# SPDX-License-Identifier: GPL-3.0-or-later
"""The ambient light of a user's scene (world and suns) made adjustable without a change to their own data.

The world is replaced by a copy whose every emitter gets a knob; suns keep their data and get a knob on the
energy, put back afterwards. Animation and drivers of what is turned are cut off: they stand as they are at
the current frame, else they would turn the knobs back.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from .scenes.stage import LightKnob

STRENGTHS = ("Strength", "Emission Strength")


@contextmanager
def ambient(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer
) -> Iterator[tuple[list[LightKnob], list[str]]]:
    """Knobs of the world and the suns, and what could not be done; all is put back on the way out."""
    knobs: list[LightKnob] = []
    notes: list[str] = []
    undo = []
    try:
        holder, attribute = (layer, "world_override") if layer.world_override else (scene, "world")
        world = getattr(holder, attribute)
        if world is not None and world.node_tree is not None:
            undo.append((holder, attribute, world))
            copy = world.copy()
            copy.animation_data_clear()
            setattr(holder, attribute, copy)
            knobs += _tree_knobs(copy.node_tree)
        for sun in _suns(scene, layer):
            if sun.energy:
                light, swapped = _still(sun, notes)
                undo += swapped
                if light is not None:
                    undo.append((light, "energy", light.energy))
                    knobs.append(LightKnob(light, "energy", light.energy))
        yield knobs, notes
    finally:
        for owner, attribute, value in reversed(undo):
            setattr(owner, attribute, value)


def _tree_knobs(tree: bpy.types.NodeTree) -> list[LightKnob]:
    """A knob for the strength of every emitter in a tree that is ours to change, groups included."""
    tree.animation_data_clear()
    knobs = []
    for node in list(tree.nodes):
        if node.type == "GROUP" and node.node_tree is not None:
            node.node_tree = node.node_tree.copy()
            knobs += _tree_knobs(node.node_tree)
            continue
        strength = _strength(node)
        if strength is None:
            continue
        if not strength.is_linked:
            if strength.default_value:
                knobs.append(LightKnob(strength, "default_value", strength.default_value))
            continue
        factor = tree.nodes.new("ShaderNodeMath")
        factor.operation = "MULTIPLY"
        factor.inputs[1].default_value = 1.0
        tree.links.new(strength.links[0].from_socket, factor.inputs[0])
        tree.links.new(factor.outputs[0], strength)
        knobs.append(LightKnob(factor.inputs[1], "default_value", 1.0))
    return knobs


def _strength(node: bpy.types.Node) -> bpy.types.NodeSocket | None:
    """The input that the light of an emitting node is linear in."""
    if not any(socket.type == "SHADER" for socket in node.outputs):
        return None
    return next((node.inputs[name] for name in STRENGTHS if name in node.inputs), None)


def _still(sun: bpy.types.Light, notes: list[str]) -> tuple[bpy.types.Light | None, list[tuple]]:
    """The sun itself, or a copy without its animation in its place, with what undoes that."""
    animation = sun.animation_data
    if animation is None or not (animation.action or animation.drivers or animation.nla_tracks):
        return sun, []
    copy = sun.copy()
    copy.animation_data_clear()
    swapped = []
    for item in bpy.data.objects:
        if item.type == "LIGHT" and item.data == sun:
            try:
                item.data = copy
            except (AttributeError, RuntimeError, TypeError):
                notes.append(
                    f"the animated sun '{item.name}' belongs to a linked library: it stays as it is "
                    "at all ambient levels (make it local to change that)"
                )
                continue
            swapped.append((item, "data", sun))
    return (copy if swapped else None), swapped


def _suns(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Light]:
    return [light for light in lights(scene, layer) if light.type == "SUN"]


def lights(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Light]:
    """The data of all lights that are rendered, those in instances of collections included, each once."""
    found = [item.data for item in scene.objects if item.type == "LIGHT" and not item.hide_render]
    found += [
        instance.object.original.data
        for instance in layer.depsgraph.object_instances
        if instance.object.type == "LIGHT" and not instance.object.original.hide_render
    ]
    return list(dict.fromkeys(found))


def any_light(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> bool:
    """Whether anything shines: a light, the world, or a material on an object that is rendered."""
    if any(light.energy > 0.0 and not light.cycles.is_portal for light in lights(scene, layer)):
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
    items += [instance.object.original for instance in layer.depsgraph.object_instances]
    found = [slot.material for item in dict.fromkeys(items) for slot in item.material_slots if slot.material]
    return list(dict.fromkeys(found))


def _shines(tree: bpy.types.NodeTree) -> bool:
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
