# SPDX-License-Identifier: GPL-3.0-or-later
"""Menus: *Object ▸ PhysHDR*, *Add ▸ PhysHDR Capture*, and what *File* imports and exports.

Blender's search (F3), quick favourites and shortcuts find what is in menus, by the text that stands there:
everything that can be done is here, and begins with its verb.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import bpy

from ..blender import add_entry, layout_of, remove_entry
from ..model import native
from ..operators.model_files import OFFERED

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems


@dataclass(frozen=True)
class Entry:
    """An operator, without ``physhdr.``; ``text``: its label if empty."""

    operator: str
    text: str = ""
    icon: "IconItems" = "NONE"
    arguments: Mapping[str, object] = field(default_factory=dict)
    #: The enumeration of the operator that makes a menu of its own.
    menu_of: str = ""


#: ``None``: a line between entries.
Rows = tuple[Entry | type[bpy.types.Menu] | None, ...]


def draw_rows(layout: bpy.types.UILayout, rows: Rows) -> None:
    for row in rows:
        if row is None:
            layout.separator()
        elif not isinstance(row, Entry):
            layout.menu(row.__name__)
        elif row.menu_of:
            layout.operator_menu_enum(f"physhdr.{row.operator}", row.menu_of, text=row.text, icon=row.icon)
        else:
            name = f"physhdr.{row.operator}"
            if row.text:
                properties = layout.operator(name, text=row.text, icon=row.icon)
            else:
                properties = layout.operator(name, icon=row.icon)
            for argument, value in row.arguments.items():
                setattr(properties, argument, value)


class _Menu:
    rows: ClassVar[Rows]
    if TYPE_CHECKING:
        layout: bpy.types.UILayout | None

    def draw(self, context: bpy.types.Context) -> None:
        draw_rows(layout_of(self), self.rows)


class PHYSHDR_MT_capture(_Menu, bpy.types.Menu):
    bl_label = "Capture"
    rows = (
        Entry("photos_look", "Prepare Photos…", "IMAGE_DATA"),
        Entry("photos_light_add", "Add Photos under Other Light…"),
        Entry("photos_prepare", "Prepare Data Set of Photos"),
        None,
        Entry("dataset_render", "Render Data Set from This Scene…", "RENDER_STILL"),
        Entry("dataset_time", "Try Rendering the Data Set"),
        Entry("rig_show", "Show Cameras of the Data Set"),
        Entry("originals_hide", "Hide Originals", "HIDE_ON", {"action": "HIDE"}),
        Entry("originals_hide", "Show Originals", "HIDE_OFF", {"action": "SHOW"}),
        None,
        Entry("outside_look", "Look at Folders That This File Names"),
    )


class PHYSHDR_MT_training(_Menu, bpy.types.Menu):
    bl_label = "Training"
    rows = (
        Entry("train_start", "Start Training", "PLAY"),
        Entry("train_resume", "Resume Training"),
        Entry("train_pause", "Pause Training", "PAUSE"),
        Entry("train_continue", "Continue Training"),
        Entry("train_stop", "Stop Training", "SNAP_FACE"),
        Entry("train_end", "End Training Now"),
        None,
        Entry("run_open", "Open Run"),
        Entry("control_take", "Take Control of the Training"),
        Entry("results_evaluate", "Evaluate Result", "VIEWZOOM"),
    )


class PHYSHDR_MT_trainer(_Menu, bpy.types.Menu):
    bl_label = "Trainer"
    rows = (
        Entry("backend_install", icon="IMPORT"),
        Entry("backend_use", "Use Existing Python…", "FILEBROWSER"),
        Entry("backend_check", "Check Trainer", "CHECKMARK"),
        Entry("backend_extend", "Add What the Trainer Lacks"),
        Entry("backend_shutdown", "Shut Down Trainer", "QUIT"),
    )


class PHYSHDR_MT_cleaning(_Menu, bpy.types.Menu):
    bl_label = "Clean and Crop"
    rows = (
        Entry("cleaning_box", icon="CUBE"),
        Entry("cleaning_measure", "Measure Distances from Photos", "DRIVER_DISTANCE"),
        Entry("cleaning_floaters", icon="VIEWZOOM"),
        Entry("cleaning_select", "Select Gaussians by", "RESTRICT_SELECT_OFF", menu_of="by"),
        Entry("cleaning_apply", icon="TRASH"),
    )


class PHYSHDR_MT_scale(_Menu, bpy.types.Menu):
    bl_label = "Scale and Ground"
    rows = (
        Entry("capture_scale", "Set Scale by Two Points…", "DRIVER_DISTANCE"),
        Entry("capture_floor", "Set Floor by Three Points…", "ORIENTATION_NORMAL"),
        Entry("capture_height", "Set Height of the Cameras…", "VIEW_CAMERA"),
        Entry("capture_reset", icon="LOOP_BACK"),
    )


class PHYSHDR_MT_native(_Menu, bpy.types.Menu):
    bl_label = "Drawing"
    rows = (Entry("native_convert"), Entry("native_revert"))

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return native.available()


class PHYSHDR_MT_object(_Menu, bpy.types.Menu):
    bl_label = "PhysHDR"
    rows = (
        Entry("model_import", "Import Gaussians…", "POINTCLOUD_DATA"),
        Entry("result_import", icon="IMPORT"),
        None,
        Entry("look_through", "Look Through Next Camera", "TRIA_RIGHT", {"step": 1}),
        Entry("look_through", "Look Through Previous Camera", "TRIA_LEFT", {"step": -1}),
        Entry("cameras_import", icon="OUTLINER_OB_CAMERA"),
        None,
        Entry("render_setup", icon="SCENE"),
        Entry("develop_render", icon="CAMERA_STEREO"),
        Entry("develop_render", "Render Radiance Again", arguments={"remove": True}),
        None,
        Entry("light_as_photographed", "Light as Photographed", "LIGHT", menu_of="light"),
        Entry("light_from_here", icon="LIGHTPROBE_SPHERE"),
        Entry("light_refresh", icon="FILE_REFRESH"),
        Entry("light_reset", icon="LOOP_BACK"),
        Entry("cg_here", icon="PIVOT_CURSOR"),
        Entry("cg_reset", icon="X"),
        None,
        PHYSHDR_MT_cleaning,
        PHYSHDR_MT_scale,
        PHYSHDR_MT_native,
        None,
        Entry("model_save", "Save Edited Model…", "FILE_TICK"),
        Entry("model_bake", "Bake to PLY…", "EXPORT"),
        Entry("results_web", "Export Web Page…", "URL"),
        Entry("results_video", "Make Video…", "RENDER_ANIMATION"),
        None,
        PHYSHDR_MT_capture,
        PHYSHDR_MT_training,
        PHYSHDR_MT_trainer,
    )


#: Entries of Blender's own menus, whose entries are named by what they make.
ENTRIES: dict[str, Rows] = {
    "VIEW3D_MT_object": (PHYSHDR_MT_object,),
    "VIEW3D_MT_add": (Entry("model_import", "PhysHDR Capture…", "POINTCLOUD_DATA"),),
    "TOPBAR_MT_file_import": (Entry("model_import", f"PhysHDR model, Gaussians ({'/'.join(OFFERED[:-1])})"),),
    "TOPBAR_MT_file_export": (
        Entry("model_save", "PhysHDR model, as edited (.safetensors)"),
        Entry("model_bake", "PhysHDR Gaussians, baked (.ply)"),
        Entry("results_web", "PhysHDR web page (.html)"),
    ),
}


def _draw_entries(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    layout = layout_of(menu)
    layout.operator_context = "INVOKE_REGION_WIN"  # Add calls at once, with no file browser
    draw_rows(layout, ENTRIES[type(menu).__name__])


_CLASSES = (
    PHYSHDR_MT_cleaning,
    PHYSHDR_MT_scale,
    PHYSHDR_MT_native,
    PHYSHDR_MT_capture,
    PHYSHDR_MT_training,
    PHYSHDR_MT_trainer,
    PHYSHDR_MT_object,
)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    for name in ENTRIES:
        add_entry(getattr(bpy.types, name), _draw_entries)


def unregister() -> None:
    for name in ENTRIES:
        remove_entry(getattr(bpy.types, name), _draw_entries)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
