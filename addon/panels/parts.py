# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels are made of: texts that wrap, buttons that say why they are greyed, bars, problems."""

from typing import TYPE_CHECKING, ClassVar

import blf
import bpy

from ..model.look import is_model
from ..operators.base import choices
from ..session.advice import why_not
from ..session.state import Made, Problem, State
from ..session.tasks import TITLES, can_be_shown, duration, ended, folder_of, stage

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Pixels at the interface's scale 1: of a region's width what margins, the panel's frame and the tabs take …
FRAME = 46.0
#: … and of a line what an icon takes.
ICON = 24.0
#: … and what a box takes of everything in it.
BOX = 16.0
#: Blender's buttons draw text a little wider than it measures.
SLACK = 1.05
#: Points of the interface's text.
POINTS = 11.0


class SidebarPanel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "PhysHDR"


class ModelSubpanel(SidebarPanel):
    bl_parent_id = "PHYSHDR_PT_model"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return is_model(context.object)


def draw_problem(context: bpy.types.Context, layout: bpy.types.UILayout, problem: Problem) -> None:
    """What went wrong, the remedy, and the log."""
    box = layout.box()
    column = box.column(align=True)
    column.alert = True
    write(context, column, problem.message, "ERROR", beside=BOX)
    if problem.hint:
        write(context, box, problem.hint, "INFO", beside=BOX)
    row = box.row(align=True)
    if problem.log:
        row.operator("physhdr.log_open", icon="TEXT").filepath = problem.log
    row.operator("physhdr.problem_dismiss", icon="X")


def button(
    context: bpy.types.Context,
    layout: bpy.types.UILayout,
    state: State,
    action: str,
    operator: str,
    text: str,
    icon: "IconItems",
) -> bpy.types.OperatorProperties:
    """An operator's button, greyed where the user's choices do not allow it (``reasons`` says why); its
    arguments."""
    cell = layout.row(align=True)
    cell.enabled = not why_not(state, action, choices(context))
    return cell.operator(operator, text=text, icon=icon)


def reasons(
    context: bpy.types.Context, layout: bpy.types.UILayout, state: State, action: str, beside: float = 0.0
) -> None:
    """Why a button above is greyed, in the panel itself: a tooltip alone is not found."""
    reason = why_not(state, action, choices(context))
    if reason:
        write(context, layout, reason, "INFO", beside=beside)


def draw_task(layout: bpy.types.UILayout, state: State, name: str, lines: int = 0) -> None:
    """How far a child process is, what it does, and a button that cancels it.

    ``lines``: room that is kept for what it does; 0: one line where it says anything.
    """
    task = state.task(name)
    if task is None:
        return
    text = f"{TITLES[name]} {task.fraction:.0%}"
    if task.seconds_left >= 0.0:
        text += f"   {duration(task.seconds_left)} left"
    column = layout.column(align=True)
    row = column.row(align=True)
    row.progress(factor=task.fraction, text="Cancelling" if task.cancelling else text)
    row.operator("physhdr.task_cancel", text="", icon="X").name = name
    if lines:
        write(bpy.context, column, stage(task) if task.message or task.pace.quiet else "", lines=lines)
    elif task.message or task.pace.quiet:
        column.label(text=first_line(bpy.context, stage(task)))


def draw_made(layout: bpy.types.UILayout, made: Made) -> None:
    """What was made, until that is dismissed or something else is begun; where it is."""
    column = layout.column(align=True)
    column.label(text=first_line(bpy.context, ended(made), ICON), icon="CHECKMARK")
    draw_ways(column.row(align=True), made)


def draw_ways(row: bpy.types.UILayout, made: Made) -> None:
    """The buttons that open what was made or its folder, and the one that dismisses the word."""
    if can_be_shown(made):
        row.operator("wm.path_open", text="Open", icon="WINDOW").filepath = made.path
    row.operator("wm.path_open", text="Open Folder", icon="FILE_FOLDER").filepath = folder_of(made)
    row.operator("physhdr.made_dismiss", text="", icon="X")


def write(
    context: bpy.types.Context,
    layout: bpy.types.UILayout,
    text: str,
    icon: "IconItems" = "NONE",
    lines: int | None = None,
    beside: float = 0.0,
) -> None:
    """A text of several lines, as wide as the panel; with ``lines`` of just so many, cut or filled up.

    ``beside``: pixels that it has less than the panel (``BOX``).
    """
    column = layout.column(align=True)
    column.scale_y = 0.8
    width = room(context) - beside - (ICON if icon != "NONE" else 0.0)
    wrapped = wrap(text, width) or [""]
    if lines is not None:
        if len(wrapped) > lines:
            wrapped = wrap(text, width - text_width(" …"))[:lines]
            wrapped[-1] += " …"
        wrapped += [""] * (lines - len(wrapped))
    for index, line in enumerate(wrapped):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def room(context: bpy.types.Context) -> float:
    """Pixels at the interface's scale 1 that a line of the panel has for its text."""
    scale = context.preferences.system.ui_scale or 1.0
    return max(100.0, context.region.width / scale - FRAME)


def text_width(text: str) -> float:
    """Pixels that a text takes at the interface's scale 1."""
    blf.size(0, POINTS)
    return SLACK * blf.dimensions(0, text)[0]


def first_line(context: bpy.types.Context, text: str, beside: float = 0.0) -> str:
    """As much of a text as one line holds; ``beside``: pixels that something else takes of it."""
    width = room(context) - beside
    if text_width(text) <= width:
        return text
    fits = next((k for k in range(len(text) - 1, 0, -1) if text_width(f"{text[:k]}…") <= width), 1)
    return f"{text[:fits].rstrip()}…"


def wrap(text: str, width: float) -> list[str]:
    """Lines no wider than ``width``, broken between words, and within one that is wider itself (a path)."""
    lines: list[str] = []
    for word in text.split():
        joined = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(joined) <= width:
            lines[-1] = joined
            continue
        while len(word) > 1 and text_width(word) > width:
            fits = next(k for k in range(len(word) - 1, 0, -1) if k == 1 or text_width(word[:k]) <= width)
            lines.append(word[:fits])
            word = word[fits:]
        lines.append(word)
    return lines


def shortened(path: str, context: bpy.types.Context, beside: float = 90.0) -> str:
    """The end of a path, as much as there is room for ``beside`` what stands in the same row (pixels)."""
    width = room(context) - beside
    if text_width(path) <= width:
        return path
    first = next((k for k in range(1, len(path)) if text_width(f"…{path[k:]}") <= width), len(path) - 1)
    return f"…{path[first:]}"
