# SPDX-License-Identifier: GPL-3.0-or-later
"""A model: exposure and the lights' levels, looking through its cameras, and how else it looks.

One set of sliders: those of the selected model or of one whose instance is selected, of the one that the live
preview shows, or of the scene's only one; else the preview's own.
"""

from collections.abc import Sequence

import bpy

from ...bridge.lights import AMBIENT
from ..blender import cloud_of, layout_of
from ..capture import originals
from ..light import lighting
from ..model.attributes import CAMERAS, CONFIDENCE, CONFIDENCE_SPLATS, DISPLAY
from ..model.look import draw_look, draw_sliders, slider_name
from ..model.preview_look import followed
from ..operators.base import choices
from ..operators.lighting import model_in
from ..operators.native import draw_native
from ..operators.photographed_light import choices_of
from ..rendering.render_setup import has_model, models_of
from ..runtime import session
from ..session.advice import holds_another, why_not
from ..session.state import State
from ..settings import PHYSHDR_Settings
from ..viewport import overlay
from ..viewport.camera import ORTHOGRAPHIC_HINT
from .parts import ModelSubpanel, SidebarPanel, button, write


class PHYSHDR_PT_model(SidebarPanel, bpy.types.Panel):
    bl_label = "Model"
    bl_order = 2

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where there is one: in the scene, in the backend, or what it left behind."""
        scene = context.scene
        if has_model(scene) or session().state.job.has_model or scene.physhdr.preview:
            return True
        return lighting.is_lit(scene.world) or originals.are_hidden(scene)

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, layout_of(self), context.scene.physhdr
        shown = followed(context.scene, context.view_layer, state.job)
        target = target_of(context, state)
        reason = why_not(state, "preview", choices(context))
        if target is not None:
            layout.label(text=target.name, icon="OUTLINER_OB_POINTCLOUD")
            draw_sliders(layout, target)
            draw_photographed(layout, target)
            draw_cameras(layout, target)
        elif settings.preview or state.job.has_model:
            draw_own(layout, state, settings)
        for text in hints(context, state, settings, target, shown, reason):
            write(context, layout, text, "INFO")
            if text == reason and holds_another(state, choices(context)):
                button(context, layout, state, "open", "physhdr.run_open", "Open Run", "FILE_FOLDER")
        draw_originals(context, layout)


def draw_originals(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """The toggle of what was photographed, where a model of it is shown: the two are in each other's way."""
    if not originals.is_offered(context.scene):
        return
    hidden = originals.are_hidden(context.scene)
    if not hidden:
        write(context, layout, "It is where the objects are that it was photographed from", "INFO")
    text, icon = ("Show Originals", "HIDE_ON") if hidden else ("Hide Originals", "HIDE_OFF")
    layout.operator("physhdr.originals_hide", text=text, icon=icon, depress=hidden)


class PHYSHDR_PT_look(ModelSubpanel, bpy.types.Panel):
    bl_label = "Look"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return target_of(context, session().state) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, target = layout_of(self), target_of(context, session().state)
        assert target is not None
        draw_look(layout, target)
        column = layout.column()
        column.use_property_split = True
        column.prop(target, DISPLAY, text="3D View")
        if CAMERAS in cloud_of(target):
            column.prop(context.scene.physhdr, "dim_unseen")
        if text := confidence_note(target):
            write(context, layout, text, "INFO")
        draw_native(layout, target)


def target_of(context: bpy.types.Context, state: State) -> bpy.types.Object | None:
    """The model whose sliders are shown; ``None`` where they are the live preview's own."""
    if selected := models_of(context.object):
        return selected[0]
    if context.scene.physhdr.preview:
        return followed(context.scene, context.view_layer, state.job)
    return model_in(context)


def draw_photographed(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """The light of its photos, to choose from; nothing where all were taken under one."""
    if choices_of(target):
        layout.operator_menu_enum("physhdr.light_as_photographed", "light", text="Light as Photographed")


def draw_cameras(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """From one photo's place to the next; for models that brought their cameras along."""
    if CAMERAS not in cloud_of(target):
        return
    row = layout.row(align=True)
    row.operator("physhdr.look_through", text="", icon="TRIA_LEFT").step = -1
    row.operator("physhdr.look_through").step = 0
    row.operator("physhdr.look_through", text="", icon="TRIA_RIGHT").step = 1


def confidence_note(target: bpy.types.Object) -> str:
    """What the colours mean where the 3D view shows a model's confidence; else nothing."""
    if getattr(target, DISPLAY) != CONFIDENCE_SPLATS:
        return ""
    if CONFIDENCE.name not in cloud_of(target).attributes:
        return "This model does not know its confidence: export it again, by this version of the backend"
    return "Chance that the radiance is right within a tenth of a stop: violet 0, green 0.6, yellow 1"


def hints(
    context: bpy.types.Context,
    state: State,
    settings: PHYSHDR_Settings,
    target: bpy.types.Object | None,
    shown: bpy.types.Object | None,
    reason: str,
) -> list[str]:
    """What is worth a word: below the sliders, which stay where they are."""
    # A model that is in the scene needs no backend.
    if reason and target is None and not state.job.has_model and has_model(context.scene):
        reason = "Select a model for its sliders. Live Preview needs a training, or an open run"
    lines = ["" if reason and target is not None and not settings.preview else reason or view_hint(context)]
    if target is not None and target != context.object and target in models_of(context.object):
        lines.append("These are the model's own sliders: all of its instances follow them")
        if target.library is not None:
            lines.append("It is linked from another file: make it local, or a library override, to change it")
    if settings.preview and not reason and target is not None:
        is_shown = target == shown
        lines.append(
            "Live Preview follows these sliders" if is_shown else "Live Preview shows another model than this"
        )
    if state.job.has_model and not state.job.can_relight and target is None:
        lines.append("This method learns no illumination: the level only scales")
    return [line for line in lines if line]


def draw_own(layout: bpy.types.UILayout, state: State, settings: PHYSHDR_Settings) -> None:
    """The live preview's own sliders."""
    column = layout.column()
    column.use_property_split = True
    column.active = settings.preview
    column.prop(settings, "exposure_ev")
    row = column.row()
    row.active = state.job.can_relight or not state.job.has_model
    draw_levels(row.column(), settings, state.job.lights or (AMBIENT,))
    column.prop(settings, "tone")


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


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_model, PHYSHDR_PT_look))
