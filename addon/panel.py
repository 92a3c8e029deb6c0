# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Train PhysHDR*: it shows the state, the next step, and why a greyed button is greyed."""

import textwrap

import bpy

from . import plot
from .look import draw_look, is_model
from .operators.base import choices
from .runtime import session
from .session.advice import headline, next_step, problem_of, why_not
from .session.state import CHECK, DATASET, INSTALL, State

#: Pixels of a character at the interface's scale 1, to wrap texts to the panel's width.
CHARACTER = 7.0
ICONS = {
    "training": "PLAY",
    "preparing": "SORTTIME",
    "paused": "PAUSE",
    "stopping": "FILE_TICK",
    "failed": "ERROR",
    "finished": "CHECKMARK",
    "stopped": "SNAP_FACE",
    "open": "OUTLINER_OB_POINTCLOUD",
}


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "PhysHDR"


class _Subpanel(_Panel):
    bl_parent_id = "PHYSHDR_PT_train"


class PHYSHDR_PT_train(_Panel, bpy.types.Panel):
    bl_label = "Train PhysHDR"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, self.layout
        icon = ICONS.get(state.job.state, "RADIOBUT_ON" if state.backend.ready else "RADIOBUT_OFF")
        layout.label(text=headline(state), icon="ERROR" if problem_of(state) else icon)
        step = next_step(state, choices(context))
        if step:
            write(context, layout, step, "FORWARD")
        problem = problem_of(state)
        if problem:
            box = layout.box()
            box.alert = True
            write(context, box, problem.message, "ERROR")
            box.alert = False
            if problem.hint:
                write(context, box, problem.hint, "INFO")
            row = box.row()
            if problem.log:
                row.operator("physhdr.log_open", icon="TEXT").filepath = problem.log
            row.operator("physhdr.problem_dismiss", icon="X")


class PHYSHDR_PT_backend(_Subpanel, bpy.types.Panel):
    bl_label = "Backend"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, self.layout
        backend = state.backend
        if backend.ready:
            for line in report_lines(backend.report):
                layout.label(text=line)
            write(context, layout, backend.python, "FILE_SCRIPT")
        else:
            layout.label(text="Torch lives in a Python of its own, not in Blender")
        for name in (INSTALL, CHECK):
            draw_task(layout, state, name)
        column = layout.column(align=True)
        text = "Install Again" if backend.ready else "Install"
        button(context, column, state, "install", "physhdr.backend_install", text, "IMPORT")
        row = column.row(align=True)
        button(context, row, state, "use_python", "physhdr.backend_use", "Use Existing Python", "FILEBROWSER")
        button(context, row, state, "check", "physhdr.backend_check", "Check", "CHECKMARK")
        if state.link.status == "off":
            return
        box = layout.box()
        welcome = state.link.welcome
        box.label(text=f"Running, process {welcome.pid}" if welcome else "Starting", icon="LINKED")
        if welcome and not state.job.in_control:
            write(context, box, f"{state.job.controller or 'Another Blender'} is in control", "LOCKED")
            box.operator("physhdr.control_take", icon="UNLOCKED")
        row = box.row(align=True)
        row.operator("physhdr.log_open", icon="TEXT").filepath = state.link.log
        row.operator("physhdr.backend_shutdown", text="Shut Down", icon="QUIT")


class PHYSHDR_PT_dataset(_Subpanel, bpy.types.Panel):
    bl_label = "Data Set"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, self.layout
        layout.prop(context.scene.physhdr, "data", text="")
        dataset = state.dataset
        if context.scene.physhdr.data:
            for line in dataset.lines:
                layout.label(text=line)
            for warning in dataset.warnings:
                write(context, layout, warning, "ERROR")
            if dataset.problem:
                write(context, layout, f"{dataset.problem.message}. {dataset.problem.hint}", "ERROR")
        draw_task(layout, state, DATASET)
        text = "Render from This Scene…"
        button(context, layout, state, "render", "physhdr.dataset_render", text, "RENDER_STILL")


