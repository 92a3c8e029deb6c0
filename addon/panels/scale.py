# SPDX-License-Identifier: GPL-3.0-or-later
"""Scale and ground of the selected model's capture."""

import bpy

from ..blender import layout_of
from ..model import origin
from ..model.look import is_model
from .parts import ICON, ModelSubpanel, write


class PHYSHDR_PT_scale(ModelSubpanel, bpy.types.Panel):
    bl_label = "Scale and Ground"

    def draw(self, context: bpy.types.Context) -> None:
        layout, target = layout_of(self), context.object
        assert is_model(target)
        column = layout.column(align=True)
        column.operator("physhdr.capture_scale", text="Scale by Two Points…", icon="DRIVER_DISTANCE")
        column.operator("physhdr.capture_floor", text="Floor by Three Points…", icon="ORIENTATION_NORMAL")
        column.operator("physhdr.capture_height", text="By the Cameras' Height…", icon="VIEW_CAMERA")
        known = context.scene.physhdr.captures.get(origin.capture_of(target))
        if known is None:
            write(context, layout, "Photos tell neither how large things are nor where the floor is", "INFO")
            return
        facts = ["metres" if known.has_scale else "scale as imported"]
        facts.append("floor at z = 0" if known.has_floor else "ground as imported")
        row = layout.row(align=True)
        write(context, row, ", ".join(facts).capitalize(), "CHECKMARK", beside=ICON)
        row.operator("physhdr.capture_reset", text="", icon="LOOP_BACK")


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_scale,))
