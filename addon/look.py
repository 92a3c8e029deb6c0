# SPDX-License-Identifier: GPL-3.0-or-later
"""How a model is looked at: exposure, lighting levels, tone mapping. Inputs of its modifier, so that they are
saved, undone, keyframed and driven as everything in Blender; what draws a model reads them from here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

import bpy

from ..bridge.errors import PhysHDRError
from . import nodes
from .attributes import IDENTITY
from .blender import cloud_of
from .point_cloud import lights_of


def inputs(lights: Sequence[str]) -> list[str]:
    """The labels of the inputs that people use, in the panel's order: a level for each of the lights."""
    levels = [nodes.level_input(lights, index) for index in range(len(lights))]
    return [nodes.EXPOSURE, *levels, nodes.TONE_MAPPER, nodes.VIEW_DEPENDENT]


@dataclass(frozen=True)
class Look:
    """``exposure_ev``: radiance is multiplied by 2 to this power; ``lighting_levels``: the factor of each of
    the model's lights, 1 as captured; ``tone_mapper``: show the learned response's codes, not radiance."""

    exposure_ev: float = 0.0
    lighting_levels: tuple[float, ...] = (1.0,)
    tone_mapper: bool = False
    view_dependent: bool = True

    @property
    def exposure(self) -> float:
        """Seconds: 2^EV."""
        return 2.0**self.exposure_ev


def is_model(target: bpy.types.Object | None) -> TypeGuard[bpy.types.Object]:
    """Whether an object is an imported model (or a copy of one)."""
    return target is not None and target.type == "POINTCLOUD" and IDENTITY in cloud_of(target)


def look_of(target: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Look:
    """The look of a model: its values now, or with ``depsgraph`` as evaluated there (a frame being rendered).

    A model whose modifier was removed has the look it was captured with; a light that the modifier knows
    nothing of (an older one's) is at 1. Raises ``DataMismatchError`` as ``lights_of`` does.
    """
    lights = lights_of(cloud_of(target))
    values: dict[str, Any] = {}
    modifier = nodes.find_modifier(target)
    if modifier is not None:
        # Labels are looked up in the original; an evaluated object has only the values of its own.
        identifiers = {
            label: nodes.input_identifier(modifier, label)
            for label in inputs(lights)
            if nodes.has_input(modifier, label)
        }
        if depsgraph is not None:
            modifier = target.evaluated_get(depsgraph).modifiers[modifier.name]
        found = nodes.inputs_of(modifier)
        values = {label: getattr(found, name).value for label, name in identifiers.items()}
    levels = [values.get(nodes.level_input(lights, index), 1.0) for index in range(len(lights))]
    return Look(
        exposure_ev=values.get(nodes.EXPOSURE, 0.0),
        lighting_levels=tuple(levels),
        tone_mapper=values.get(nodes.TONE_MAPPER, False),
        view_dependent=values.get(nodes.VIEW_DEPENDENT, True),
    )


def slider_name(lights: Sequence[str], index: int) -> str:
    """What a panel calls a light's level: by its name alone, which is all there is room for."""
    return nodes.level_input(lights, 0) if len(lights) == 1 else lights[index]


def draw_look(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """The look's sliders (one a light) with keyframe buttons; a label where the modifier was removed."""
    modifier = nodes.find_modifier(target)
    if modifier is None:
        layout.label(text="Its PhysHDR modifier was removed: import it again", icon="ERROR")
        return
    try:
        lights = lights_of(cloud_of(target))
    except PhysHDRError as error:
        layout.label(text=str(error), icon="ERROR")
        return
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = True
    names = {nodes.level_input(lights, index): slider_name(lights, index) for index in range(len(lights))}
    for label in inputs(lights):
        if nodes.has_input(modifier, label):
            socket = getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, label))
            column.prop(socket, "value", text=names.get(label, label))
