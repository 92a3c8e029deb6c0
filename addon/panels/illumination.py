# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure and the lights' levels, of the selected model and of the live preview."""

from collections.abc import Sequence

import bpy

from ...bridge.lights import AMBIENT
from ..blender import layout_of
from ..look import draw_look, is_model, slider_name
from ..runtime import session
from ..session.advice import why_not
from ..settings import PHYSHDR_Settings
from ..viewport import overlay
from ..viewport.camera import ORTHOGRAPHIC_HINT
from .parts import Subpanel, write


class PHYSHDR_PT_illumination(Subpanel, bpy.types.Panel):
    bl_label = "Illumination"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, layout_of(self), context.scene.physhdr
        target = context.object
        if target is not None and is_model(target):
            layout.label(text=target.name, icon="OUTLINER_OB_POINTCLOUD")
            draw_look(layout, target)
            column = layout.column()
            column.use_property_split = True
            column.prop(target, "physhdr_viewport", text="3D View")
            layout.separator()
        row = layout.row()
        reason = why_not(state, "preview")
        row.enabled = settings.preview or not reason
        row.prop(settings, "preview", toggle=True, icon="HIDE_OFF" if settings.preview else "HIDE_ON")
        reason = reason or view_hint(context)
        if reason:
            write(context, layout, reason, "INFO")
        column = layout.column()
        column.use_property_split = True
        column.active = settings.preview
        column.prop(settings, "exposure_ev")
        row = column.row()
        row.active = state.job.can_relight or not state.job.has_model
        draw_levels(row.column(), settings, state.job.lights or (AMBIENT,))
        column.prop(settings, "tone")
        if state.job.has_model and not state.job.can_relight:
            write(context, layout, "This method learns no illumination: the level only scales", "INFO")


def draw_levels(layout: bpy.types.UILayout, settings: PHYSHDR_Settings, lights: Sequence[str]) -> None:
    """The live preview's slider for each light of the backend's model."""
    layout.prop(settings, "lighting_level", text=slider_name(lights, 0))
    for index, name in enumerate(lights[1:], 1):
        light = settings.further_levels.get(name)
        if light is not None:  # it comes with the timer's next look
            layout.prop(light, "level", text=slider_name(lights, index))


def view_hint(context: bpy.types.Context) -> str:
    """What this 3D view cannot show, and the remedy; empty where it can show all."""
    view = context.space_data
    if context.scene.physhdr.preview and not view.region_3d.is_perspective:
        return ORTHOGRAPHIC_HINT
    return overlay.hint(view, context.scene)


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_illumination,))
