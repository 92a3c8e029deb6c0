# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render of the scene would show wrong of its models, and what sets it right."""

from typing import TYPE_CHECKING

import bpy

from ..blender import layout_of
from ..capture.dataset_cameras import cameras_of, has_size, is_of_data_set, size_of
from ..model.nodes import EXPOSURE
from ..model.response_nodes import OVER_BLACK
from ..operators.render import model_for, model_to_develop_by
from ..rendering import develop
from ..rendering.render_setup import has_model, render_problems
from .parts import SidebarPanel, write


class _Render:
    if TYPE_CHECKING:
        layout: bpy.types.UILayout | None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_model(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        problems = render_problems(context.scene)
        # Above what it sets right, whose sentences may be longer than the screen.
        row = layout.row()
        row.scale_y = 1.4 if any(problem.fixable for problem in problems) else 1.0
        row.operator("physhdr.render_setup", icon="SCENE")
        for problem in problems:
            write(context, layout, problem.text, "ERROR")
        if not problems:
            layout.label(text="Models render as they were trained", icon="CHECKMARK")
        draw_developing(context, layout)
        draw_cameras(context, layout)


class PHYSHDR_PT_render(_Render, SidebarPanel, bpy.types.Panel):
    bl_label = "Render"
    bl_order = 3


class PHYSHDR_PT_render_properties(_Render, bpy.types.Panel):
    """The same where Blender has what decides a render."""

    bl_label = "PhysHDR"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"


def draw_developing(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """The button that develops renders and leaves off, and what the camera is set to."""
    node, target = develop.node_of(context.scene), model_to_develop_by(context)
    if node is None and target is None:
        return
    column = layout.column(align=True)
    button = column.operator(
        "physhdr.develop_render", text=develop.LABEL, icon="CAMERA_STEREO", depress=node is not None
    )
    button.remove = node is not None
    if node is None:
        return
    if target is not None and not develop.has_response_of(node, target):
        column.operator("physhdr.develop_render", text=f"By the Response of {target.name}").remove = False
    if node.node_tree is not None:
        inputs = layout.column()
        inputs.use_property_split = inputs.use_property_decorate = True
        for name in (EXPOSURE, OVER_BLACK):
            inputs.prop(node.inputs[name], "default_value", text=name)


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


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_render, PHYSHDR_PT_render_properties))
