# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for the training: start, resume, pause, continue, stop, open a run, import its result, wait."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import bpy

from ...bridge.errors import FileMissingError, PhysHDRError
from ...bridge.limits import THREADS_MAX
from ...bridge.messages import (
    JobStatus,
    ModelExport,
    Request,
    RunOpen,
    TrainContinue,
    TrainPause,
    TrainResume,
    TrainStart,
)
from ...bridge.run_folder import MODEL_FILE
from .. import settings
from ..capture import startup_cube
from ..capture.dataset_cameras import first_place
from ..chosen_run import proposed_run
from ..model.look import is_model
from ..paths import absolute, whole
from ..runtime import session
from ..session.advice import problem_of
from ..session.state import EndAsked, State, StopAsked
from ..viewport.framing import look_from
from .afterwards import is_modal
from .base import PhysHDROperator, choose_named, has_run, moved_data

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

FOLDER: "set[PropertyFlagItems]" = {"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}
#: Seconds that scripts wait for the backend to take on a request, and for a training.
ANSWER_SECONDS, TRAIN_SECONDS = 120.0, 30 * 24 * 3600.0

WAIT = {"default": bpy.app.background, "options": {"HIDDEN", "SKIP_SAVE"}}


class _Training(PhysHDROperator):
    """What starting and resuming share: they ask, and in scripts wait until the training has ended."""

    if TYPE_CHECKING:
        wait: bool

    def begin(self, request: Request) -> set[str]:
        current = session()
        current.ask(request)
        if not self.wait:
            return {"FINISHED"}
        return wait_for(self, _is_over, TRAIN_SECONDS, "ended")


def _is_over(state: State) -> bool:
    """Whether the job that was asked for has come to an end, good or bad."""
    return not state.active and not state.waiting and not state.beginning


def wait_for(
    operator: bpy.types.Operator, done: Callable[[State], bool], seconds: float, what: str
) -> set[str]:
    """Pump until ``done``; report what came of it. For scripts: in a window the timer pumps."""
    current = session()
    reached = current.wait(done, seconds)
    problem = problem_of(current.state)
    if problem:
        operator.report({"ERROR"}, " ".join(filter(None, (problem.message, problem.hint))))
        return {"CANCELLED"}
    if not reached:
        operator.report({"WARNING"}, f"not {what} within {seconds:.0f} s; it continues")
        return {"CANCELLED"}
    operator.report({"INFO"}, f"{what}: {describe(current.state.job)}")
    return {"FINISHED"}


def describe(job: JobStatus) -> str:
    """A job in one line: iterations, Gaussians, PSNR."""
    parts = [job.state, f"iteration {job.iteration} of {job.iterations}"]
    parts += [f"{job.gaussians} Gaussians"] if job.gaussians else []
    if "PSNR" in job.monitor:
        parts.append(f"{job.monitor['PSNR']:.2f} dB")
    return ", ".join(parts)


def _chosen(operator: bpy.types.Operator, context: bpy.types.Context, name: str) -> Any:
    """An argument of the operator, or the scene's setting of that name where it was not given."""
    source = operator if operator.properties.is_property_set(name) else context.scene.physhdr
    return getattr(source, name)


def _folder(operator: bpy.types.Operator, context: bpy.types.Context, name: str, what: str) -> str:
    return _whole(_chosen(operator, context, name), what, name)


def _whole(chosen: str, what: str, name: str) -> str:
    if not chosen.strip():
        raise FileMissingError(f"no {what} is chosen", f"Choose it in the panel, or give {name}=….")
    return whole(chosen)


def _run_folder(operator: bpy.types.Operator, context: bpy.types.Context, data: str) -> str:
    """The run's folder as a whole path: what is given, chosen, or proposed for the data set ``data``.

    Who asks is about to use it, and the scene's data set.
    """
    choose_named(context)
    chosen = _chosen(operator, context, "out") or proposed_run(data)
    return _whole(chosen, "folder of a run", "out")


def _remember(context: bpy.types.Context, out: str, data: str = "") -> None:
    """What was begun is the scene's choice where it has none: the panel then continues with that."""
    chosen = context.scene.physhdr
    if context.scene.is_editable:
        if data and not chosen.data:
            chosen.data = data
        if not chosen.out:
            proposed = proposed_run(absolute(chosen.data))
            chosen.out = proposed if absolute(proposed) == out else out


# SKIP_SAVE (in FOLDER, too): Blender would remember a former call's arguments, and take them for this one's.


class PHYSHDR_OT_train_start(_Training):
    """Train on the data set; the model and its checkpoints go to the run's folder"""

    bl_idname = "physhdr.train_start"
    bl_label = "Start Training"
    action = "start"

    data: bpy.props.StringProperty(name="Data Set", subtype="DIR_PATH", options=FOLDER)
    out: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options=FOLDER)
    preset: bpy.props.EnumProperty(
        name="Method", items=settings.PRESETS, default="default", options={"SKIP_SAVE"}
    )
    iterations: bpy.props.IntProperty(
        name="Iterations",
        min=0,
        description="Steps of the training; 0: as many as the method needs for data of this size",
        options={"SKIP_SAVE"},
    )
    exposure_mode: bpy.props.EnumProperty(
        name="Exposures", items=settings.EXPOSURE_MODES, options={"SKIP_SAVE"}
    )
    device: bpy.props.EnumProperty(name="Device", items=settings.DEVICES, options={"SKIP_SAVE"})
    threads: bpy.props.IntProperty(name="Threads", min=0, max=THREADS_MAX, options={"SKIP_SAVE"})
    seed: bpy.props.IntProperty(name="Seed", min=0, options={"SKIP_SAVE"})
    overwrite: bpy.props.BoolProperty(
        name="Replace the Run",
        description="The run's folder holds a training: replace it",
        options={"SKIP_SAVE"},
    )
    wait: bpy.props.BoolProperty(**WAIT)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        data = absolute(_chosen(self, context, "data"))
        out = absolute(_chosen(self, context, "out") or proposed_run(data))
        if has_run(out) and not self.overwrite:
            self.overwrite = True
            return context.window_manager.invoke_confirm(
                self,
                event,
                title="Replace the training in this folder?",
                message=f"{out} holds a trained run. Resume continues it instead.",
                confirm_text="Replace",
                icon="WARNING",
            )
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        names = ("preset", "exposure_mode", "device", "threads")
        data = _folder(self, context, "data", "data set")
        out = _run_folder(self, context, data)
        request = TrainStart(
            data=data,
            out=out,
            iterations=_chosen(self, context, "iterations") or None,
            seed=self.seed,
            overwrite=self.overwrite,
            **{name: _chosen(self, context, name) for name in names},
        )
        _remember(context, out, data)
        return self.begin(request)


