# SPDX-License-Identifier: GPL-3.0-or-later
"""What is under way, and what was made last, in Blender's status bar: seen whatever the sidebar shows."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import bpy

from ..blender import add_entry, layout_of, remove_entry
from ..runtime import session
from ..session.state import State
from ..session.tasks import TITLES, duration, ended, stage, stage_of_training
from .parts import draw_ways

#: Of a bar, in units of the interface.
WIDTH = 12.0


class Work(NamedTuple):
    """``task``: the child process that a button cancels; empty: a training, which its own panel stops.
    ``stage``: what it does, where it has shown no progress for a while."""

    text: str
    fraction: float
    task: str = ""
    stage: str = ""


def at_work(state: State) -> Iterator[Work]:
    """The training and each child process, with the time that is left where it is known."""
    job = state.job
    if state.active:
        text = f"Training {job.iteration} / {job.iterations}" if job.iterations else "Preparing a training"
        words = stage_of_training(state) if state.pace.quiet else ""
        yield Work(_with_time(text, job.seconds_left), job.iteration / max(job.iterations, 1), stage=words)
    for task in state.tasks:
        text = "Cancelling" if task.cancelling else f"{task.fraction:.0%}"
        text = _with_time(f"{TITLES[task.name]} {text}", task.seconds_left)
        yield Work(text, task.fraction, task.name, stage(task) if task.pace.quiet else "")


def _with_time(text: str, seconds: float) -> str:
    return f"{text}, {duration(seconds)} left" if seconds > 0.0 else text


def draw(header: Any, context: bpy.types.Context) -> None:
    """Appended to the status bar's header."""
    layout = layout_of(header)
    state = session().state
    for work in at_work(state):
        row = layout.row(align=True)
        bar = row.row()
        bar.ui_units_x = WIDTH
        bar.progress(factor=work.fraction, text=work.text)
        if work.task:
            row.operator("physhdr.task_cancel", text="", icon="X").name = work.task
        if work.stage:
            row.label(text=work.stage)
    if state.made:
        row = layout.row(align=True)
        row.label(text=ended(state.made), icon="CHECKMARK")
        draw_ways(row, state.made)


def register() -> None:
    add_entry(bpy.types.STATUSBAR_HT_header, draw)


def unregister() -> None:
    remove_entry(bpy.types.STATUSBAR_HT_header, draw)
