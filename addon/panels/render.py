# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render of the scene would show wrong of its models, and what sets it right."""

import bpy

from ..blender import layout_of
from ..capture.dataset_cameras import cameras_of, has_size, is_of_data_set, size_of
from ..operators.render import model_for
from ..rendering.render_setup import has_model, render_problems
from .parts import Subpanel, write


class PHYSHDR_PT_render(Subpanel, bpy.types.Panel):
    bl_label = "Render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_model(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        problems = render_problems(context.scene)
        for problem in problems:
            write(context, layout, problem.text, "ERROR")
        if not problems:
            layout.label(text="Models render as they were trained", icon="CHECKMARK")
        row = layout.row()
        row.scale_y = 1.4 if any(problem.mended for problem in problems) else 1.0
        row.operator("physhdr.render_setup", icon="SCENE")
        draw_cameras(context, layout)


def draw_cameras(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """The data set's cameras: a button that brings them in, and the size of the picture of the one in use."""
    scene, target = context.scene, model_for(context)
    if target is None:
        return
    layout.separator()
    column = layout.column()
    column.use_property_split = True
    column.prop(scene, "camera")
    there = cameras_of(scene, target)
    text = "Put Cameras Back" if there else "Import Cameras"
    layout.operator("physhdr.cameras_import", text=text, icon="OUTLINER_OB_CAMERA")
    camera = scene.camera
    if camera is None or not is_of_data_set(camera) or has_size(scene, camera):
        return
    width, height = size_of(camera)
    text = f"Render at {width} × {height}"
    layout.operator("physhdr.render_setup", text=text, icon="FULLSCREEN_ENTER").use_size = True


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_render,))
