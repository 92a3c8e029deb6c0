# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels are made of: texts that wrap, buttons that say why they are greyed, bars, problems."""

import textwrap
from typing import TYPE_CHECKING

import bpy

from ..operators.base import choices
from ..session.advice import why_not
from ..session.state import Problem, State

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Pixels of a character at the interface's scale 1, to wrap texts to the panel's width.
CHARACTER = 6.4


class SidebarPanel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "PhysHDR"


class Subpanel(SidebarPanel):
    bl_parent_id = "PHYSHDR_PT_train"


def draw_problem(context: bpy.types.Context, layout: bpy.types.UILayout, problem: Problem) -> None:
    """What went wrong, the remedy, and the log."""
    box = layout.box()
    column = box.column(align=True)
    column.alert = True
    write(context, column, problem.message, "ERROR")
    if problem.hint:
        write(context, box, problem.hint, "INFO")
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
) -> None:
    """An operator's button, greyed where the user's choices do not allow it (``reasons`` says why)."""
    cell = layout.row(align=True)
    cell.enabled = not why_not(state, action, choices(context))
    cell.operator(operator, text=text, icon=icon)


def reasons(context: bpy.types.Context, layout: bpy.types.UILayout, state: State, action: str) -> None:
    """Why a button above is greyed, in the panel itself: a tooltip alone is not found."""
    reason = why_not(state, action, choices(context))
    if reason:
        write(context, layout, reason, "INFO")


def draw_task(layout: bpy.types.UILayout, state: State, name: str) -> None:
    """How far a child process is, what it does, and a button that cancels it."""
    task = state.task(name)
    if task is None:
        return
    text = f"{task.fraction:.0%}"
    if task.seconds_left >= 0.0:
        text += f"   {duration(task.seconds_left)} left"
    column = layout.column(align=True)
    row = column.row(align=True)
    row.progress(factor=task.fraction, text="Cancelling" if task.cancelling else text)
    row.operator("physhdr.task_cancel", text="", icon="X").name = name
    if task.message:
        column.label(text=task.message)


def write(
    context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: "IconItems" = "NONE"
) -> None:
    """A text of several lines, as wide as the panel."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    width = columns(context) - (4 if icon != "NONE" else 0)
    for index, line in enumerate(textwrap.wrap(text, width) or [""]):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def columns(context: bpy.types.Context) -> int:
    """How many characters a line of the panel holds."""
    scale = context.preferences.system.ui_scale * CHARACTER
    return max(20, int(context.region.width / scale) - 6)


def duration(seconds: float) -> str:
    """``75`` → ``1 min 15 s``."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {seconds} s" if minutes else f"{seconds} s"


def shortened(path: str, context: bpy.types.Context) -> str:
    """The end of a path, as much as there is room for beside a button."""
    room = max(12, columns(context) - 14)
    return path if len(path) <= room else f"…{path[1 - room :]}"
