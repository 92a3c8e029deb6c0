# SPDX-License-Identifier: GPL-3.0-or-later
"""A training: what is trained, steering it, and its result."""

import bpy

from .. import plot
from ..blender import layout_of
from ..runtime import session
from ..session.state import State
from .parts import Subpanel, button, reasons, write


class PHYSHDR_PT_training(Subpanel, bpy.types.Panel):
    bl_label = "Training"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, layout_of(self), context.scene.physhdr
        if state.active:
            self._draw_steering(context, layout, state)
        else:
            column = layout.column()
            column.use_property_split = True
            column.use_property_decorate = False
            for name in ("out", "preset", "iterations", "exposure_mode", "device"):
                column.prop(settings, name)
            row = layout.row(align=True)
            button(context, row, state, "start", "physhdr.train_start", "Start", "PLAY")
            button(context, row, state, "resume", "physhdr.train_resume", "Resume", "FILE_REFRESH")
            reasons(context, layout, state, "start")
        row = layout.row(align=True)
        if not state.job.has_model:
            button(context, row, state, "open", "physhdr.run_open", "Open Run", "FILE_FOLDER")
        button(context, row, state, "import", "physhdr.result_import", "Import Result", "IMPORT")
        if plot.icon_id() and len(state.history.iterations) > 1:
            layout.template_icon(plot.icon_id(), scale=8.0)
            layout.label(text="Loss (orange, logarithmic), PSNR (blue)")

    def _draw_steering(self, context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
        row = layout.row(align=True)
        if state.job.state == "paused":
            button(context, row, state, "continue", "physhdr.train_continue", "Continue", "PLAY")
        else:
            button(context, row, state, "pause", "physhdr.train_pause", "Pause", "PAUSE")
        text = "End at Once" if state.stopping else "Stop"
        button(context, row, state, "stop", "physhdr.train_stop", text, "SNAP_FACE")
        write(context, layout, state.job.run, "FILE_FOLDER")


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_training,))