class PHYSHDR_OT_train_resume(_Training):
    """Go on with the training in the run's folder, from its newest checkpoint"""

    bl_idname = "physhdr.train_resume"
    bl_label = "Resume Training"
    action = "resume"

    out: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options=FOLDER)
    data: bpy.props.StringProperty(
        name="Data Set",
        subtype="DIR_PATH",
        description="Where the run's data set is now, if it has moved",
        options=FOLDER,
    )
    device: bpy.props.EnumProperty(name="Device", items=settings.DEVICES, options={"SKIP_SAVE"})
    threads: bpy.props.IntProperty(name="Threads", min=0, max=THREADS_MAX, options={"SKIP_SAVE"})
    wait: bpy.props.BoolProperty(**WAIT)

    def run(self, context: bpy.types.Context) -> set[str]:
        folder = _run_folder(self, context, absolute(context.scene.physhdr.data))
        _remember(context, folder)
        given = {name: _chosen(self, context, name) for name in ("device", "threads")}
        return self.begin(TrainResume(run=folder, data=_data_now(self, context, folder), **given))


class PHYSHDR_OT_run_open(_Training):
    """Open the trained run in the backend, for the live preview and for import, without training. Its data
    set need not be there"""

    bl_idname = "physhdr.run_open"
    bl_label = "Open Run"
    action = "open"

    out: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options=FOLDER)
    data: bpy.props.StringProperty(
        name="Data Set",
        subtype="DIR_PATH",
        description="Where the run's data set is now, if it has moved",
        options=FOLDER,
    )
    device: bpy.props.EnumProperty(name="Device", items=settings.DEVICES, options={"SKIP_SAVE"})
    wait: bpy.props.BoolProperty(**WAIT)

    def run(self, context: bpy.types.Context) -> set[str]:
        folder = _run_folder(self, context, absolute(context.scene.physhdr.data))
        data = _data_now(self, context, folder)
        _remember(context, folder)
        return self.begin(RunOpen(run=folder, device=_chosen(self, context, "device"), data=data))


