# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that lets what the open file names outside it be looked at (``addon.outside``)."""

from typing import ClassVar

import bpy

from .. import outside
from .base import choices


class PHYSHDR_OT_outside_look(bpy.types.Operator):
    """Look at the folders and files that this .blend names outside it: data set, run, photos. Nothing there
    is read before, because the file may be a stranger's"""

    bl_idname = outside.LOOK
    bl_label = "Look at Them"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    path: bpy.props.StringProperty(
        name="Path",
        description="The one to look at; empty: all on this computer",
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        named = choices(context).not_looked_at
        for path in [self.path] if self.path else [each for each in named if not outside.is_network(each)]:
            outside.choose(path)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_OT_outside_look,))
