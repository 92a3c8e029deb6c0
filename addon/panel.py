# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Train PhysHDR*: it shows the state, the next step, and why a greyed button is greyed."""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy

from ..bridge.lights import AMBIENT
from . import placement, plot
from .blender import layout_of
from .look import draw_look, is_model, slider_name
from .operators.base import choices
from .runtime import session
from .session.advice import headline, next_step, problem_of, why_not
from .session.pythons import is_ours
from .session.state import CHECK, DATASET, INSTALL, LOOK, PHOTOS, Photos, Problem, State
from .settings import PHYSHDR_Settings
from .viewport import overlay
from .viewport.camera import ORTHOGRAPHIC_HINT

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems

#: Pixels of a character at the interface's scale 1, to wrap texts to the panel's width.
CHARACTER = 6.4
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


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "PhysHDR"


class _Subpanel(_Panel):
    bl_parent_id = "PHYSHDR_PT_train"


class PHYSHDR_PT_train(_Panel, bpy.types.Panel):
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


class PHYSHDR_MT_backend(bpy.types.Menu):
    bl_label = "Another Backend"

    def draw(self, context: bpy.types.Context) -> None:
        layout_of(self).operator("physhdr.backend_install", text="Install Again…", icon="IMPORT")
        layout_of(self).operator("physhdr.backend_use", text="Use Existing Python…", icon="FILEBROWSER")


