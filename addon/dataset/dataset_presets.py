# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own presets, for what is chosen in the dialog of a data set."""

from typing import ClassVar

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from .dataset_settings import DATASET, OPTIONS

#: Of the presets' folder, in Blender's for scripts.
FOLDER = "physhdr_dataset"


def make_folder() -> None:
    """Blender's list of presets says *Missing Paths* where there is no folder of them."""
    bpy.utils.user_resource("SCRIPTS", path=f"presets/{FOLDER}", create=True)


class PHYSHDR_PT_dataset_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Data Set Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "physhdr.dataset_preset_add"


class PHYSHDR_OT_dataset_preset_add(AddPresetBase, bpy.types.Operator):
    """Keep what is chosen for a data set as a preset, for other scenes, too; or remove one"""

    bl_idname = "physhdr.dataset_preset_add"
    bl_label = "Add Data Set Preset"
    preset_menu = "PHYSHDR_PT_dataset_presets"
    preset_subdir = FOLDER
    preset_defines: ClassVar[list[str]] = [f"settings = bpy.context.scene.{DATASET}"]
    #: All but the folder, which is a scene's own.
    preset_values: ClassVar[list[str]] = [
        f"settings.{name}" for name in (*OPTIONS, "vary_ambient") if name != "out"
    ]


register, unregister = bpy.utils.register_classes_factory(
    (PHYSHDR_PT_dataset_presets, PHYSHDR_OT_dataset_preset_add)
)
