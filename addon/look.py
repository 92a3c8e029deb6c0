# SPDX-License-Identifier: GPL-3.0-or-later
"""How a model is looked at: exposure, lighting level, tone mapping. Inputs of its modifier, so that they are
saved, undone, keyframed and driven as everything in Blender; what draws a model reads them from here.
"""

from dataclasses import dataclass

import bpy

from . import nodes
from .point_cloud import IDENTITY

#: The inputs that people use, in the panel's order: (label, field of ``Look``). With several lights (issue 5)
#: there will be one level a light here.
INPUTS = (
    (nodes.EXPOSURE, "exposure_ev"),
    (nodes.LIGHTING_LEVEL, "lighting_level"),
    (nodes.TONE_MAPPER, "tone_mapper"),
    (nodes.VIEW_DEPENDENT, "view_dependent"),
)


@dataclass(frozen=True)
class Look:
    """``exposure_ev``: radiance is multiplied by 2 to this power; ``lighting_level``: the ambient light's
    factor, 1 as captured; ``tone_mapper``: show the learned response's codes instead of radiance."""

    exposure_ev: float = 0.0
    lighting_level: float = 1.0
    tone_mapper: bool = False
    view_dependent: bool = True

    @property
    def exposure(self) -> float:
        """Seconds: 2^EV."""
        return 2.0**self.exposure_ev


def is_model(target: bpy.types.Object | None) -> bool:
    """Whether an object is an imported model (or a copy of one)."""
    return target is not None and target.type == "POINTCLOUD" and IDENTITY in target.data


def models_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The models of a scene, in its order."""
    return [target for target in scene.objects if is_model(target)]


def look_of(target: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Look:
    """The look of a model: its values now, or with ``depsgraph`` as evaluated there (a frame being rendered).

    A model whose modifier was removed has the look it was captured with.
    """
    modifier = nodes.find_modifier(target)
    if modifier is None:
        return Look()
    # Labels are looked up in the original; an evaluated object has only the values of its own.
    identifiers = {
        field: nodes.input_identifier(modifier, label)
        for label, field in INPUTS
        if nodes.has_input(modifier, label)
    }
    if depsgraph is not None:
        modifier = target.evaluated_get(depsgraph).modifiers[modifier.name]
    inputs = modifier.properties.inputs
    return Look(**{field: getattr(inputs, name).value for field, name in identifiers.items()})


def draw_look(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """The look's sliders, with keyframe buttons; a label where the modifier was removed."""
    modifier = nodes.find_modifier(target)
    if modifier is None:
        layout.label(text="Its PhysHDR modifier was removed: import it again", icon="ERROR")
        return
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = True
    for label, _ in INPUTS:
        if nodes.has_input(modifier, label):
            socket = getattr(modifier.properties.inputs, nodes.input_identifier(modifier, label))
            column.prop(socket, "value", text=label)
