# SPDX-License-Identifier: GPL-3.0-or-later
"""A model's modifier and its inputs, which scripts, panels, keyframes and drivers reach by their labels."""

from collections.abc import Sequence
from typing import Any, cast

import bpy

MODIFIER_NAME = "PhysHDR"

EXPOSURE = "Exposure (EV)"
LIGHTING_LEVEL = "Lighting level"
TONE_MAPPER = "Learned tone mapper"
VIEW_DEPENDENT = "View dependent"
CAMERA_SPLATS = "Camera splats"
IMAGE_WIDTH = "Image width"

#: What is hidden (``cleaning``): panels of the modifier, and their inputs.
CLEANING_PANEL, CULLING_PANEL = "Cleaning", "Culling in Renders"
CROP, CROP_BOX, KEEP_OUTSIDE = "Crop", "Crop Box", "Keep Outside"
LARGEST_SIZE, SMALLEST_OPACITY = "Max Size", "Min Opacity"
LARGEST_ELONGATION = "Elongation"
LARGEST_DISTANCE, DISTANCE_FROM = "Max Distance", "Distance From"
CLEAR_OF_PHOTOS = "Clear of Photos"
SMALLEST_CONFIDENCE = "Min Confidence"
CLEAR_OF_CAMERA, FARTHEST = "Clear of Camera", "Farthest"
ONLY_IN_VIEW, VIEW_MARGIN = "Only in View", "View Margin"
SH_DEGREE = "SH Degree"

CLEANING = (
    *(CROP, CROP_BOX, KEEP_OUTSIDE, LARGEST_SIZE, SMALLEST_OPACITY, LARGEST_ELONGATION),
    *(LARGEST_DISTANCE, DISTANCE_FROM, CLEAR_OF_PHOTOS, SMALLEST_CONFIDENCE),
)
CULLING = (CLEAR_OF_CAMERA, FARTHEST, ONLY_IN_VIEW, VIEW_MARGIN, SH_DEGREE)

#: Custom property that marks our node trees: what they were built for, and the version of the recipe.
MARK = "physhdr_tree"


def level_input(lights: Sequence[str], index: int) -> str:
    """The label of a light's level: the first is *Lighting level*, whatever the light is called."""
    return LIGHTING_LEVEL if index == 0 else f"Level of {lights[index]}"


def find_modifier(target: bpy.types.Object) -> bpy.types.NodesModifier | None:
    """The object's modifier with one of our trees, of any version and whatever it is called now."""
    for modifier in target.modifiers:
        if not isinstance(modifier, bpy.types.NodesModifier):
            continue
        if modifier.node_group is not None and MARK in modifier.node_group:
            return modifier
    return None


def inputs_of(modifier: bpy.types.Modifier) -> Any:
    """The inputs of a modifier with a node tree: attributes by the sockets' identifiers, with a ``value``."""
    assert isinstance(modifier, bpy.types.NodesModifier) and modifier.properties is not None
    return cast(Any, modifier.properties).inputs


def identifiers(modifier: bpy.types.Modifier) -> dict[str, str]:
    """What the modifier calls each of its inputs, by label."""
    assert isinstance(modifier, bpy.types.NodesModifier)
    tree = modifier.node_group
    items = tree.interface.items_tree if tree and tree.interface else ()
    sockets = (item for item in items if isinstance(item, bpy.types.NodeTreeInterfaceSocket))
    return {item.name: item.identifier for item in sockets if item.in_out == "INPUT"}


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Set an input of the modifier by its label, e.g. ``set_input(modifier, EXPOSURE, 1.5)``."""
    getattr(inputs_of(modifier), input_identifier(modifier, name)).value = value
    cast(bpy.types.Object, modifier.id_data).update_tag()


def get_input(modifier: bpy.types.Modifier, name: str) -> Any:
    """The value of an input of the modifier, by its label."""
    return getattr(inputs_of(modifier), input_identifier(modifier, name)).value


def input_data_path(modifier: bpy.types.Modifier, name: str) -> str:
    """The RNA path of an input on the object, for keyframes and drivers."""
    identifier = input_identifier(modifier, name)
    return f'modifiers["{bpy.utils.escape_identifier(modifier.name)}"].properties.inputs.{identifier}.value'


def input_identifier(modifier: bpy.types.Modifier, name: str) -> str:
    """What the modifier calls the input of that label; ``KeyError`` where it has none."""
    found = identifiers(modifier)
    if name not in found:
        raise KeyError(f"the modifier {modifier.name!r} has no input {name!r}")
    return found[name]


def has_input(modifier: bpy.types.Modifier, name: str) -> bool:
    """Whether the modifier's tree has that input: some exist only with a response or with lights."""
    return name in identifiers(modifier)
