# SPDX-License-Identifier: GPL-3.0-or-later
"""From pictures to a trained model: the data set, the training, its results, and the trainer itself."""

from typing import TYPE_CHECKING, ClassVar

import bpy

from ..blender import layout_of
from ..rendering.render_setup import has_model
from ..runtime import session
from . import backend, dataset, results, training
from .parts import SidebarPanel


class _Capture(SidebarPanel):
    bl_label = "Capture"
    bl_order = 1
    if TYPE_CHECKING:
        layout: bpy.types.UILayout | None

    def draw(self, context: bpy.types.Context) -> None:
        state, layout = session().state, layout_of(self)
        dataset.draw(context, layout, state)
        if state.backend.ready:
            training.draw(context, layout, state)
            results.draw(context, layout, state)
            backend.draw(context, layout, state)


class PHYSHDR_PT_capture(_Capture, bpy.types.Panel):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return not is_behind(context)


class PHYSHDR_PT_capture_behind(_Capture, bpy.types.Panel):
    """The same, folded: a panel of its own, because Blender remembers of each whether it is open."""

    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return is_behind(context)


def is_behind(context: bpy.types.Context) -> bool:
    """Whether what the user does now is something else: with a model in the scene, or without a trainer."""
    state = session().state
    return not state.active and (not state.backend.ready or has_model(context.scene))


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_capture, PHYSHDR_PT_capture_behind))