class PHYSHDR_PT_training(_Subpanel, bpy.types.Panel):
    bl_label = "Training"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, self.layout, context.scene.physhdr
        column = layout.column()
        column.use_property_split = True
        column.enabled = not state.active
        column.prop(settings, "out")
        column.prop(settings, "preset")
        column.prop(settings, "iterations")
        column.prop(settings, "exposure_mode")
        column.prop(settings, "device")
        if state.active:
            self._draw_steering(context, layout, state)
        else:
            row = layout.row(align=True)
            button(context, row, state, "start", "physhdr.train_start", "Start", "PLAY")
            button(context, row, state, "resume", "physhdr.train_resume", "Resume", "FILE_REFRESH")
        self._draw_numbers(context, layout, state)
        row = layout.row(align=True)
        if not state.job.has_model:
            button(context, row, state, "open", "physhdr.run_open", "Open Run", "FILE_FOLDER")
        button(context, row, state, "import", "physhdr.result_import", "Import Result", "IMPORT")

    def _draw_steering(self, context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
        row = layout.row(align=True)
        if state.job.state == "paused":
            button(context, row, state, "continue", "physhdr.train_continue", "Continue", "PLAY")
        else:
            button(context, row, state, "pause", "physhdr.train_pause", "Pause", "PAUSE")
        text = "End at Once" if state.stopping else "Stop"
        button(context, row, state, "stop", "physhdr.train_stop", text, "SNAP_FACE")

    def _draw_numbers(self, context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
        job = state.job
        if job.state == "idle":
            return
        if job.iterations:
            text = f"{job.iteration} / {job.iterations}"
            if job.state == "training" and job.seconds_left > 0.0:
                text += f"   {duration(job.seconds_left)} left"
            layout.progress(factor=job.iteration / job.iterations, text=text)
        if job.message:
            write(context, layout, job.message, "INFO")
        if job.gaussians:
            grid = layout.column(align=True)
            grid.label(text=f"{job.gaussians:,} Gaussians")
            if "PSNR" in job.monitor:
                grid.label(text=f"PSNR {job.monitor['PSNR']:.2f} dB on a test view")
            if job.losses and job.state in ("training", "paused"):
                speed = job.iterations_per_second
                grid.label(text=f"Loss {sum(job.losses.values()):.4f}, {speed:.1f} iterations/s")
        if plot.icon_id() and len(state.history.iterations) > 1:
            layout.template_icon(plot.icon_id(), scale=8.0)
            layout.label(text="Loss (orange, logarithmic), PSNR (blue)")


class PHYSHDR_PT_illumination(_Subpanel, bpy.types.Panel):
    bl_label = "Illumination"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, self.layout, context.scene.physhdr
        target = context.object
        if target is not None and is_model(target):
            layout.label(text=target.name, icon="OUTLINER_OB_POINTCLOUD")
            draw_look(layout, target)
            layout.separator()
        row = layout.row()
        reason = why_not(state, "preview")
        row.enabled = settings.preview or not reason
        row.prop(settings, "preview", toggle=True, icon="HIDE_OFF" if settings.preview else "HIDE_ON")
        if reason:
            write(context, layout, reason, "INFO")
        column = layout.column()
        column.use_property_split = True
        column.active = settings.preview
        column.prop(settings, "exposure_ev")
        row = column.row()
        row.active = state.job.can_relight or not state.job.has_model
        row.prop(settings, "lighting_level")
        column.prop(settings, "tone")
        if state.job.has_model and not state.job.can_relight:
            write(context, layout, "This method learns no illumination: the level only scales", "INFO")


def button(
    context: bpy.types.Context,
    layout: bpy.types.UILayout,
    state: State,
    action: str,
    operator: str,
    text: str,
    icon: str,
) -> None:
    """An operator's button, greyed where the user's choices do not allow it, with the reason beside it."""
    reason = why_not(state, action, choices(context))
    column = layout.column(align=True)
    row = column.row(align=True)
    row.enabled = not reason
    row.operator(operator, text=text, icon=icon)
    if reason and action in ("start", "install", "import"):  # the others' reasons are in their tooltips
        write(context, column, reason, "INFO")


def draw_task(layout: bpy.types.UILayout, state: State, name: str) -> None:
    """How far a child process is, what it does, and a button that cancels it."""
    task = state.task(name)
    if task is None:
        return
    text = f"{task.fraction:.0%}"
    if task.seconds_left >= 0.0:
        text += f"   {duration(task.seconds_left)} left"
    row = layout.row(align=True)
    row.progress(factor=task.fraction, text="Cancelling" if task.cancelling else text)
    row.operator("physhdr.task_cancel", text="", icon="X").name = name
    if task.message:
        layout.label(text=task.message)


def write(context: bpy.types.Context, layout: bpy.types.UILayout, text: str, icon: str = "NONE") -> None:
    """A text of several lines, as wide as the panel."""
    scale = context.preferences.system.ui_scale * CHARACTER
    width = max(20, int(context.region.width / scale) - 6)
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, width) or [""]):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def duration(seconds: float) -> str:
    """``75`` → ``1 min 15 s``."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {seconds} s" if minutes else f"{seconds} s"


def report_lines(report: dict) -> list[str]:
    """What the check found, for people."""
    versions = report.get("versions", {})
    told = [f"{name} {versions[name]}" for name in ("python", "torch", "numba") if versions.get(name)]
    return [", ".join(told), str(report.get("device", ""))] if told else [str(report.get("device", ""))]


_CLASSES: tuple[type, ...] = (
    PHYSHDR_PT_train,
    PHYSHDR_PT_backend,
    PHYSHDR_PT_dataset,
    PHYSHDR_PT_training,
    PHYSHDR_PT_illumination,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
