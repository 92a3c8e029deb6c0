# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Train PhysHDR*: how things are, how far, what is wrong, the next step."""

from typing import TYPE_CHECKING

import bpy

from ..blender import layout_of
from ..operators.base import choices
from ..runtime import session
from ..session.advice import headline, next_step, problem_of
from ..session.state import CHECK, DATASET, INSTALL, LOOK, PHOTOS, State
from .parts import SidebarPanel, draw_problem, draw_task, duration, write

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

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


class PHYSHDR_PT_train(SidebarPanel, bpy.types.Panel):
    bl_label = "Train PhysHDR"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, layout_of(self)
        problem = problem_of(state)
        icon = ICONS.get(state.job.state, "RADIOBUT_ON" if state.backend.ready else "RADIOBUT_OFF")
        layout.label(text=headline(state), icon="ERROR" if problem else icon)
        for name in (INSTALL, CHECK, DATASET, LOOK, PHOTOS):
            draw_task(layout, state, name)
        draw_progress(context, layout, state)
        if problem:
            draw_problem(context, layout, problem)
        step = next_step(state, choices(context))
        if step:
            write(context, layout, step, "FORWARD")


def draw_progress(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """How far the training is: iterations, time left, PSNR, Gaussians, loss."""
    job = state.job
    if not job.run or not job.iterations:
        if state.active and job.message:
            write(context, layout, job.message, "INFO")
        return
    text = f"{job.iteration} / {job.iterations}"
    if job.state == "training" and job.seconds_left > 0.0:
        text += f"   {duration(job.seconds_left)} left"
    column = layout.column(align=True)
    column.progress(factor=job.iteration / job.iterations, text=text)
    numbers = [f"{job.gaussians:,} Gaussians"] if job.gaussians else []
    if "PSNR" in job.monitor:
        numbers.insert(0, f"PSNR {job.monitor['PSNR']:.2f} dB")
    column.label(text=", ".join(numbers))
    if job.losses and job.state in ("training", "paused"):
        speed = job.iterations_per_second
        column.label(text=f"Loss {sum(job.losses.values()):.4f}, {speed:.1f} iterations/s")
    elif job.message and state.active:
        write(context, column, job.message)


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_train,))
