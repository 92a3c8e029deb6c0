# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of Gaussians into the scene, by script, menu or drag and drop, and edited models into files."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper, poll_file_object_drop

from ...bridge.errors import PhysHDRError
from ...bridge.gaussian_import import is_model_file
from ...bridge.model_file import SUFFIX, write_model
from ...bridge.ply_model import warning_of
from ...bridge.splat_files import SUFFIXES
from .. import outside
from ..blender import cloud_of, layout_of, takes_objects
from ..capture.placement import place
from ..model.attributes import DISPLAY, FILE
from ..model.edited_model import edited_model
from ..model.look import cleaning_of, is_model
from ..model.model_import import Imported, import_file
from ..paths import whole
from ..rendering.render_setup import render_problems

#: Files that are offered. A .sog cannot be read here, but then a message says what to do with it.
OFFERED = (SUFFIX, *SUFFIXES, ".sog")
#: Letters of a line in the import dialog.
LINE = 44
SET_UP_NEXT = "Before you render: Set Up Render, in the panel Render."


class PHYSHDR_OT_model_import(bpy.types.Operator, ImportHelper):
    """Import trained PhysHDR models or other programs' Gaussians as point clouds to relight and render"""

    bl_idname = "physhdr.model_import"
    bl_label = "Import Gaussians"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    if TYPE_CHECKING:
        filepath: str  # ImportHelper's

    filename_ext = SUFFIX
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in OFFERED), options={"HIDDEN"}
    )
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: bpy.props.CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    name: bpy.props.StringProperty(
        name="Name",
        description="Name of the new object; empty: the file's name. Several files have their own",
        options={"SKIP_SAVE"},
    )
    color_space: bpy.props.EnumProperty(
        name="Colours",
        description="What the colours of other programs' files are. PhysHDR's own are always scene-linear",
        items=[
            ("SRGB", "sRGB", "Display-referred, as nearly every 3DGS trainer writes; they are linearised"),
            ("LINEAR", "Linear", "Scene-linear radiance"),
        ],
    )
    orientation: bpy.props.EnumProperty(
        name="Orientation",
        description="Which way is up in the file; the object is turned. Model files are in Blender's axes",
        items=[
            ("AUTO", "By the file", "As the file says, or else as files of its format are by convention"),
            ("AS_IS", "Z up", "As it is, as PhysHDR's own and nerfstudio's"),
            ("Y_UP", "Y up", "Y up, Z backward, as most web and game tools"),
            ("COLMAP", "COLMAP", "Y down, Z forward, as 3DGS writes what was trained from COLMAP's cameras"),
        ],
    )
    viewport: bpy.props.EnumProperty(
        name="Viewport",
        description="How the 3D view draws the Gaussians. Renders are not affected",
        items=[
            ("SPLATS", "Splats", "By a shader, as the trainer draws them: fast"),
            ("NODES", "Geometry nodes", "The instances that Cycles and EEVEE render: slow for many"),
        ],
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        # Dropped files come with their paths; another program's axes and colours are worth a question.
        dropped = self.properties.is_property_set("filepath")
        if dropped and all(is_model_file(path) for path in self._paths()):
            return self.execute(context)
        return self.invoke_popup(context)

    def draw(self, context: bpy.types.Context) -> None:
        column = layout_of(self).column()
        column.use_property_split = True
        for name in ("name", "orientation", "color_space", "viewport"):
            column.prop(self, name)
        paths = [path for path in self._paths() if path.is_file() and not is_model_file(path)]
        if self.color_space == "SRGB":
            for line in textwrap.wrap(warning_of(paths[0]) if paths else "", LINE):
                column.label(text=line)

    def execute(self, context: bpy.types.Context) -> set[str]:
        paths = self._paths()
        imported: list[Imported] = []
        failures: list[PhysHDRError] = []
        window_manager = context.window_manager
        window_manager.progress_begin(0, len(paths))
        try:
            for index, path in enumerate(paths):
                window_manager.progress_update(index)
                try:
                    imported.append(self._import(context, path, self.name if len(paths) == 1 else ""))
                except PhysHDRError as error:
                    failures.append(error)
        finally:
            window_manager.progress_end()
        for error in failures:
            # From a script an error raises, as if nothing had been imported.
            self.report({"WARNING" if imported else "ERROR"}, str(error))
        if not imported:
            return {"CANCELLED"}
        _select(context, [each.target for each in imported])
        next_step = [SET_UP_NEXT] if render_problems(context.scene) else []
        for each in imported:
            count = len(cloud_of(each.target).points)
            text = f"Imported {count} Gaussians as {each.target.name!r}."
            self.report({"INFO"}, " ".join([text, *each.notes, *next_step]))
        return {"FINISHED"}

    def _paths(self) -> list[Path]:
        names = [each.name for each in self.files if each.name]
        if self.directory and names:
            folder = Path(bpy.path.abspath(self.directory))
            return [folder / name for name in names]
        return [Path(bpy.path.abspath(self.filepath))]

    def _import(self, context: bpy.types.Context, path: Path, name: str) -> Imported:
        collection = context.collection if takes_objects(context.collection) else None
        done = import_file(path, name, collection, self.color_space, self.orientation)
        place(context.scene, done.target)
        if hasattr(done.target, DISPLAY):  # absent where the 3D view's drawing is not registered
            setattr(done.target, DISPLAY, self.viewport)
        return done


def _select(context: bpy.types.Context, targets: list[bpy.types.Object]) -> None:
    """Make ``targets`` the selection and the last one active, as far as this view layer shows them."""
    for selected in context.selected_objects or ():
        selected.select_set(False)
    for target in targets:
        if target.name in context.view_layer.objects:  # not where its collection is excluded
            target.select_set(True)
            context.view_layer.objects.active = target


class PHYSHDR_FH_gaussians(bpy.types.FileHandler):
    """Gaussians dropped into the 3D view or the outliner. Blender asks which importer reads a .ply."""

    bl_idname = "PHYSHDR_FH_gaussians"
    bl_label = "PhysHDR Gaussians"
    bl_import_operator = PHYSHDR_OT_model_import.bl_idname
    bl_file_extensions = ";".join(OFFERED)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return poll_file_object_drop(context)


class PHYSHDR_OT_model_save(bpy.types.Operator, ExportHelper):
    """Save the active model as it is now, in PhysHDR's own format: HDR radiance, lights, response and all.
    Baking to a PLY loses those"""

    bl_idname = "physhdr.model_save"
    bl_label = "Save Edited Model"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = SUFFIX
    # ExportHelper's own is remembered: the next model would be offered the file of the last one.
    filepath: bpy.props.StringProperty(name="File Path", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})
    leave_out: bpy.props.BoolProperty(
        name="Leave Out What Is Hidden",
        description="Without the Gaussians that the limits in Clean hide. Off: all, hidden or not",
        default=True,
    )
    apply_transform: bpy.props.BoolProperty(
        name="Apply Transform",
        description="Write world space: location, rotation and scale of the object become the model's. "
        "Off: where the data set has it, so that its cameras still fit",
        default=False,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not is_model(context.object):
            cls.poll_message_set("Select an imported model first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        target = context.object
        assert is_model(target)
        if not self.filepath:
            source = Path(bpy.path.abspath(str(cloud_of(target).get(FILE, ""))) or target.name)
            edited = source.with_name(f"{source.stem}_edited{SUFFIX}")
            self.filepath = str(edited) if outside.may_follow(edited) else edited.name
        return set(super().invoke(context, event))

    def execute(self, context: bpy.types.Context) -> set[str]:
        target = context.object
        assert is_model(target)
        try:
            path = Path(whole(self.filepath))
            cleaning = cleaning_of(target, context.evaluated_depsgraph_get())
            model = edited_model(target, cleaning, self.leave_out, self.apply_transform)
            write_model(path, model)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        hidden = len(cloud_of(target).points) - model.count
        left_out = f", {hidden} that are hidden left out" if hidden else ""
        self.report({"INFO"}, f"Wrote {model.count} Gaussians to {path}{left_out}")
        return {"FINISHED"}


_CLASSES = (PHYSHDR_OT_model_import, PHYSHDR_FH_gaussians, PHYSHDR_OT_model_save)


register, unregister = bpy.utils.register_classes_factory(_CLASSES)
