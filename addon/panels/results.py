# SPDX-License-Identifier: GPL-3.0-or-later
"""What a trained run is worth, in words and figures, and videos and web pages of it."""

import os
from typing import TYPE_CHECKING

import bpy

from ...bridge.run_folder import REPORT_FILE, SHEET_FILE
from ..blender import layout_of
from ..operators.results import made_of, page_of, shown_run
from ..runtime import session
from ..session.results import (
    EVALUATE,
    VIDEO,
    WEB,
    Evaluation,
    evaluation_of,
    why_not_on_run,
)
from .parts import Subpanel, write

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Rows of buttons: each one's task, text and icon.
BUTTONS: "tuple[tuple[tuple[str, str, IconItems], ...], ...]" = (
    ((EVALUATE, "Evaluate", "VIEWZOOM"), (VIDEO, "Video…", "RENDER_ANIMATION")),
    ((WEB, "Export Web Page…", "URL"),),
)
#: File of an evaluation, text and icon of the button that opens it.
FILES: "tuple[tuple[str, str, IconItems], ...]" = (
    (SHEET_FILE, "Comparison", "IMAGE_DATA"),
    (REPORT_FILE, "Report", "TEXT"),
)


class PHYSHDR_PT_results(Subpanel, bpy.types.Panel):
    bl_label = "Results"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender's name for it)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(shown_run(context, session().state))

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, layout_of(self)
        run = shown_run(context, state)
        found = evaluation_of(run)
        if found:
            draw_evaluation(context, layout, run, found)
        for buttons in BUTTONS:
            row = layout.row(align=True)
            for name, text, icon in buttons:
                cell = row.row(align=True)
                cell.enabled = not why_not_on_run(state, name, run)
                cell.operator(f"physhdr.results_{name}", text=text, icon=icon)
        reason = why_not_on_run(state, EVALUATE, run)
        if reason and not state.task(EVALUATE):
            write(context, layout, reason, "INFO")
        video = made_of(run)
        if video and not state.task(VIDEO):
            row = layout.row(align=True)
            row.operator("wm.path_open", text=os.path.basename(video), icon="FILE_MOVIE").filepath = video
            folder = os.path.dirname(video)
            row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = folder
        page = page_of(run)
        if page and not state.task(WEB):
            row = layout.row(align=True)
            row.operator("wm.path_open", text="Open Web Page", icon="WINDOW").filepath = page
            folder = os.path.dirname(page)
            row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = folder


def draw_evaluation(
    context: bpy.types.Context, layout: bpy.types.UILayout, run: str, found: Evaluation
) -> None:
    """The table, and buttons that open what it was made from."""
    text = f"Against {found.views} photographs it never saw" if found.views else "Against photographs"
    write(context, layout, text)
    for figure in found.figures:
        box = layout.column(align=True)
        box.label(text=f"{figure.what}: {figure.words}")
        row = box.row()
        row.active = False
        row.label(text=figure.numbers, icon="BLANK1")
    if found.is_old:
        write(context, layout, f"As it was at iteration {found.iteration}: trained on since", "INFO")
    row = layout.row(align=True)
    for name, text, icon in FILES:
        path = os.path.join(run, name)
        if os.path.isfile(path):
            row.operator("wm.path_open", text=text, icon=icon).filepath = path


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_results,))
