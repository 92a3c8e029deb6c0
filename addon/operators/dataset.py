# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for data sets: render one from the open scene, look at one.

The rendering is another Blender's (synth/make_scene.py on a copy of the file as it is now, unsaved changes
included), so this one is neither blocked nor changed, and what fails there fails alone.
"""

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import bpy
from bpy.app.handlers import persistent

from ...bridge.errors import OutputError, PhysHDRError
from ...synth import scripts
from .. import outside
from ..blender import layout_of
from ..capture import originals, placement
from ..dataset import (
    dataset_command,
    dataset_dialog,
    dataset_folder,
    dataset_presets,
    dataset_settings,
    disk_caches,
    render_time,
    rig_preview,
    time_trial,
    unsaved,
)
from ..dataset.dataset_settings import OPTIONS, RenderOptions, settings_of
from ..dataset.render_time import Started
from ..layouts.summary import summarise
from ..model.look import is_model
from ..paths import ROOT
from ..runtime import redraw, session
from ..session.dataset_words import in_the_dialogs_words
from ..session.state import DATASET
from ..session.task import TaskEnded
from ..settings import RELATIVE
from .afterwards import push_undo, scene_of, take_when_ended
from .base import PhysHDROperator, wait_for_task

SCRIPT = ROOT / "synth" / "make_scene.py"
#: Seconds that scripts wait for a data set.
RENDER_SECONDS = 30 * 24 * 3600.0
#: Seconds until a dialog whose settings cannot be opens again, below the error.
AGAIN_SECONDS = 0.1


class PHYSHDR_OT_dataset_render(RenderOptions, PhysHDROperator):
    """Render an HDR data set of this scene from a rig of cameras around its camera. None of its objects is
    changed, and what was rendered before with the same settings into the same folder is kept"""

    bl_idname = "physhdr.dataset_render"
    bl_label = "Render Data Set"
    action = "render"

    lights: bpy.props.StringProperty(
        name="Lights That Vary",
        options={"SKIP_SAVE"},
        description="Names with ; between, as the dialog lists them: 'ambient; key_light', or with what they "
        "are: 'ambient; key=collection:Key Things'. Empty: those that are ticked in the dialog",
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})
    #: Whether a dialog asked for it, which is opened again where something is wrong.
    in_dialog = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.camera is None:
            cls.poll_message_set("Add a camera to the scene first: the views are taken around it")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        settings = settings_of(context.scene)
        for name in OPTIONS:  # what a script or a button gives is shown, and can be changed
            if self.properties.is_property_set(name):
                setattr(settings, name, getattr(self, name))
                self.properties.property_unset(name)
        dataset_folder.propose(settings)
        dataset_settings.look_for_lights(context.scene, context.view_layer)
        dataset_settings.without_denoiser(context.scene)
        dataset_presets.make_folder()
        rig_preview.dialog_opened(context)
        self.in_dialog = True
        return context.window_manager.invoke_props_dialog(
            self, width=dataset_dialog.WIDTH, confirm_text="Render"
        )

    def draw(self, context: bpy.types.Context) -> None:
        dataset_dialog.draw(context, layout_of(self))

    def cancel(self, context: bpy.types.Context) -> None:
        rig_preview.dialog_closed()

    def execute(self, context: bpy.types.Context) -> set[str]:
        done = super().execute(context)
        if self.in_dialog and "CANCELLED" in done:
            bpy.app.timers.register(_open_again, first_interval=AGAIN_SECONDS)
        return done

    def run(self, context: bpy.types.Context) -> set[str]:
        rig_preview.dialog_closed()
        session().pump()  # a task before this one may have ended since the last time
        scene = context.scene
        if not self.properties.is_property_set("out"):
            dataset_folder.propose(settings_of(scene))
        time_trial.trial().end()  # it reads the copy that is replaced now
        chosen = dataset_settings.chosen(scene, self, self.lights)
        for path in (chosen.out, chosen.response_file):
            outside.choose(path)
        arguments = dataset_command.of(chosen, scene)
        unsaved.require_saved()
        out = dataset_folder.chosen_folder(chosen.out)
        current = session()
        with originals.shown(scene):
            with _copy_of_file() as copy:
                command = [*_blender(copy, bpy.app.binary_path), *arguments]
                current.start_task(DATASET, command, current.home / "dataset.log")
            items = originals.photographed(scene, context.view_layer)
        # Of a folder that holds a data set this rendering may be refused: then that one's stay known.
        if not originals.is_remembered(scene, out):
            originals.remember(scene, items, out)
        started = render_time.begun(chosen, scene, out, items)
        if not self.wait:
            _choose_when_done(scene.session_uid, started)
            push_undo(self.bl_label)
            return {"FINISHED"}
        try:
            if not wait_for_task(self, DATASET, RENDER_SECONDS):
                return {"CANCELLED"}
        finally:
            _remove_copies()
        if not _take(scene, started):
            self.report({"ERROR"}, _why_not_taken(current.ended(DATASET)))
            return {"CANCELLED"}
        for line in _left_out(scene):
            self.report({"INFO"}, line)
        self.report({"INFO"}, summarise(out).lines[0])
        return {"FINISHED"}


def _open_again() -> None:
    """The dialog as it was left. Blender closes it at its button, whatever comes of it."""
    operators: Any = getattr(bpy.ops, "physhdr", None)
    if hasattr(operators, "dataset_render") and operators.dataset_render.poll():
        operators.dataset_render("INVOKE_DEFAULT")


def _blender(copy: Path, binary: str) -> list[str]:
    """The command, up to make_scene.py's own arguments; ``binary``: Blender, empty where there is none.

    The file's Python runs there where it may run here: in the preferences nobody has said so for the copy.
    """
    if not binary:  # the wheel
        allowed = ["--allow-scripts"] if scripts.may_run() else []
        return [sys.executable, str(SCRIPT), "--", "--from-file", str(copy), *allowed]
    return [binary, "-b", scripts.switch(), str(copy), "-P", str(SCRIPT), "--", "--from-file", "current"]


def _left_out(scene: bpy.types.Scene) -> list[str]:
    """A note about models that were not photographed."""
    names = [item.name for item in scene.objects if is_model(item) and not item.hide_render]
    return [f"Left out of what is photographed, trained models: {', '.join(names)}"] if names else []


def _take(scene: bpy.types.Scene, started: Started) -> bool:
    """Choose the data set for training, and remember its time and originals, if it is this one that was
    completed.

    That the folder holds a data set says nothing: it may be an older one, of which the new one was refused.
    """
    ended = session().ended(DATASET)
    if ended is None or not ended.ok or ended.result.get("folder") != str(started.out):
        return False
    placement.settings_of(scene).data = str(started.out)
    originals.remember(
        scene, (item for item in scene.objects if item.session_uid in started.originals), started.out
    )
    render_time.ended(started, scene, session().home)
    return True


def _why_not_taken(ended: TaskEnded | None) -> str:
    if ended is None or ended.cancelled:
        return "the rendering was cancelled"
    return in_the_dialogs_words(": ".join(filter(None, (ended.message, ended.hint))))


def _choose_when_done(uid: int, started: Started) -> None:
    """Choose the data set for training once it is complete, unless another file has been opened by then."""

    def take() -> bool:
        scene = scene_of(uid)
        return scene is not None and _take(scene, started)

    take_when_ended(DATASET, take, PHYSHDR_OT_dataset_render.bl_label)


def _copies() -> Path:
    """Blender's own folder for this session's temporary files, which it removes itself when it ends."""
    return Path(bpy.app.tempdir) / "physhdr_dataset"


def _remove_copies() -> None:
    shutil.rmtree(_copies(), ignore_errors=True)


@contextmanager
def _copy_of_file() -> Iterator[Path]:
    """The file as it is in memory, saved elsewhere; the open one stays as it is, saved or not.

    The copy outlives the context unless it failed: the other Blender may still be reading it. There is one
    data set at a time, so the next one removes it. Paths in it are made to fit its place.
    """
    _remove_copies()
    copy = _copies() / f"{Path(bpy.data.filepath).stem or 'untitled'}.blend"
    paths = bpy.context.preferences.filepaths
    preview = paths.file_preview_type
    try:
        copy.parent.mkdir(parents=True, exist_ok=True)
        paths.file_preview_type = "NONE"  # a preview is a picture of the window: slow, and of no use here
        bpy.ops.wm.save_as_mainfile(
            filepath=str(copy), copy=True, compress=False, check_existing=False, relative_remap=True
        )
        disk_caches.bring(copy)
        yield copy
    except (OSError, RuntimeError) as error:
        _remove_copies()
        raise OutputError(
            f"no copy of this file can be saved in {copy.parent}: {error}", "Is the disk full?"
        ) from error
    except PhysHDRError:
        _remove_copies()
        raise
    finally:
        paths.file_preview_type = preview


class PHYSHDR_OT_dataset_time(PhysHDROperator):
    """Render two pictures of this scene with few samples, in the background, to tell about how long its data
    set will take"""

    bl_idname = "physhdr.dataset_time"
    bl_label = "Try"
    action = "render"

    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.camera is None or time_trial.trial().is_running:
            cls.poll_message_set("It is being tried" if context.scene.camera else "Add a camera first")
            return False
        return super().poll(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        scene, trial, home = context.scene, time_trial.trial(), session().home
        chosen = dataset_settings.chosen(scene)
        with originals.shown(scene), _copy_of_file() as copy:
            trial.start(_blender(copy, bpy.app.binary_path), chosen, scene, copy.parent / "tried", home)
        if not self.wait:
            bpy.app.timers.register(_look_at_trial, first_interval=time_trial.LOOK_SECONDS)
            return {"FINISHED"}
        try:
            trial.wait(RENDER_SECONDS)
        finally:
            trial.end()
            _remove_copies()
        self.report({"INFO"}, dataset_dialog.time_in_words(chosen, scene))
        return {"FINISHED"}


def _look_at_trial() -> float | None:
    trial = time_trial.trial()
    going_on = trial.look()
    redraw()
    return time_trial.LOOK_SECONDS if going_on else None


@persistent
def _file_opened(*_: object) -> None:
    """The trial was of the former file's scene, and Blender has removed the timer that looks at it."""
    time_trial.trial().forget()


class PHYSHDR_OT_dataset_check(bpy.types.Operator):
    """Look whether a folder is a data set, and tell what it holds and what is wrong with it"""

    bl_idname = "physhdr.dataset_check"
    bl_label = "Check Data Set"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    folder: bpy.props.StringProperty(name="Data Set", subtype="DIR_PATH", options=RELATIVE)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            summary = summarise(dataset_folder.chosen_folder(outside.choose(self.folder)))
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for line in summary.lines:
            self.report({"INFO"}, line)
        for warning in summary.warnings:
            self.report({"WARNING"}, warning)
        return {"FINISHED"}


_CLASSES = (PHYSHDR_OT_dataset_render, PHYSHDR_OT_dataset_time, PHYSHDR_OT_dataset_check)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.app.handlers.load_post.append(_file_opened)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_file_opened)
    time_trial.trial().forget()
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
