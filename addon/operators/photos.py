# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for photos: look at a folder of them, make a data set of it.

Both are the backend's work (``physhdr prepare``), in a process of its own. What is chosen stands in the
scene's settings, so that an error loses nothing that was typed.
"""

import os
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import bpy

from ...bridge.data_set import CAPTURE_FILE
from ...bridge.errors import BadValueError, FileMissingError, OutputError
from ...bridge.light_words import OFF, ON, UNKNOWN, LightChange, changes_in_name
from .. import outside
from ..chosen_run import is_run_of, proposed_run
from ..paths import absolute, first_free, whole
from ..runtime import session
from ..session.photos import PhotoOptions, prepare_command, prepared
from ..session.state import LOOK, PHOTOS, PhotosChosen, Prepared
from ..settings import LENSES, SETTINGS, PHYSHDR_Settings, photo_options
from .afterwards import scene_of, take_when_ended
from .base import PhysHDROperator, has_run, report_task, wait_for_task

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

#: Seconds that scripts wait for a look, and for a data set.
LOOK_SECONDS, PREPARE_SECONDS = 24 * 3600.0, 30 * 24 * 3600.0
#: Arguments that count where they are given, else the scene's settings.
OPTIONS = [each.name for each in fields(PhotoOptions)]
GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
FOLDER: "set[PropertyFlagItems]" = {"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}


class PHYSHDR_OT_photos_look(PhysHDROperator):
    """Choose the folder of your photos. It is looked at first: places, exposures, and what is odd are shown
    before the long work begins"""

    bl_idname = "physhdr.photos_look"
    bl_label = "Prepare Photos"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}
    action = "look"

    directory: bpy.props.StringProperty(name="Photos", subtype="DIR_PATH", options=FOLDER)
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_image: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.properties.is_property_set("directory"):
            self.directory = outside.chosen(context.scene.physhdr.photos)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> set[str]:
        settings, current = context.scene.physhdr, session()
        current.pump()
        photos = _folder(self.directory, "the photos")
        if not photos.is_dir():
            raise FileMissingError(f"there is no folder {photos}", "Choose the folder that holds the photos.")
        if settings.photos and Path(absolute(settings.photos)) != photos:
            forget(settings)
        if not settings.photos_out:
            settings.photos_out = proposed_folder(photos)
        settings.photos = str(photos)
        current.look_at_photos(str(photos), photo_options(settings).to_look)
        if not self.wait:
            return {"FINISHED"}
        current.wait(lambda state: state.task(LOOK) is None, LOOK_SECONDS)
        found = current.state.photos
        if found.problem or not found.lines:
            text = (found.problem.message, found.problem.hint) if found.problem else ("it was cancelled",)
            self.report({"ERROR"}, ": ".join(filter(None, text)))
            return {"CANCELLED"}
        for line in found.lines:
            self.report({"INFO"}, line)
        for warning in found.warnings:
            self.report({"WARNING"}, warning)
        return {"FINISHED"}


class PHYSHDR_OT_photos_prepare(PhysHDROperator):
    """Make a data set of the photos: find where each was taken, take the lens's distortion out, write the
    pictures with their exposures. Nothing in the photos' folder is changed"""

    bl_idname = "physhdr.photos_prepare"
    bl_label = "Prepare"
    action = "photos"

    photos: bpy.props.StringProperty(name="Photos", subtype="DIR_PATH", options=FOLDER)
    out: bpy.props.StringProperty(name="Data Set", subtype="DIR_PATH", options=FOLDER)
    handheld: bpy.props.BoolProperty(name="Hand-Held", options=GIVEN)
    bracket: bpy.props.IntProperty(name="Photos a Place", min=0, options=GIVEN)
    same_exposure: bpy.props.BoolProperty(name="Same Exposure", options=GIVEN)
    exposures: bpy.props.StringProperty(name="Exposures", subtype="FILE_PATH", options=FOLDER)
    borrow_poses: bpy.props.BoolProperty(name="Borrow Places", options=GIVEN)
    max_width: bpy.props.IntProperty(name="Width at Most", min=0, subtype="PIXEL", options=GIVEN)
    lens: bpy.props.EnumProperty(name="Lens", items=LENSES, options={"SKIP_SAVE"})
    partial: bpy.props.BoolProperty(name="Use What Was Found", options=GIVEN)
    lights: bpy.props.StringProperty(
        name="Other Light", description="One a line: pendant=FOLDER:off", options=GIVEN
    )
    named_lights: bpy.props.BoolProperty(name="Folders Named by Light", default=True, options=GIVEN)
    overwrite: bpy.props.BoolProperty(
        name="Replace", description="Replace the data set that was made of photos before", options=GIVEN
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        out = absolute(self._chosen(context, "out", "photos_out"))
        if os.path.isfile(os.path.join(out, CAPTURE_FILE)) and not self.overwrite:
            self.overwrite = True
            return context.window_manager.invoke_confirm(
                self,
                event,
                title="Replace the data set in this folder?",
                message=f"{out} holds a data set that was made of photos.",
                confirm_text="Replace",
                icon="WARNING",
            )
        return self.execute(context)

    def run(self, context: bpy.types.Context) -> set[str]:
        current = session()
        current.pump()
        photos = _folder(self._chosen(context, "photos", "photos"), "the photos")
        if not photos.is_dir():
            raise FileMissingError(f"there is no folder {photos}", "Choose the folder that holds the photos.")
        out = _folder(self._chosen(context, "out", "photos_out") or proposed_folder(photos), "the data set")
        if out == photos:
            raise OutputError(f"{out} holds the photos", "Choose another folder for the data set.")
        overrides = {name: getattr(self, name) for name in OPTIONS if self.properties.is_property_set(name)}
        self._chosen(context, "exposures", "photos_exposures")
        for each in context.scene.physhdr.photos_lights:
            outside.choose(each.folder)
        options = photo_options(context.scene.physhdr, **overrides)
        arguments = prepare_command(str(photos), str(out), options.to_prepare, self.overwrite)
        command = current.backend_command(*arguments)
        current.start_task(PHOTOS, command, current.home / "photos.log", current.environment())
        if not self.wait:
            _choose_when_done(context.scene.session_uid)
            return {"FINISHED"}
        if not wait_for_task(self, PHOTOS, PREPARE_SECONDS):
            return {"CANCELLED"}
        made = _made()
        if current.state.problem is None and not made.folder:
            self.report({"ERROR"}, "the preparation was cancelled")
            return {"CANCELLED"}
        for warning in made.warnings:
            self.report({"WARNING"}, warning)
        if current.state.problem is None:
            choose(context.scene.physhdr, made.folder)
        return report_task(self, ": ".join(filter(None, (made.folder, made.found))))

    def _chosen(self, context: bpy.types.Context, argument: str, setting: str):
        """An argument of the operator, or the scene's setting where it was not given."""
        if self.properties.is_property_set(argument):
            return getattr(self, argument)
        return outside.choose(getattr(context.scene.physhdr, setting))


class PHYSHDR_OT_photos_light_add(bpy.types.Operator):
    """Choose a folder of photos of the same place under other light: with a lamp off, in the evening. That
    light can then be turned afterwards"""

    bl_idname = "physhdr.photos_light_add"
    bl_label = "Add Other Light"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(name="Photos", subtype="DIR_PATH", options=FOLDER)
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_image: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.directory = outside.chosen(context.scene.physhdr.photos)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = Path(whole(self.directory))
        lights = context.scene.physhdr.photos_lights
        for change in changes_in_name(folder.name) or (LightChange(folder.name, OFF),):
            light = lights.add()
            light.folder, light.light = str(folder), change.light
            if change.level is None:
                light.word = UNKNOWN
            elif change.word in (OFF, ON):
                light.word = change.word
            else:
                light.word, light.factor = "factor", change.level
        return {"FINISHED"}


class PHYSHDR_OT_photos_light_remove(bpy.types.Operator):
    """Leave out this folder of photos under other light; nothing on disk is changed"""

    bl_idname = "physhdr.photos_light_remove"
    bl_label = "Leave Out Other Light"
    bl_options: ClassVar[set[str]] = {"REGISTER", "INTERNAL", "UNDO"}

    number: bpy.props.IntProperty(min=0, options={"SKIP_SAVE"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.physhdr.photos_lights.remove(self.number)
        return {"FINISHED"}


class PHYSHDR_OT_photos_forget(bpy.types.Operator):
    """Leave these photos; nothing on disk is changed"""

    bl_idname = "physhdr.photos_forget"
    bl_label = "Leave These Photos"
    bl_options: ClassVar[set[str]] = {"REGISTER", "INTERNAL", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        session().cancel_task(LOOK)
        forget(context.scene.physhdr)
        return {"FINISHED"}


def forget(settings: PHYSHDR_Settings) -> None:
    """No folder of photos is chosen any more."""
    settings.photos = settings.photos_out = ""
    settings.photos_lights.clear()
    session().dispatch(PhotosChosen(""))


def choose(settings: PHYSHDR_Settings, folder: str) -> None:
    """Choose a data set that was made, and a folder for its run where none is chosen or one is taken."""
    forget(settings)
    settings.data = folder
    out = absolute(settings.out)
    if not out or (has_run(out) and not is_run_of(Path(out), os.path.normpath(folder))):
        settings.out = proposed_run(os.path.normpath(folder))


def proposed_folder(photos: Path) -> str:
    """Where the data set may go, so that nothing must be typed.

    Beside the .blend; before that is saved, beside the photos, or where one may not write there (a card that
    is locked) in the user's own folder. Never one that holds something.
    """
    name = f"{photos.name or 'photos'}_dataset"
    if bpy.data.filepath:
        return f"//{first_free(Path(bpy.path.abspath('//')) / name).name}"
    beside = photos.parent
    is_beside = beside != photos and os.access(beside, os.W_OK)  # a whole card (D:\) has nothing beside it
    return str(first_free((beside if is_beside else Path.home()) / name))


def _made() -> Prepared:
    """What came of the photos that were prepared last; nothing where that failed or was cancelled.

    The state's is of whatever was made last: a data set may be rendered at the same time.
    """
    ended = session().ended(PHOTOS)
    return prepared(ended.result) if ended is not None and ended.ok else Prepared()


def _choose_when_done(uid: int) -> None:
    """Choose the data set for training once it is there, unless another file has been opened by then."""

    def take() -> bool:
        scene, made = scene_of(uid), _made()
        if scene is None or not made.folder:
            return False
        choose(getattr(scene, SETTINGS), made.folder)
        return True

    take_when_ended(PHOTOS, take, "Prepare Photos")


def _folder(overrides: str, what: str) -> Path:
    if not overrides.strip():
        raise BadValueError(f"no folder is chosen for {what}", "Choose one, or give it as an argument.")
    return Path(whole(overrides))


_CLASSES = (
    PHYSHDR_OT_photos_look,
    PHYSHDR_OT_photos_prepare,
    PHYSHDR_OT_photos_light_add,
    PHYSHDR_OT_photos_light_remove,
    PHYSHDR_OT_photos_forget,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
