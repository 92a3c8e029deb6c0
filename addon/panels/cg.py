# SPDX-License-Identifier: GPL-3.0-or-later
"""CG in the capture: its ground, and why its shadow would not be drawn."""

import bpy

from ..blender import layout_of
from ..light import cg
from ..rendering.render_setup import has_model
from .parts import Subpanel, write


class PHYSHDR_PT_cg(Subpanel, bpy.types.Panel):
    bl_label = "CG in the Capture"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (as Blender wants it)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_model(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = layout_of(self), context.scene
        row = layout.row(align=True)
        row.operator("physhdr.cg_here", icon="PIVOT_CURSOR")
        if not cg.is_there(scene):
            write(context, layout, "A ground at the 3D cursor: shadows of CG fall on the capture", "INFO")
            return
        row.operator("physhdr.cg_reset", text="", icon="X")
        for reason in cg.hindrances(scene):
            write(context, layout, reason, "ERROR")


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_cg,))
