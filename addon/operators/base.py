# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators share: a greyed button says why, an error becomes a report."""

import os
from pathlib import Path
from typing import ClassVar

import bpy

from ...bridge.errors import PhysHDRError
from ...bridge.run_folder import CHECKPOINT_FILE, WEB_FILE, WEB_FOLDER, data_of, may_be_of
from .. import outside
from ..capture.dataset_cameras import is_of_data_set
from ..chosen_run import run_of
from ..dataset.dataset_settings import DATASET
from ..light.lighting import is_lit
from ..model.look import is_model, is_of_run
from ..paths import absolute, is_nowhere
from ..rendering.render_setup import render_problems
from ..runtime import session
from ..session.advice import IMPORTED, LIT, SEEN, SET_UP, SHARED, Choices, why_not

#: A model of another file is left alone where what is set of it would not be saved.
OVERRIDE = "Make a library override of it: Object, Library Override."
LINKED = f"The model is linked from another file. {OVERRIDE}"


def choices(context: bpy.types.Context) -> Choices:
    """What is chosen in the scene's settings, as far as it decides what can be done. What the file names and
    nobody has looked at since it was opened is not chosen."""
    settings = context.scene.physhdr
    out = absolute(run_of(settings))
    return Choices(
        data=outside.chosen(settings.data),
        out=out,
        out_has_run=has_run(out),
        online=bpy.app.online_access,
        preview=settings.preview,
        photos=outside.chosen(settings.photos),
        photos_out=outside.chosen(settings.photos_out),
        of_file=True,
        not_looked_at=outside.not_chosen(settings, *settings.photos_lights, getattr(context.scene, DATASET)),
        unsaved=next((each for each in (settings.data, settings.out) if is_nowhere(each)), ""),
    )


def done_in(scene: bpy.types.Scene, run: str) -> frozenset[str]:
    """Which of ``advice.IN_SCENE`` were done in the scene with a model of the run, or of a file.

    It looks at all objects: for the panel's arrow alone, once a redraw, not for every button as ``choices``.
    """
    models = [each for each in scene.objects if is_model(each)]
    if has_run(run):
        models = [each for each in models if is_of_run(each, run)]
    if not models:
        return frozenset()
    done = {IMPORTED}
    if is_of_data_set(scene.camera):
        done.add(SEEN)
    if not render_problems(scene):
        done.add(SET_UP)
    if is_lit(scene.world):
        done.add(LIT)
    # Web pages and videos are made from runs only.
    if not has_run(run) or any(os.path.exists(os.path.join(run, name)) for name in (WEB_FILE, WEB_FOLDER)):
        done.add(SHARED)
    return frozenset(done)


def choose_named(context: bpy.types.Context) -> None:
    """The data set and the run of the scene's settings are chosen: a button about them was pressed."""
    for path in (context.scene.physhdr.data, context.scene.physhdr.out):
        outside.choose(path)


def moved_data(run: str, chosen: str) -> str:
    """The chosen data set, where it can be the run's and the one that the run names is not there; else empty.

    The trainer looks at its cameras, too: pictures of another one may have the same names.
    """
    named = data_of(Path(run))
    if not chosen or named is None or outside.is_folder(named) or not os.path.isdir(chosen):
        return ""
    return chosen if may_be_of(Path(run), Path(chosen)) else ""


def has_run(folder: str) -> bool:
    """Whether a training left a checkpoint in ``folder``."""
    # os.path says False of a name that cannot be, pathlib raises.
    return bool(folder) and os.path.isfile(os.path.join(folder, CHECKPOINT_FILE))


class PhysHDROperator(bpy.types.Operator):
    """An operator that is greyed, with the reason, while ``action`` is impossible (session.advice).

    ``run`` does it; a ``PhysHDRError`` of it is reported and cancels. What the user has not chosen yet does
    not grey it: a script may give it as an argument. The panel greys its button then.
    """

    bl_options: ClassVar[set[str]] = {"REGISTER"}
    action: ClassVar[str]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        choices = Choices(
            data="given",
            out="given",
            out_has_run=True,
            online=bpy.app.online_access,
            photos="given",
            photos_out="given",
        )
        reason = why_not(session().state, cls.action, choices)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            return self.run(context)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def run(self, context: bpy.types.Context) -> set[str]:
        raise NotImplementedError


class OnModel(bpy.types.Operator):
    """What is done to the active model, which ``poll`` sees to; it can be undone."""

    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        target = context.object
        assert is_model(target)
        try:
            text = self.act(context, target)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, text)
        return {"FINISHED"}

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        """Do it; what was done, in a sentence. Raises ``PhysHDRError`` with nothing changed."""
        raise NotImplementedError


def wait_for_task(operator: bpy.types.Operator, task: str, seconds: float) -> bool:
    """For scripts: until a task has ended, or an interrupt, which cancels it.

    False where it still runs after ``seconds``, which is reported as an error.
    """
    current = session()
    try:
        has_ended = current.wait(lambda state: state.task(task) is None, seconds)
    except KeyboardInterrupt:
        current.cancel_task(task)
        raise
    if not has_ended and (running := current.state.task(task)):
        text = f"{task} has not ended within {seconds:.0f} s: see its log {running.log}"
        operator.report({"ERROR"}, text)
    return has_ended


def report_task(operator: bpy.types.Operator, success: str) -> set[str]:
    """Report how a task ended that a script waited for."""
    state = session().state
    problem = state.problem or state.backend.problem
    if problem is None:
        operator.report({"INFO"}, success)
        return {"FINISHED"}
    operator.report({"ERROR"}, " ".join(filter(None, (problem.message, problem.hint))))
    return {"CANCELLED"}


def follow_task(operator: bpy.types.Operator, task: str, seconds: float, success: str) -> set[str]:
    """For scripts: wait for a task, and report how it ended."""
    return report_task(operator, success) if wait_for_task(operator, task, seconds) else {"CANCELLED"}
