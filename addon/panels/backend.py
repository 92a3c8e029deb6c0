# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer's Python and its process."""

import bpy

from ..blender import layout_of
from ..runtime import session
from ..session.advice import silence
from ..session.pythons import is_ours
from ..session.state import ENDING, State
from .parts import ICON, button, reasons, shortened, write

#: The first way in, and what it downloads: for the processor, on an ordinary line.
TRAINS = "Train from photos, or from this scene. The trainer is 1.8 GB, once, about 3 minutes"
#: Of the first screen's buttons, in those of others.
TALL = 1.4


class PHYSHDR_MT_backend(bpy.types.Menu):
    bl_label = "Another Backend"

    def draw(self, context: bpy.types.Context) -> None:
        if session().state.backend.ready:
            layout_of(self).operator("physhdr.backend_install", text="Install Again…", icon="IMPORT")
        layout_of(self).operator("physhdr.backend_use", text="Use Existing Python…", icon="FILEBROWSER")


def draw(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The one that works, folded: what it does is shown at the top."""
    warnings = warnings_of(state.backend.report)
    head, body = layout.panel("physhdr_trainer", default_closed=True)
    head.label(text="Trainer", icon="ERROR" if warnings or state.backend.missing else "NONE")
    if body is None:
        return
    write(context, body, report_line(state.backend.report), "CHECKMARK")
    for warning in warnings:
        write(context, body, warning, "ERROR")
    body.label(text=shortened(state.backend.python, context, ICON), icon="FILE_SCRIPT")
    row = body.row(align=True)
    row.operator("physhdr.backend_check", text="Check")
    row.menu("PHYSHDR_MT_backend", text="", icon="DOWNARROW_HLT")
    if state.backend.missing:
        text = f"Photos cannot be prepared without {', '.join(state.backend.missing)}"
        write(context, body, text, "INFO")
        draw_extend(context, body, state)
    if state.link.status != "off":
        row = body.row(align=True)
        text = f"Running, process {state.link.pid}" if state.link.welcome else "Starting"
        row.label(text=text, icon="LINKED")
        row.operator("physhdr.log_open", text="", icon="TEXT").filepath = state.link.log
        row.operator("physhdr.backend_shutdown", text="", icon="QUIT")


def draw_foreign(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """A process that does not answer, or is of another version or Blender, and what is done with it."""
    link, welcome = state.link, state.link.welcome
    if link.status == "off":
        if link.pid:
            write(context, layout, f"Process {link.pid} {silence(link)}", "UNLINKED")
            text = "End Now" if link.barred == ENDING else "End It"
            layout.operator("physhdr.backend_shutdown", text=text, icon="QUIT")
        return
    if welcome and welcome.version != session().version:
        text = f"The trainer is of version {welcome.version}: shut it down to use {session().version}"
        write(context, layout, text, "ERROR")
        layout.operator("physhdr.backend_shutdown", text="Shut Down Trainer", icon="QUIT")
    if welcome and not state.job.in_control:
        write(context, layout, f"{state.job.controller or 'Another Blender'} is in control", "LOCKED")
        layout.operator("physhdr.control_take", icon="UNLOCKED")


def draw_first(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The two ways in: one needs the trainer, the other nothing."""
    write(context, layout, TRAINS)
    row = layout.row(align=True)
    row.scale_y = TALL
    button(context, row, state, "install", "physhdr.backend_install", "Get the Trainer…", "IMPORT")
    row.menu("PHYSHDR_MT_backend", text="", icon="DOWNARROW_HLT")
    reasons(context, layout, state, "install")
    if not bpy.app.online_access and hasattr(bpy.types, "EXTENSIONS_OT_userpref_allow_online"):
        layout.operator("extensions.userpref_allow_online", text="Allow Online Access", icon="CHECKMARK")
    if state.backend.python:
        button(context, layout, state, "check", "physhdr.backend_check", "Check", "CHECKMARK")
    if state.backend.incomplete:
        draw_extend(context, layout, state)
    layout.separator()
    write(context, layout, "Look at a splat, relight and render it: needs no trainer")
    row = layout.row()
    row.scale_y = TALL
    row.operator("physhdr.model_import", text="Open a Splat…", icon="OUTLINER_OB_POINTCLOUD")


def warnings_of(report: dict) -> list[str]:
    """What the check found odd; what photos lack is shown beside its remedy.

    A torch that is for a card, and computes on the processor, is odd, too.
    """
    warnings = report.get("warnings")
    texts = [text for text in warnings if isinstance(text, str)] if isinstance(warnings, list) else []
    texts = [text for text in texts if not text.startswith("photos cannot be prepared")]
    if "+cu" in str(report.get("versions", {}).get("torch", "")) and report.get("device") == "cpu":
        return [f"Torch is for a card, but it computes {report.get('why', 'on the CPU')}", *texts]
    return texts


def draw_extend(context: bpy.types.Context, layout: bpy.types.UILayout, state: State) -> None:
    """The button that installs what is missing into the environment of ours that is there."""
    if is_ours(session().home, state.backend.python):
        button(context, layout, state, "extend", "physhdr.backend_extend", "Add What Is Missing", "IMPORT")
    elif state.backend.missing:
        packages = " ".join(f"'{each}'" for each in state.backend.missing)
        write(context, layout, f"Add it to your Python: -m pip install {packages}", "INFO")


def report_line(report: dict) -> str:
    """What the check found, for people."""
    versions = report.get("versions", {})
    parts = [f"{name} {versions[name]}" for name in ("torch", "numba") if versions.get(name)]
    return ", ".join([*parts, str(report.get("device", ""))])


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_MT_backend,))
