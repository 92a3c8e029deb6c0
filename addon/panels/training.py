# SPDX-License-Identifier: GPL-3.0-or-later
"""A training: what is trained, steering it, its curves and its result.

Every button has its place for good, and is greyed where it can do nothing: what stands under the mouse must
not change when it is pressed. What comes and goes (curves, reasons, the end of what takes long) is below.
"""

import bpy

from ...bridge.presets import USUAL
from .. import plot
from ..blender import layout_of
from ..chosen_run import run_of
from ..operators.base import choices
from ..runtime import session
from ..session.advice import is_of_file, why_not
from ..session.state import State
from ..settings import PHYSHDR_Settings, preferences
from .parts import button, reasons, write

#: Height of the curves, in rows.
CURVES = 11.0
#: Of a row the share that Blender gives a property's name.
LABEL = 0.4


def draw(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """A training of the data set that is chosen; folded while none is."""
    settings, chosen = context.scene.physhdr, choices(context)
    begins = bool(chosen.data or chosen.out_has_run or state.job.run)
    # Two folds, so that each remembers for itself whether it is open.
    fold = "physhdr_training" if begins else "physhdr_training_later"
    head, body = layout.panel(fold, default_closed=not begins)
    head.label(text="Training")
    if body is None:
        return
    column = body.column()
    column.enabled = not state.active
    draw_choices(column, settings)
    column = body.column(align=True)
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
    draw_result(context, body, state)
    if state.stopping:
        button(context, body, state, "end", "physhdr.train_end", "End Now", "CANCEL")
    if not state.active:
        reasons(context, body, state, "start")
    draw_curves(context, body, state, settings)


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
    draw_method(layout, settings)
    head, more = layout.panel("physhdr_training_more", default_closed=True)
    head.label(text="Advanced")
    if more is None:
        return
    more.use_property_split = True
    more.use_property_decorate = False
    draw_iterations(more, settings)
    for name in ("exposure_mode", "device"):
        more.prop(settings, name)


def draw_method(layout: bpy.types.UILayout, settings: PHYSHDR_Settings) -> None:
    """Three by their effort; a list of all methods for research, or where the file has chosen another."""
    usual = [preset.name for preset in USUAL]
    if preferences().research or settings.preset not in usual:
        layout.prop(settings, "preset")
        return
    row = layout.row(align=True)
    row.use_property_split = False
    for name in usual:
        row.prop_enum(settings, "preset", name)


def draw_iterations(layout: bpy.types.UILayout, settings: PHYSHDR_Settings) -> None:
    """Their number, or that it is found from the data."""
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


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_MT_train,))