class PHYSHDR_PT_backend(_Subpanel, bpy.types.Panel):
    bl_label = "Backend"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, layout_of(self)
        if state.backend.ready:
            self._draw_ready(context, layout, state)
        else:
            write(context, layout, "Training needs torch, in a Python of its own beside Blender")
            row = layout.row(align=True)
            button(context, row, state, "install", "physhdr.backend_install", "Install…", "IMPORT")
            button(context, row, state, "use_python", "physhdr.backend_use", "Use Python…", "FILEBROWSER")
            if state.backend.python:
                button(context, row, state, "check", "physhdr.backend_check", "Check", "CHECKMARK")
            reasons(context, layout, state, "install")
            if state.backend.incomplete:
                draw_extend(context, layout, state)
        if state.link.status == "off":
            if state.link.pid:
                write(context, layout, f"Process {state.link.pid} does not answer", "UNLINKED")
                layout.operator("physhdr.backend_shutdown", text="End It", icon="QUIT")
            return
        welcome = state.link.welcome
        row = layout.row(align=True)
        row.label(text=f"Running, process {state.link.pid}" if welcome else "Starting", icon="LINKED")
        row.operator("physhdr.log_open", text="", icon="TEXT").filepath = state.link.log
        row.operator("physhdr.backend_shutdown", text="", icon="QUIT")
        if welcome and welcome.version != session().version:
            told = f"It is of version {welcome.version}: shut it down to use {session().version}"
            write(context, layout, told, "ERROR")
        if welcome and not state.job.in_control:
            write(context, layout, f"{state.job.controller or 'Another Blender'} is in control", "LOCKED")
            layout.operator("physhdr.control_take", icon="UNLOCKED")

    def _draw_ready(self, context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
        write(context, layout, report_line(state.backend.report), "CHECKMARK")
        row = layout.row(align=True)
        row.label(text=shortened(state.backend.python, context), icon="FILE_SCRIPT")
        row.operator("physhdr.backend_check", text="Check")
        row.menu("PHYSHDR_MT_backend", text="", icon="DOWNARROW_HLT")
        if state.backend.missing:
            told = f"Photos cannot be prepared without {', '.join(state.backend.missing)}"
            write(context, layout, told, "INFO")
            draw_extend(context, layout, state)
        elif state.backend.missing is None:
            write(context, layout, "Checked by an older version: check it before you prepare photos", "INFO")


class PHYSHDR_PT_dataset(_Subpanel, bpy.types.Panel):
    bl_label = "Data Set"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, layout_of(self)
        layout.prop(context.scene.physhdr, "data", text="")
        dataset = state.dataset
        if dataset.folder == choices(context).data and not state.active:
            column = layout.column(align=True)
            for line in dataset.lines:
                write(context, column, line)
            for warning in dataset.warnings:
                write(context, column, warning, "ERROR")
            if dataset.problem:
                write(context, column, f"{dataset.problem.message}. {dataset.problem.hint}", "ERROR")
            if dataset.folder and state.prepared.folder == dataset.folder:
                write(context, column, state.prepared.found)
                for warning in state.prepared.warnings:
                    write(context, column, warning, "ERROR")
        photos = choices(context).photos
        if photos:
            self._draw_photos(context, layout.box(), state, photos)
        column = layout.column(align=True)
        text = "Prepare Other Photos…" if photos else "Prepare Photos…"
        button(context, column, state, "look", "physhdr.photos_look", text, "CAMERA_DATA")
        text = "Render from This Scene…"
        button(context, column, state, "render", "physhdr.dataset_render", text, "RENDER_STILL")

    def _draw_photos(
        self, context: bpy.types.Context, layout: bpy.types.UILayout, state: State, folder: str
    ) -> None:
        """What was understood of the photos, what can be chosen, and the button for the long work."""
        row = layout.row(align=True)
        row.label(text=shortened(folder, context), icon="FILE_FOLDER")
        row.operator("physhdr.photos_forget", text="", icon="X")
        found = state.photos if state.photos.folder == folder else Photos()
        column = layout.column(align=True)
        for line in found.lines:
            write(context, column, line)
        for warning in found.warnings:
            write(context, column, warning, "ERROR")
        if found.problem:
            write(context, column, f"{found.problem.message}. {found.problem.hint}", "ERROR")
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        settings = context.scene.physhdr
        for name in ("photos_out", "photos_width", "photos_handheld"):
            column.prop(settings, name)
        head, more = layout.panel("physhdr_photos_more", default_closed=True)
        head.label(text="If It Is Misunderstood")
        if more is not None:
            more.use_property_split = True
            more.use_property_decorate = False
            for name in ("bracket", "same_exposure", "exposures", "lens", "borrow_poses", "partial"):
                more.prop(settings, f"photos_{name}")
        if found.seconds >= 0.0:
            write(context, layout, f"Preparing takes about {duration(found.seconds)}", "SORTTIME")
        button(context, layout, state, "photos", "physhdr.photos_prepare", "Prepare", "PLAY")
        if not state.task(PHOTOS):
            reasons(context, layout, state, "photos")


class PHYSHDR_PT_training(_Subpanel, bpy.types.Panel):
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


class PHYSHDR_PT_illumination(_Subpanel, bpy.types.Panel):
    bl_label = "Illumination"

    def draw(self, context: bpy.types.Context) -> None:
        state, layout, settings = session().state, layout_of(self), context.scene.physhdr
        target = context.object
        if target is not None and is_model(target):
            layout.label(text=target.name, icon="OUTLINER_OB_POINTCLOUD")
            draw_look(layout, target)
            column = layout.column()
            column.use_property_split = True
            column.prop(target, "physhdr_viewport", text="3D View")
            layout.separator()
        row = layout.row()
        reason = why_not(state, "preview")
        row.enabled = settings.preview or not reason
        row.prop(settings, "preview", toggle=True, icon="HIDE_OFF" if settings.preview else "HIDE_ON")
        reason = reason or view_hint(context)
        if reason:
            write(context, layout, reason, "INFO")
        column = layout.column()
        column.use_property_split = True
        column.active = settings.preview
        column.prop(settings, "exposure_ev")
        row = column.row()
        row.active = state.job.can_relight or not state.job.has_model
        draw_levels(row.column(), settings, state.job.lights or (AMBIENT,))
        column.prop(settings, "tone")
        if state.job.has_model and not state.job.can_relight:
            write(context, layout, "This method learns no illumination: the level only scales", "INFO")


class PHYSHDR_PT_capture(_Subpanel, bpy.types.Panel):
    bl_label = "Scale and Ground"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return is_model(context.object)

    def draw(self, context: bpy.types.Context) -> None:
        layout, target = layout_of(self), context.object
        assert is_model(target)
        column = layout.column(align=True)
        column.operator("physhdr.capture_scale", text="Scale by Two Points…", icon="DRIVER_DISTANCE")
        column.operator("physhdr.capture_floor", text="Floor by Three Points…", icon="ORIENTATION_NORMAL")
        column.operator("physhdr.capture_height", text="By the Cameras' Height…", icon="VIEW_CAMERA")
        known = context.scene.physhdr.captures.get(placement.capture_of(target))
        if known is None:
            write(context, layout, "Photos tell neither how large things are nor where the floor is", "INFO")
            return
        told = ["metres" if known.has_scale else "scale as imported"]
        told.append("floor at z = 0" if known.has_floor else "ground as imported")
        row = layout.row(align=True)
        row.label(text=", ".join(told).capitalize(), icon="CHECKMARK")
        row.operator("physhdr.capture_reset", text="", icon="LOOP_BACK")


def draw_levels(layout: bpy.types.UILayout, settings: PHYSHDR_Settings, lights: Sequence[str]) -> None:
    """The live preview's slider for each light of the backend's model."""
    layout.prop(settings, "lighting_level", text=slider_name(lights, 0))
    for index, name in enumerate(lights[1:], 1):
        light = settings.further_levels.get(name)
        if light is not None:  # it comes with the timer's next look
            layout.prop(light, "level", text=slider_name(lights, index))


def view_hint(context: bpy.types.Context) -> str:
    """What this 3D view cannot show, and the remedy; empty where it can show all."""
    view = context.space_data
    if context.scene.physhdr.preview and not view.region_3d.is_perspective:
        return ORTHOGRAPHIC_HINT
    return overlay.hint(view, context.scene)


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


def draw_extend(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The button that installs what is missing into the environment of ours that is there."""
    if is_ours(session().home, state.backend.python):
        button(context, layout, state, "extend", "physhdr.backend_extend", "Add What Is Missing", "IMPORT")
    elif state.backend.missing:
        packages = " ".join(f"'{each}'" for each in state.backend.missing)
        write(context, layout, f"Add it to your Python: -m pip install {packages}", "INFO")


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


def report_line(report: dict) -> str:
    """What the check found, for people."""
    versions = report.get("versions", {})
    told = [f"{name} {versions[name]}" for name in ("torch", "numba") if versions.get(name)]
    return ", ".join([*told, str(report.get("device", ""))])


def shortened(path: str, context: bpy.types.Context) -> str:
    """The end of a path, as much as there is room for beside a button."""
    room = max(12, columns(context) - 14)
    return path if len(path) <= room else f"…{path[1 - room :]}"


_CLASSES: tuple[type, ...] = (
    PHYSHDR_PT_train,
    PHYSHDR_MT_backend,
    PHYSHDR_PT_backend,
    PHYSHDR_PT_dataset,
    PHYSHDR_PT_training,
    PHYSHDR_PT_illumination,
    PHYSHDR_PT_capture,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
