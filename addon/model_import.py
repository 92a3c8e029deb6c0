# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a trained model into the scene: the function for scripts and the operator for people."""

from pathlib import Path
from typing import ClassVar

import bpy
from bpy_extras.io_utils import ImportHelper

from ..bridge.errors import PhysHDRError
from ..bridge.model_file import read_model
from .nodes import add_modifier
from .point_cloud import build_point_cloud


def import_model(
    path: str | Path, name: str = "", collection: bpy.types.Collection | None = None
) -> bpy.types.Object:
    """Read a model file and make it an object that relights and renders without a backend.

    ``name``: the file's name if empty; ``collection``: the scene's own if ``None``. Raises what
    ``read_model`` raises, before anything is made.
    """
    path = Path(path)
    model = read_model(path)
    name = name or path.stem
    cloud = build_point_cloud(model, name)
    cloud["physhdr_file"] = str(path)
    target = bpy.data.objects.new(name, cloud)
    add_modifier(target, model)
    (collection or bpy.context.scene.collection).objects.link(target)
    return target


class PHYSHDR_OT_model_import(bpy.types.Operator, ImportHelper):
    """Import a trained PhysHDR model as a point cloud that can be relit and rendered"""

    bl_idname = "physhdr.model_import"
    bl_label = "Import PhysHDR model"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    filename_ext = ".safetensors"
    filter_glob: bpy.props.StringProperty(default="*.safetensors", options={"HIDDEN"})
    name: bpy.props.StringProperty(name="Name", description="Name of the new object; empty: the file's name")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            target = import_model(bpy.path.abspath(self.filepath), self.name, context.collection)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for selected in context.selected_objects:
            selected.select_set(False)
        target.select_set(True)
        context.view_layer.objects.active = target
        self.report({"INFO"}, f"Imported {len(target.data.points)} Gaussians as {target.name!r}")
        return {"FINISHED"}


def _draw_import_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator(PHYSHDR_OT_model_import.bl_idname, text="PhysHDR model (.safetensors)")


def register() -> None:
    bpy.utils.register_class(PHYSHDR_OT_model_import)
    bpy.types.TOPBAR_MT_file_import.append(_draw_import_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import_menu)
    bpy.utils.unregister_class(PHYSHDR_OT_model_import)