def _data_now(operator: bpy.types.Operator, context: bpy.types.Context, run: str) -> str:
    """Where the data set of a run is now: as given, or the one that is chosen where the run's own has moved.

    Empty where it is where it was, and where the chosen one is another.
    """
    if operator.properties.is_property_set("data"):
        return _folder(operator, context, "data", "data set")
    return moved_data(run, absolute(context.scene.physhdr.data))


class PHYSHDR_OT_train_pause(PhysHDROperator):
    """Halt the training after the present iteration; the preview continues"""

    bl_idname = "physhdr.train_pause"
    bl_label = "Pause"
    action = "pause"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().ask(TrainPause())
        return {"FINISHED"}


class PHYSHDR_OT_train_continue(PhysHDROperator):
    """Go on after the pause"""

    bl_idname = "physhdr.train_continue"
    bl_label = "Continue"
    action = "continue"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().ask(TrainContinue())
        return {"FINISHED"}


class PHYSHDR_OT_train_stop(PhysHDROperator):
    """Save a checkpoint and stop"""

    bl_idname = "physhdr.train_stop"
    bl_label = "Stop"
    action = "stop"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().dispatch(StopAsked())
        return {"FINISHED"}


class PHYSHDR_OT_train_end(PhysHDROperator):
    """Do not wait until it has saved and stopped: end the backend's process at once. What was trained since
    the last checkpoint is lost"""

    bl_idname = "physhdr.train_end"
    bl_label = "End Now"
    action = "end"

    def run(self, context: bpy.types.Context) -> set[str]:
        session().dispatch(EndAsked())
        return {"FINISHED"}


class PHYSHDR_OT_wait(bpy.types.Operator):
    """For scripts: take in what the backend says until something is so. In a window a timer does that"""

    bl_idname = "physhdr.wait"
    bl_label = "Wait for the Backend"
    bl_options = {"INTERNAL"}  # noqa: RUF012 (Blender's name for it)

    until: bpy.props.EnumProperty(
        name="Until",
        items=[
            ("iteration", "Iteration", "The training has done so many iterations"),
            ("paused", "Paused", "The training has halted"),
            ("ended", "Ended", "The training has ended, or there is none"),
            ("connected", "Connected", "There is a connection to a backend"),
            ("gone", "Gone", "There is none"),
            ("tasks", "Tasks", "Nothing is installed, checked or rendered any more"),
            ("seconds", "Seconds", "The time is over"),
        ],
    )
    iteration: bpy.props.IntProperty(name="Iteration", min=1, default=1)
    seconds: bpy.props.FloatProperty(name="Seconds", default=60.0, min=0.0)

    def execute(self, context: bpy.types.Context) -> set[str]:
        conditions: dict[str, Callable[[State], bool]] = {
            "iteration": lambda state: state.job.iteration >= self.iteration,
            "paused": lambda state: state.job.state == "paused",
            "ended": _is_over,
            "connected": lambda state: state.link.status == "connected",
            "gone": lambda state: state.link.status == "off",
            "tasks": lambda state: not state.tasks,
            "seconds": lambda state: False,
        }
        reached = session().wait(conditions[self.until], self.seconds)
        if not reached and self.until != "seconds":
            self.report({"WARNING"}, f"not {self.until} within {self.seconds:g} s")
            return {"CANCELLED"}
        return {"FINISHED"}


