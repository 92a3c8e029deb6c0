# SPDX-License-Identifier: GPL-3.0-or-later
"""The top of the sidebar: how things are, what is next, how far, what is wrong; the first screen."""

from dataclasses import replace
from typing import TYPE_CHECKING

import bpy

from .. import outside
from ..blender import layout_of
from ..operators.base import choices, done_in
from ..runtime import session
from ..session.advice import headline, is_of_file, next_step, problem_of
from ..session.state import State
from ..session.tasks import duration, stage_of_training
from .backend import draw_first, draw_foreign
from .capture import is_behind
from .parts import BOX, ICON, SidebarPanel, draw_made, draw_problem, draw_task, first_line, shortened, write

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Pixels of a header that its fold takes.
FOLD = 20.0
#: Rows that are kept for the next step, and below the bar of what is under way.
STEP_LINES, PROGRESS_LINES = 2, 2
READY: "IconItems" = "RADIOBUT_ON"
ICONS: "dict[str, IconItems]" = {
    "training": "PLAY",
    "preparing": "SORTTIME",
    "paused": "PAUSE",
    "stopping": "FILE_TICK",
    "failed": "ERROR",
    "finished": "CHECKMARK",
    "stopped": "SNAP_FACE",
    "open": "OUTLINER_OB_POINTCLOUD",
}


class PHYSHDR_PT_status(SidebarPanel, bpy.types.Panel):
    """How things are is its header: without one, Blender would draw it straight onto the 3D view."""

    bl_label = ""
    bl_order = 0

    def draw_header(self, context: bpy.types.Context) -> None:
        state, chosen = session().state, choices(context)
        icon = ICONS.get(state.job.state, READY) if is_of_file(state.job, chosen) or state.active else READY
        if not state.backend.ready:
            icon = "RADIOBUT_OFF"
        icon = "ERROR" if problem_of(state) else icon
        layout_of(self).label(text=first_line(context, headline(state, chosen), FOLD + ICON), icon=icon)

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, chosen = session().state, layout_of(self), choices(context)
        # In rows of their own for good, so that nothing below moves when work begins or ends.
        step = next_step(state, replace(chosen, done=done_in(context.scene, chosen.out)))
        write(context, layout, step, "FORWARD" if step else "NONE", lines=STEP_LINES)
        draw_progress(context, layout, state, is_of_file(state.job, chosen), keep=not is_behind(context))
        if chosen.not_looked_at:
            box = layout.box()
            write(context, box, outside.QUESTION, "INFO", beside=BOX)
            outside.draw(box, chosen.not_looked_at, lambda path: shortened(path, context))
        if problem := problem_of(state):
            draw_problem(context, layout, problem)
        if not state.backend.ready:
            draw_first(context, layout, state)
        draw_foreign(context, layout, state)


def draw_progress(
    context: bpy.types.Context, layout: bpy.types.UILayout, state: State, is_mine: bool, *, keep: bool
) -> None:
    """How far what is under way is: a bar and ``PROGRESS_LINES`` lines; else what was made last, or nothing.

    A training comes first; child processes beside it have bars of their own. ``keep``: the room for a bar,
    where nothing is under way.
    """
    tasks = [task.name for task in state.tasks]
    job = state.job
    column = layout.column(align=True)
    has_trained = job.run and job.iterations and is_mine
    if state.active or (has_trained and not tasks and not state.made):
        draw_training(context, column, state)
    elif tasks:
        draw_task(column, state, tasks.pop(0), PROGRESS_LINES)
    elif state.made:
        draw_made(column, state.made)
    elif keep:
        column.label(text="")
        write(context, column, "", lines=PROGRESS_LINES)
    for name in tasks:
        draw_task(layout, state, name)
    if state.made and (state.active or state.tasks):
        draw_made(layout, state.made)


def draw_training(context: bpy.types.Context, column: bpy.types.UILayout, state: State) -> None:
    """Iterations, time left; quality, splats, loss, speed; before and after it what is or was done."""
    job = state.job
    text = f"{job.iteration} / {job.iterations}" if job.iterations else "Preparing"
    if job.state == "training" and job.seconds_left > 0.0:
        text += f"   {duration(job.seconds_left)} left"
    column.progress(factor=job.iteration / job.iterations if job.iterations else 0.0, text=text)
    if job.state == "preparing":
        write(context, column, stage_of_training(state), lines=PROGRESS_LINES)
        return
    numbers = [f"{job.gaussians:,} splats"] if job.gaussians else []
    if "PSNR" in job.monitor:
        numbers.insert(0, f"Quality {job.monitor['PSNR']:.2f} dB")
    if state.pace.quiet:
        text = stage_of_training(state)
    elif job.losses and job.state in ("training", "paused"):
        speed = job.iterations_per_second
        text = f"Loss {sum(job.losses.values()):.4f}" + (f", {speed:.1f} iterations/s" if speed else "")
    else:
        text = job.message if state.active or job.state in ("finished", "stopped") else ""
    write(context, column, ", ".join(numbers), lines=1)
    write(context, column, text, lines=1)


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_status,))
