# SPDX-License-Identifier: GPL-3.0-or-later
"""Export a model with its current look as a standard 3DGS PLY, which any viewer opens.

What it shows is near the model's own picture, not the same. The response is baked into each Gaussian's colour
and the colours are then blended; the model blends radiance, and the response comes last. On the demo's test
views, drawn by our own rasteriser, that leaves 26.5 dB and is 6/255 too dark. Viewers add to it what they do
otherwise than our rasteriser: Spark 2.2 draws the file within 39.9 dB of us where it is told our limits of a
splat (``bridge/splatting.py``), and 24.8 dB with its defaults.
"""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper

from ...bridge.affine import transform_gaussians
from ...bridge.display import Tone, display_colour_sh, look_comment
from ...bridge.errors import PhysHDRError
from ...bridge.gaussian_ply import write_standard_ply
from ...bridge.spherical_harmonics import coefficient_count
from ..blender import add_entry, cloud_of, layout_of, remove_entry
from .look import Look, is_model, kept_of, look_of
from .point_cloud import lights_of, model_of
from .save_model import subset

#: A viewer takes the logarithm of a scale: none may be 0.
SMALLEST_SCALE = 1e-12


def bake(target: bpy.types.Object, path: Path, look: Look, tone: Tone, apply_transform: bool = True) -> int:
    """Write the PLY, atomically, as ``physhdr export`` does; how many Gaussians it holds: those not hidden.

    ``apply_transform``: in world space (any scale and shear is exact), else in the object's own. Raises
    ``DataMismatchError`` and ``BadValueError`` for what cannot be baked, ``OutputError``.
    """
    cloud = cloud_of(target)
    model = model_of(cloud)
    if not look.cleaning.keeps_everything:
        model = subset(model, kept_of(cloud, look.cleaning.without_camera()))
    degree = min(model.sh_degree, look.sh_limit) if look.view_dependent else 0
    if degree < model.sh_degree:
        sh = model.log_radiance_sh[:, : coefficient_count(degree)]
        model = dataclasses.replace(model, log_radiance_sh=sh)
    shape = model.position, model.rotation, model.scale
    to_world = np.array(target.matrix_world) if apply_transform else np.eye(4)
    moved = not np.array_equal(to_world, np.eye(4))
    if moved:
        shape = transform_gaussians(to_world, *shape)
    linear = to_world[:3, :3] if moved else None
    comments = [f"PhysHDR {key}: {value}" for key, value in model.metadata.items()]
    comments.append(look_comment(look.exposure_ev, look.lighting_levels, tone, model.lights))
    write_standard_ply(
        path,
        positions=shape[0],
        rotations=shape[1],
        scales=np.maximum(shape[2], np.float32(SMALLEST_SCALE)),
        opacities=model.opacity,
        colour_sh=display_colour_sh(model, look.exposure, look.lighting_levels, tone, linear),
        comments=comments,
    )
    return model.count


class PHYSHDR_OT_model_bake(bpy.types.Operator, ExportHelper):
    """Export the active model with its current look (exposure, lighting levels, tone) as a 3DGS PLY. Viewers
    blend colours that are tone mapped already: near the live preview's picture (26.5 dB in the demo)"""

    bl_idname = "physhdr.model_bake"
    bl_label = "Bake to PLY"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    if TYPE_CHECKING:
        filepath: str  # ExportHelper's

    filename_ext = ".ply"
    filter_glob: bpy.props.StringProperty(default="*.ply", options={"HIDDEN"})
    tone: bpy.props.EnumProperty(
        name="Tone",
        description="How radiance becomes the colours that viewers show",
        items=[
            ("LOOK", "As shown", "The learned tone mapper where the model shows it, else the sRGB curve"),
            ("LEARNED", "Learned", "The response of the camera that took the training pictures"),
            ("SRGB", "sRGB", "The plain sRGB curve, as Blender's Standard view"),
        ],
    )
    apply_transform: bpy.props.BoolProperty(
        name="Apply transform",
        description="Write world space: the object's location, rotation and scale. Off: as it was imported",
        default=True,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not is_model(context.object):
            cls.poll_message_set("Select an imported model first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            self.filepath = f"{_active_model(context).name}.ply"
        return set(super().invoke(context, event))

    def execute(self, context: bpy.types.Context) -> set[str]:
        target, path = _active_model(context), Path(bpy.path.abspath(self.filepath))
        depsgraph = context.evaluated_depsgraph_get()  # drivers and keyframes, as of this frame
        tone: Tone = self.tone
        try:
            look = look_of(target, depsgraph)
            if self.tone == "LOOK":
                tone = "LEARNED" if look.tone_mapper else "SRGB"
            count = bake(target, path, look, tone, self.apply_transform)
            words = look_comment(look.exposure_ev, look.lighting_levels, tone, lights_of(cloud_of(target)))
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wrote {count} Gaussians to {path}: {words}")
        return {"FINISHED"}


def _active_model(context: bpy.types.Context) -> bpy.types.Object:
    """The object for which ``poll`` let the operator run."""
    assert is_model(context.object)
    return context.object


def _draw_export_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    layout_of(menu).operator(PHYSHDR_OT_model_bake.bl_idname, text="PhysHDR Gaussians, baked (.ply)")


def register() -> None:
    bpy.utils.register_class(PHYSHDR_OT_model_bake)
    add_entry(bpy.types.TOPBAR_MT_file_export, _draw_export_menu)


def unregister() -> None:
    remove_entry(bpy.types.TOPBAR_MT_file_export, _draw_export_menu)
    bpy.utils.unregister_class(PHYSHDR_OT_model_bake)