class PHYSHDR_OT_result_import(PhysHDROperator):
    """Import the model that the backend holds, as it is now, or the one in the run's folder"""

    bl_idname = "physhdr.result_import"
    bl_label = "Import Result"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender's name for it)
    action = "import"

    out: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options=FOLDER)
    name: bpy.props.StringProperty(
        name="Name", description="Name of the new object; empty: the run's name", options={"SKIP_SAVE"}
    )

    _timer: bpy.types.Timer | None = None
    _began = 0.0

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if is_modal("PHYSHDR_OT_result_import"):  # a second one would import the same file once more
            cls.poll_message_set("The backend writes the model: it is imported once it is there (ESC: not)")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """In a window: ask for the file, and import it when it is there, without holding Blender up."""
        if not self._ask(context):
            return self.execute(context)
        self._began = time.monotonic()
        self._timer = context.window_manager.event_timer_add(0.1, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self.report({"INFO"}, "Nothing is imported; the backend still writes the run's model file")
            return self._finish(context, {"CANCELLED"})
        state = session().state
        if event.type != "TIMER" or not (_is_answered(state) or self._is_late()):
            return {"PASS_THROUGH"}
        if not state.exported:
            self.report({"ERROR"}, _why(state))
            return self._finish(context, {"CANCELLED"})
        return self._finish(context, self._import(context, Path(state.exported.path)))

    def run(self, context: bpy.types.Context) -> set[str]:
        if not self._ask(context):
            return self._import(context, self._file(context))
        current = session()
        current.wait(_is_answered, ANSWER_SECONDS)
        if not current.state.exported:
            self.report({"ERROR"}, _why(current.state))
            return {"CANCELLED"}
        return self._import(context, Path(current.state.exported.path))

    def _file(self, context: bpy.types.Context) -> Path:
        return Path(_run_folder(self, context, absolute(context.scene.physhdr.data))) / MODEL_FILE

    def _ask(self, context: bpy.types.Context) -> bool:
        """Ask the backend to write the model where it holds this run's; False where it does not."""
        state = session().state
        if state.link.status != "connected" or not state.job.has_model:
            return False
        if self.properties.is_property_set("out") and Path(state.job.run) != self._file(context).parent:
            return False
        session().ask(ModelExport(path=str(Path(state.job.run) / MODEL_FILE)))
        return True

    def _import(self, context: bpy.types.Context, path: Path) -> set[str]:
        if not path.exists() and has_run(str(path.parent)):
            self.report({"ERROR"}, f"there is no {path}: open the run in the backend first")
            return {"CANCELLED"}
        try:
            cast(Any, bpy.ops).physhdr.model_import(filepath=str(path), name=self.name or path.parent.name)
        except RuntimeError as error:  # how an operator's error comes to a script
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        chosen = context.scene.physhdr
        if context.scene.is_editable:
            chosen.preview = False  # the object shows itself
            if cube := startup_cube.hide(context.scene):
                self.report(
                    {"INFO"}, f"{cube}, as Blender starts with it, is hidden: it stands in the capture"
                )
        self._look(context)
        return {"FINISHED"}

    def _look(self, context: bpy.types.Context) -> None:
        """Show the model as one of its pictures does: the view may be anywhere."""
        target = context.object
        if not is_model(target):
            return
        try:
            place = first_place(target)
        except PhysHDRError as error:  # the model is there all the same
            self.report({"INFO"}, str(error))
            return
        if place is not None:
            look_from(context, place, target)

    def _is_late(self) -> bool:
        return time.monotonic() - self._began > ANSWER_SECONDS

    def _finish(self, context: bpy.types.Context, result: set[str]) -> set[str]:
        context.window_manager.event_timer_remove(self._timer)
        return result


def _is_answered(state: State) -> bool:
    """Whether the backend has written the model, has said why not, or is gone and will not answer."""
    return bool(state.exported or state.problem) or state.link.status != "connected"


def _why(state: State) -> str:
    """Why there is no model, and the remedy, in words."""
    problem = state.problem or state.link.problem
    if problem is None:
        is_there = state.link.status == "connected"
        return "the backend does not answer" if is_there else "the backend has ended: open the run again"
    return " ".join(filter(None, (problem.message, problem.hint)))


_CLASSES = (
    PHYSHDR_OT_train_start,
    PHYSHDR_OT_train_resume,
    PHYSHDR_OT_train_pause,
    PHYSHDR_OT_train_continue,
    PHYSHDR_OT_train_stop,
    PHYSHDR_OT_train_end,
    PHYSHDR_OT_run_open,
    PHYSHDR_OT_result_import,
    PHYSHDR_OT_wait,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
