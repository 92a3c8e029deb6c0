# SPDX-License-Identifier: GPL-3.0-or-later
"""What a trained run is worth, in words and figures, and videos and web pages of it."""

import os
from typing import TYPE_CHECKING

import bpy

from ...bridge.run_folder import REPORT_FILE, SHEET_FILE
from ..operators.results import made_of, page_of, shown_run
from ..session.results import (
    EVALUATE,
    VIDEO,
    WEB,
    Evaluation,
    evaluation_of,
    why_not_on_run,
)
from ..session.state import State
from .parts import write

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


def draw(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """Where there is a run to judge; folded while one is trained."""
    run = shown_run(context, state)
    if not run:
        return
    # Two folds, so that each remembers for itself whether it is open.
    fold = "physhdr_results_later" if state.active else "physhdr_results"
    head, body = layout.panel(fold, default_closed=state.active)
    head.label(text="Results")
    if body is None:
        return
    found = evaluation_of(run)
    if found:
        draw_evaluation(context, body, run, found)
    for buttons in BUTTONS:
        row = body.row(align=True)
        for name, text, icon in buttons:
            cell = row.row(align=True)
            cell.enabled = not why_not_on_run(state, name, run)
            cell.operator(f"physhdr.results_{name}", text=text, icon=icon)
    reason = why_not_on_run(state, EVALUATE, run)
    if reason and not state.task(EVALUATE):
        write(context, body, reason, "INFO")
    if (video := made_of(run)) and not state.task(VIDEO):
        draw_file(body, video, os.path.basename(video), "FILE_MOVIE")
    if (page := page_of(run)) and not state.task(WEB):
        draw_file(body, page, "Open Web Page", "WINDOW")


def draw_file(layout: bpy.types.UILayout, path: str, text: str, icon: "IconItems") -> None:
    """Buttons that open what was made, and its folder."""
    row = layout.row(align=True)
    row.operator("wm.path_open", text=text, icon=icon).filepath = path
    row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = os.path.dirname(path)


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
