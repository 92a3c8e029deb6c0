# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that hides what a trained model was photographed from, and shows it again."""

from typing import ClassVar

import bpy

from ..blender import layout_of
from ..capture import originals
from ..capture.originals import are_hidden
from ..rendering.render_setup import names_of

ACTIONS = [
    ("TOGGLE", "Toggle", "Hide them, or show them where they are hidden"),
    ("HIDE", "Hide", "Hide them"),
    ("SHOW", "Show", "Show them as they were"),
]


class PHYSHDR_OT_originals_hide(bpy.types.Operator):
    """Hide the objects that the model of this scene was photographed from, in 3D views and renders; again:
    show them as they were. What was hidden before stays hidden, what you have added since stays as it is"""

    bl_idname = "physhdr.originals_hide"
    bl_label = "Hide Originals"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    action: bpy.props.EnumProperty(name="Action", items=ACTIONS, options={"SKIP_SAVE", "HIDDEN"})
    lights: bpy.props.BoolProperty(
        name="Lights Too",
        default=True,
        description="Hide the lights among them: the model has their light in it, and walls that are hidden "
        "shade nothing. Off: they keep lighting what you add",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if not are_hidden(context.scene) and not originals.of_models(context.scene):
            cls.poll_message_set(
                "Nothing is remembered: only a data set rendered from this scene has originals"
            )
            return False
        return True

    def draw(self, context: bpy.types.Context) -> None:
        layout_of(self).prop(self, "lights")

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        show = are_hidden(scene) if self.action == "TOGGLE" else self.action == "SHOW"
        if show:
            self.report({"INFO"}, f"Shown again: {_objects(originals.show(scene))}, as they were")
            return {"FINISHED"}
        if are_hidden(scene):
            originals.show(scene)  # else what was hidden before would be forgotten
        count = originals.hide(scene, self.lights)
        text = "Hidden, with their lights" if self.lights else "Hidden, but for their lights"
        self.report({"INFO"}, f"{text}: {_objects(count)}; the same button shows them again")
        if animated := originals.shown_by_animation(scene):
            names = names_of(animated)
            text = f"{names}: shown again by keyframes or drivers of their visibility. Mute those"
            self.report({"WARNING"}, text)
        return {"FINISHED"}


def _objects(count: int) -> str:
    return "1 object" if count == 1 else f"{count} objects"


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_OT_originals_hide,))
