# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for the backend's Python and process: install, use, check, cancel, shut down, show its log."""

import hashlib
from pathlib import Path
from typing import ClassVar

import bpy

from ...bridge.messages import ControlTake, Shutdown
from .. import settings
from ..blender import layout_of
from ..paths import ROOT
from ..runtime import redraw, session
from ..session.pythons import base_of, find_pythons, is_ours, working_python
from ..session.state import CHECK, INSTALL, Dismissed, MadeDismissed
from ..session.tasks import TASKS
from .base import PhysHDROperator, follow_task

INSTALL_SCRIPT = ROOT / "addon" / "scripts" / "install_backend.py"
#: Seconds that scripts wait for an installation or a check.
INSTALL_SECONDS, CHECK_SECONDS = 3600.0, 3600.0
#: Kept on a text: the log that it shows, and a hash of what it showed of it last.
LOG, SHOWN = "physhdr_log", "physhdr_log_shown"


class PHYSHDR_OT_backend_install(PhysHDROperator):
    """Make an environment of its own for the trainer and install torch and what else it needs there"""

    bl_idname = "physhdr.backend_install"
    bl_label = "Get the Trainer"
    action = "install"

    python: bpy.props.StringProperty(
        name="Python",
        subtype="FILE_PATH",
        description="Python 3.11 or newer to make the environment with; empty: one that is found",
    )
    torch: bpy.props.EnumProperty(name="Build of torch", items=settings.TORCH_BUILDS)
    fresh: bpy.props.BoolProperty(
        name="Anew",
        description="Even where there is a complete environment of the same packages",
        options={"SKIP_SAVE"},
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        state = session().state
        self.fresh = state.backend.ready or state.backend.problem is not None
        if not self.properties.is_property_set("torch"):
            self.torch = settings.preferences().torch
        if not self.python:
            found = find_pythons()
            self.python = str(found[0]) if found else ""
        return context.window_manager.invoke_props_dialog(self, width=460)

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        layout.prop(self, "python")
        layout.prop(self, "torch")
        layout.label(text=f"Into {settings.home_folder()}", icon="FILE_FOLDER")

    def run(self, context: bpy.types.Context) -> set[str]:
        python = working_python(bpy.path.abspath(self.python)) if self.python else None
        if python is None and not self.python:
            python = next(iter(find_pythons()), None)
        if python is None:
            what = (
                f"{self.python} is not a working Python 3.11 or newer" if self.python else "no Python found"
            )
            self.report({"ERROR"}, f"{what}: install one from python.org and choose it here")
            return {"CANCELLED"}
        how = ["--torch", self.torch, *(["--fresh"] if self.fresh else [])]
        return install(self, python, how, self.wait, "The backend is installed")


class PHYSHDR_OT_backend_extend(PhysHDROperator):
    """Install what the backend's environment lacks of this version's packages; torch and all that is there
    already is kept, and not downloaded again"""

    bl_idname = "physhdr.backend_extend"
    bl_label = "Add What Is Missing"
    action = "extend"

    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> set[str]:
        current = session()
        python = base_of(current.state.backend.python)
        if python is None or not is_ours(current.home, current.state.backend.python):
            self.report({"ERROR"}, f"{current.state.backend.python} was not installed here: add to it by pip")
            return {"CANCELLED"}
        return install(self, python, ["--extend"], self.wait, "The backend is complete")


def install(operator: PhysHDROperator, python: Path, how: list[str], wait: bool, success: str) -> set[str]:
    """Start the installer by ``python``; with ``wait``, report how it ended."""
    current = session()
    command = [str(python), str(INSTALL_SCRIPT), "--target", str(current.home)]
    command += ["--launcher", str(current.launcher), *how]
    log, home = current.home / "install.log", str(current.home)
    current.start_task(INSTALL, command, log, current.environment(), makes=home)
    if not wait:
        return {"FINISHED"}
    return follow_task(operator, INSTALL, INSTALL_SECONDS, success)


class PHYSHDR_OT_backend_use(PhysHDROperator):
    """Use an existing Python that has torch and the trainer's other packages; it is checked first"""

    bl_idname = "physhdr.backend_use"
    bl_label = "Use Existing Python"
    action = "use_python"

    filepath: bpy.props.StringProperty(
        name="Python", subtype="FILE_PATH", description="For example /home/me/torch/bin/python"
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> set[str]:
        path = Path(bpy.path.abspath(self.filepath))
        if not path.is_file():
            self.report({"ERROR"}, f"there is no Python {path}: choose its executable, e.g. bin/python")
            return {"CANCELLED"}
        # Not resolved: an environment's python is a link, and following it leaves the environment.
        return check(self, self.wait, str(path))


class PHYSHDR_OT_backend_check(PhysHDROperator):
    """Import torch, find the device, compile the kernels (once: half a minute on an idle machine, minutes on
    a busy one) and train one step, with a log of its own"""

    bl_idname = "physhdr.backend_check"
    bl_label = "Check Backend"
    action = "check"

    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> set[str]:
        return check(self, self.wait)


def check(operator: PhysHDROperator, wait: bool, python: str = "") -> set[str]:
    """Start the check of the chosen Python, or of another ``python``; with ``wait``, report how it ended."""
    current = session()
    command = current.backend_command("check", "--json", python=python)
    current.start_task(CHECK, command, current.home / "check.log", current.environment(), python)
    if not wait:
        return {"FINISHED"}
    return follow_task(operator, CHECK, CHECK_SECONDS, "The backend works")


class PHYSHDR_OT_task_cancel(bpy.types.Operator):
    """Cancel what is under way; what is done already stays"""

    bl_idname = "physhdr.task_cancel"
    bl_label = "Cancel"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    name: bpy.props.EnumProperty(name="What", items=TASKS)

    def execute(self, context: bpy.types.Context) -> set[str]:
        session().cancel_task(self.name)
        return {"FINISHED"}


class PHYSHDR_OT_backend_shutdown(PhysHDROperator):
    """End the backend's process; a training saves a checkpoint first"""

    bl_idname = "physhdr.backend_shutdown"
    bl_label = "Shut Down Backend"
    action = "shutdown"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().ask(Shutdown())
        return {"FINISHED"}


class PHYSHDR_OT_control_take(PhysHDROperator):
    """Steer the backend from this Blender; the one that did so before only watches then"""

    bl_idname = "physhdr.control_take"
    bl_label = "Take Control"
    action = "take_control"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().ask(ControlTake())
        return {"FINISHED"}


class PHYSHDR_OT_log_open(bpy.types.Operator):
    """Show a log in Blender's text editor"""

    bl_idname = "physhdr.log_open"
    bl_label = "Show Log"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    filepath: bpy.props.StringProperty(name="Log", subtype="FILE_PATH")

    def execute(self, context: bpy.types.Context) -> set[str]:
        path = Path(self.filepath)
        if not path.is_file():
            self.report({"ERROR"}, f"there is no log {path}")
            return {"CANCELLED"}
        text = _shown_before(path) or bpy.data.texts.new(path.name)
        text.from_string(path.read_text(encoding="utf-8", errors="replace"))
        text[LOG], text[SHOWN] = str(path), _digest(text)
        if context.window and not bpy.app.background:
            bpy.ops.wm.window_new()
            area = context.window_manager.windows[-1].screen.areas[0]
            area.type = "TEXT_EDITOR"
            area.spaces.active.text = text
        self.report({"INFO"}, f"{path} is text {text.name!r}")
        return {"FINISHED"}


def _shown_before(path: Path) -> bpy.types.Text | None:
    """The text that showed this log last. One of its name may be the user's own, and so is one that they
    have written into."""
    texts = (text for text in bpy.data.texts if text.get(LOG) == str(path) and text.library is None)
    return next((text for text in texts if text.get(SHOWN) == _digest(text)), None)


def _digest(text: bpy.types.Text) -> str:
    return hashlib.sha256(text.as_string().encode()).hexdigest()


class PHYSHDR_OT_problem_dismiss(bpy.types.Operator):
    """I have read it"""

    bl_idname = "physhdr.problem_dismiss"
    bl_label = "Dismiss"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        session().dispatch(Dismissed())
        return {"FINISHED"}


class PHYSHDR_OT_made_dismiss(bpy.types.Operator):
    """I have seen what was made; nothing on disk is changed"""

    bl_idname = "physhdr.made_dismiss"
    bl_label = "Dismiss"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        session().dispatch(MadeDismissed())
        redraw()
        return {"FINISHED"}


_CLASSES = (
    PHYSHDR_OT_backend_install,
    PHYSHDR_OT_backend_extend,
    PHYSHDR_OT_backend_use,
    PHYSHDR_OT_backend_check,
    PHYSHDR_OT_task_cancel,
    PHYSHDR_OT_backend_shutdown,
    PHYSHDR_OT_control_take,
    PHYSHDR_OT_log_open,
    PHYSHDR_OT_problem_dismiss,
    PHYSHDR_OT_made_dismiss,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
