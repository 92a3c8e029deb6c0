# SPDX-License-Identifier: GPL-3.0-or-later
"""A training: what is trained, steering it, its curves and its result.

Every button has its place for good, and is greyed where it can do nothing: what stands under the mouse must
not change when it is pressed. What comes and goes (curves, reasons, the end of what takes long) is below.
"""

import bpy

from .. import plot
from ..blender import layout_of
from ..chosen_run import run_of
from ..operators.base import choices
from ..runtime import session
from ..session.advice import is_of_file, why_not
from ..session.state import State
from ..settings import PHYSHDR_Settings
from .parts import Subpanel, button, reasons, write

#: Height of the curves, in rows.
CURVES = 11.0
#: Of a row the share that Blender gives a property's name.
LABEL = 0.4


class PHYSHDR_PT_training(Subpanel, bpy.types.Panel):
    bl_label = "Training"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return session().state.backend.ready

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, layout_of(self), context.scene.physhdr
        column = layout.column()
        column.enabled = not state.active
        draw_choices(column, settings)
        column = layout.column(align=True)
        row = column.row(align=True)
        if resumes(context, state):
            button(context, row, state, "resume", "physhdr.train_resume", "Resume", "FILE_REFRESH")
        else:
            button(context, row, state, "start", "physhdr.train_start", "Start", "PLAY")
        row.menu("PHYSHDR_MT_train", text="", icon="DOWNARROW_HLT")
        row = column.row(align=True)
        if state.job.state == "paused":
            button(context, row, state, "continue", "physhdr.train_continue", "Continue", "PLAY")
        else:
            button(context, row, state, "pause", "physhdr.train_pause", "Pause", "PAUSE")
        button(context, row, state, "stop", "physhdr.train_stop", "Stop", "SNAP_FACE")
        draw_preview(context, column.row(align=True), state, settings)
        draw_result(context, layout, state)
        if state.stopping:
            button(context, layout, state, "end", "physhdr.train_end", "End Now", "CANCEL")
        if not state.active:
            reasons(context, layout, state, "start")
        draw_curves(context, layout, state, settings)


class PHYSHDR_MT_train(bpy.types.Menu):
    """Whichever of the two the button is not."""

    bl_label = "Start or Resume"

    def draw(self, context: bpy.types.Context) -> None:
        layout, state = layout_of(self), session().state
        button(context, layout, state, "start", "physhdr.train_start", "Start a New Training", "PLAY")
        button(context, layout, state, "resume", "physhdr.train_resume", "Resume", "FILE_REFRESH")


def resumes(context: bpy.types.Context, state: State) -> bool:
    """Whether the run's folder holds an unfinished training, which is then resumed."""
    chosen = choices(context)
    is_finished = state.job.state == "finished" and is_of_file(state.job, chosen)
    return not is_finished and not why_not(state, "resume", chosen)


def draw_preview(
    context: bpy.types.Context, layout: bpy.types.UILayout, state: State, settings: PHYSHDR_Settings
) -> None:
    """What the training has learned so far, in the 3D view."""
    layout.enabled = settings.preview or not why_not(state, "preview", choices(context))
    layout.prop(settings, "preview", toggle=True, icon="HIDE_OFF" if settings.preview else "HIDE_ON")


def draw_choices(layout: bpy.types.UILayout, settings: PHYSHDR_Settings) -> None:
    """What decides what is trained, and where to."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    layout.prop(settings, "out", placeholder="" if settings.out else run_of(settings))
    layout.prop(settings, "preset")
    split = layout.split(factor=LABEL)
    label = split.row()
    label.alignment = "RIGHT"
    label.label(text="Iterations")
    row = split.row(align=True)
    row.use_property_split = False
    if settings.iterations_automatic:
        row.prop(settings, "iterations_automatic", text="Automatic", toggle=True)
    else:
        row.prop(settings, "iterations", text="")
        row.prop(settings, "iterations_automatic", text="", icon="X", toggle=True)
    head, more = layout.panel("physhdr_training_more", default_closed=True)
    head.label(text="More")
    if more is not None:
        more.use_property_split = True
        more.use_property_decorate = False
        for name in ("exposure_mode", "device"):
            more.prop(settings, name)


def draw_result(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The buttons that bring in what was trained: of the run that this file has chosen."""
    chosen = choices(context)
    row = layout.row(align=True)
    button(context, row, state, "open", "physhdr.run_open", "Open Run", "FILE_FOLDER")
    result = button(context, row, state, "import", "physhdr.result_import", "Import Result", "IMPORT")
    if not is_of_file(state.job, chosen) and chosen.out:
        result.out = chosen.out  # not what the backend holds of another file


def draw_curves(
    context: bpy.types.Context, layout: bpy.types.UILayout, state: State, settings: PHYSHDR_Settings
) -> None:
    """The curves of this file's training, their room kept from its beginning on."""
    if not is_of_file(state.job, choices(context)) or not plot.icon_id():
        return
    if not state.active and len(state.history.iterations) < 2:
        return
    head, body = layout.panel_prop(settings, "show_curves")
    head.label(text="Curves")
    if body is not None:
        body.template_icon(plot.icon_id(), scale=CURVES)
        write(context, body, "Blue: quality (PSNR, dB)")
        write(context, body, "Orange: loss, what is still wrong")


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_MT_train, PHYSHDR_PT_training))
