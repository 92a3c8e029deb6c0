# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that let Blender 5.3 draw models itself, and the extension again."""

from typing import ClassVar

import bpy

from ...bridge.errors import PhysHDRError
from ..blender import add_entry, cloud_of, layout_of, remove_entry
from ..model import native
from ..model.look import is_model


class _OnModels(bpy.types.Operator):
    """What is done to each of the selected models, or the active one."""

    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}
    #: Whether it is for models that are native already.
    of_native: ClassVar[bool]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if reason := native.why_not():
            cls.poll_message_set(reason)
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if not cls.targets(context):
            cls.poll_message_set("Select an imported model first")
            return False
        return True

    @classmethod
    def targets(cls, context: bpy.types.Context) -> list[bpy.types.Object]:
        """The models that it is for."""
        chosen = [*(context.selected_objects or ()), context.object]
        unique = {each.name: each for each in chosen if is_model(each) and each.library is None}
        return [each for each in unique.values() if native.is_native(cloud_of(each)) == cls.of_native]

    def execute(self, context: bpy.types.Context) -> set[str]:
        done = 0
        for target in self.targets(context):
            try:
                self.change(target)
                done += 1
            except PhysHDRError as error:
                self.report({"WARNING" if done else "ERROR"}, str(error))
        return {"FINISHED"} if done else {"CANCELLED"}

    def change(self, target: bpy.types.Object) -> None:
        raise NotImplementedError


class PHYSHDR_OT_native_convert(_OnModels):
    """Let Blender itself draw the selected models as Gaussian splats, in the 3D view, EEVEE and Cycles.
    Exposure, levels and their keyframes stay"""

    bl_idname = "physhdr.native_convert"
    bl_label = "Draw as Blender's Splats"
    of_native = False

    def change(self, target: bpy.types.Object) -> None:
        native.convert(target)


class PHYSHDR_OT_native_revert(_OnModels):
    """Let PhysHDR draw the selected models again"""

    bl_idname = "physhdr.native_revert"
    bl_label = "Draw by PhysHDR"
    of_native = True

    def change(self, target: bpy.types.Object) -> None:
        native.revert(target)


def draw_native(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """The button that a model has here; nothing where this Blender cannot draw splats itself."""
    if not native.available():
        return
    shown = PHYSHDR_OT_native_revert if native.is_native(cloud_of(target)) else PHYSHDR_OT_native_convert
    layout.operator(shown.bl_idname, icon="POINTCLOUD_DATA")


def _draw_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    if is_model(context.object):
        draw_native(layout_of(menu), context.object)


_CLASSES = (PHYSHDR_OT_native_convert, PHYSHDR_OT_native_revert)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    add_entry(bpy.types.VIEW3D_MT_object_context_menu, _draw_menu)


def unregister() -> None:
    remove_entry(bpy.types.VIEW3D_MT_object_context_menu, _draw_menu)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
