# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring Gaussians into the scene: a trained model or another program's, by script, menu or drag and drop."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import bpy
from bpy_extras.io_utils import ImportHelper, poll_file_object_drop

from ...bridge.axes import Up, turn_of_up
from ...bridge.display import ColorSpace
from ...bridge.errors import PhysHDRError
from ...bridge.gaussian_import import is_model_file, read_gaussians
from ...bridge.model_file import PHOTOGRAPHED_EV, SPACE, SUFFIX, WORLD, photographed_ev
from ...bridge.splat_files import SUFFIXES
from ..blender import add_entry, cloud_of, layout_of, remove_entry, takes_objects
from ..capture.placement import capture_of_file, key_of, place
from ..rendering.render_setup import render_problems, set_up_object
from . import parts, pose
from .attributes import CAPTURE, COLOR_SPACE, DISPLAY, FILE, metadata_property
from .nodes import EXPOSURE, set_input
from .point_cloud import build_point_cloud
from .radiance_tree import add_modifier

Orientation = Literal["AUTO", "AS_IS", "Y_UP", "COLMAP"]

#: Which way is up in the file, where the user has said it.
UPS: dict[Orientation, Up] = {"AS_IS": "z", "Y_UP": "y", "COLMAP": "colmap"}
#: Files that are offered. A .sog cannot be read here, but then a message says what to do with it.
OFFERED = (SUFFIX, *SUFFIXES, ".sog")
SET_UP_NEXT = "Before you render: Set Up Render, in the panel Render."


@dataclass(frozen=True)
class Imported:
    """The new object, and sentences for the user about what the file could not tell."""

    target: bpy.types.Object
    notes: tuple[str, ...]


def import_model(
    path: str | Path, name: str = "", collection: bpy.types.Collection | None = None
) -> bpy.types.Object:
    """Read a file of Gaussians and make it an object that relights and renders without a backend.

    ``name``: the file's name if empty; ``collection``: the scene's own if ``None``. Raises what
    ``read_gaussians`` raises, before anything is made.
    """
    return import_file(path, name, collection).target


def import_file(
    path: str | Path,
    name: str = "",
    collection: bpy.types.Collection | None = None,
    color_space: ColorSpace = "SRGB",
    orientation: Orientation = "AUTO",
) -> Imported:
    """As ``import_model``; ``color_space`` and ``orientation`` do not count for model files, which are
    scene-linear and in Blender's axes. ``AUTO``: as the file says, or its format has it by convention."""
    path = Path(path)
    source = read_gaussians(path, color_space)
    name = name or path.stem
    cloud = build_point_cloud(source.model, name, source.colour_sh)
    cloud[FILE] = str(path)
    # What was written where it stood is of no data set any more: its cameras are not where they were.
    is_of_world = source.model.metadata.get(SPACE) == WORLD
    cloud[CAPTURE] = key_of(str(path)) if is_of_world else capture_of_file(path)
    pose.remember(cloud)
    ev = photographed_ev(source.model.metadata)
    if source.colour_sh is not None:
        cloud[COLOR_SPACE] = color_space
        cloud.pop(metadata_property(PHOTOGRAPHED_EV), None)  # display colours have their exposure in them
        ev = 0.0
    target = bpy.data.objects.new(name, cloud)
    try:
        if not is_model_file(path):
            target.rotation_euler.x = _turn(UPS.get(orientation, source.up))
        modifier = add_modifier(target, source.model)
        set_input(modifier, EXPOSURE, ev)
        set_up_object(target)
        parts.note(target)
        (collection or bpy.context.scene.collection).objects.link(target)
    except BaseException:
        bpy.data.batch_remove([target, cloud])
        raise
    return Imported(target, source.notes)


def _turn(up: Up) -> float:
    """The turn about X, in radians, that makes the file's up the scene's Z.

    It is the object's rotation: the Gaussians and their spherical harmonics stay as they are in the file.
    """
    turn = turn_of_up(up, "z")
    return math.atan2(turn[2, 1], turn[1, 1])


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
            told = f"Imported {count} Gaussians as {each.target.name!r}."
            self.report({"INFO"}, " ".join([told, *each.notes, *next_step]))
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


def _draw_import_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    layout_of(menu).operator(
        PHYSHDR_OT_model_import.bl_idname, text=f"PhysHDR model, Gaussians ({'/'.join(OFFERED[:-1])})"
    )


_CLASSES = (PHYSHDR_OT_model_import, PHYSHDR_FH_gaussians)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    add_entry(bpy.types.TOPBAR_MT_file_import, _draw_import_menu)


def unregister() -> None:
    remove_entry(bpy.types.TOPBAR_MT_file_import, _draw_import_menu)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
