# SPDX-License-Identifier: GPL-3.0-or-later
"""Save a model as it was edited in Blender, in PhysHDR's own format: with its HDR radiance and its lights.

What is written is the model, not its look: exposure, levels and an SH limit are the modifier's and stay.
"""

import dataclasses
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper

from ...bridge.affine import transform_gaussians
from ...bridge.errors import BadValueError, PhysHDRError
from ...bridge.model_file import SPACE, SUFFIX, WORLD, Model, write_model
from ...bridge.spherical_harmonics import rotated
from ..blender import add_entry, cloud_of, layout_of, remove_entry, world_of
from ..capture.similarity import scale_of
from ..paths import whole
from .attributes import FILE
from .cleaning import Cleaning
from .look import cleaning_of, is_model, kept_of
from .point_cloud import model_of


def subset(model: Model, keep: np.ndarray) -> Model:
    """The Gaussians that are kept, bool ``[N]``. Raises ``BadValueError`` where there are none."""
    if keep.all():
        return model
    if not keep.any():
        raise BadValueError(
            "everything of the model is hidden", "Widen the limits in Clean: a model needs a Gaussian."
        )
    of_each = ("position", "rotation", "scale", "opacity", "log_radiance_sh", "light_share", "confidence")
    chosen = {name: getattr(model, name)[keep] for name in of_each if getattr(model, name) is not None}
    if model.level_log_gain is not None:
        chosen["level_log_gain"] = model.level_log_gain[:, keep]
    return dataclasses.replace(model, **chosen)


def transformed(model: Model, matrix: np.ndarray) -> Model:
    """The model moved, turned and scaled alike along all axes by ``matrix`` ``[4, 4]``, its directions too.

    Raises ``DataMismatchError`` where the map does something else: a colour toward a direction of a sheared
    model is no longer spherical harmonics of the model's degree.
    """
    factor = scale_of(matrix)
    position, rotation, scale = transform_gaussians(matrix, model.position, model.rotation, model.scale)
    sh = rotated(model.log_radiance_sh, np.asarray(matrix, np.float64)[:3, :3] / factor)
    return dataclasses.replace(model, position=position, rotation=rotation, scale=scale, log_radiance_sh=sh)


def edited_model(
    target: bpy.types.Object, cleaning: Cleaning, leave_out: bool = True, apply_transform: bool = False
) -> Model:
    """What a model's object holds now. ``leave_out``: without what ``cleaning`` hides from every side;
    ``apply_transform``: in world space, else in the data set's.

    Raises ``DataMismatchError`` and ``BadValueError`` for what cannot be saved.
    """
    cloud = cloud_of(target)
    model, told = model_of(cloud), []
    if leave_out:
        keep = kept_of(cloud, cleaning.without_camera())
        model = subset(model, keep)
        if hidden := len(keep) - int(keep.sum()):
            told.append(f"{hidden} of {len(keep)} Gaussians left out")
    matrix = np.array(world_of(target), np.float64)
    metadata = dict(model.metadata)
    if apply_transform and not np.array_equal(matrix, np.eye(4)):
        model = transformed(model, matrix)
        metadata[SPACE] = WORLD
        told.append("in the world of the scene")
    metadata["edited"] = f"Blender {bpy.app.version_string}" + "".join(f", {each}" for each in told)
    return dataclasses.replace(model, metadata=metadata)


class PHYSHDR_OT_model_save(bpy.types.Operator, ExportHelper):
    """Save the active model as it is now, in PhysHDR's own format: HDR radiance, lights, response and all.
    Baking to a PLY loses those"""

    bl_idname = "physhdr.model_save"
    bl_label = "Save Edited Model"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = SUFFIX
    # ExportHelper's own is remembered: the next model would be offered the file of the last one.
    filepath: bpy.props.StringProperty(name="File Path", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})
    leave_out: bpy.props.BoolProperty(
        name="Leave Out What Is Hidden",
        description="Without the Gaussians that the limits in Clean hide. Off: all, hidden or not",
        default=True,
    )
    apply_transform: bpy.props.BoolProperty(
        name="Apply Transform",
        description="Write world space: location, rotation and scale of the object become the model's. "
        "Off: where the data set has it, so that its cameras still fit",
        default=False,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not is_model(context.object):
            cls.poll_message_set("Select an imported model first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        target = context.object
        assert is_model(target)
        if not self.filepath:
            source = Path(bpy.path.abspath(str(cloud_of(target).get(FILE, ""))) or target.name)
            self.filepath = str(source.with_name(f"{source.stem}_edited{SUFFIX}"))
        return set(super().invoke(context, event))

    def execute(self, context: bpy.types.Context) -> set[str]:
        target = context.object
        assert is_model(target)
        try:
            path = Path(whole(self.filepath))
            cleaning = cleaning_of(target, context.evaluated_depsgraph_get())
            model = edited_model(target, cleaning, self.leave_out, self.apply_transform)
            write_model(path, model)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        hidden = len(cloud_of(target).points) - model.count
        left_out = f", {hidden} that are hidden left out" if hidden else ""
        self.report({"INFO"}, f"Wrote {model.count} Gaussians to {path}{left_out}")
        return {"FINISHED"}


def _draw_export_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    layout_of(menu).operator(PHYSHDR_OT_model_save.bl_idname, text="PhysHDR model, as edited (.safetensors)")


def register() -> None:
    bpy.utils.register_class(PHYSHDR_OT_model_save)
    add_entry(bpy.types.TOPBAR_MT_file_export, _draw_export_menu)


def unregister() -> None:
    remove_entry(bpy.types.TOPBAR_MT_file_export, _draw_export_menu)
    bpy.utils.unregister_class(PHYSHDR_OT_model_save)
