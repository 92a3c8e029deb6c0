# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as it was edited in Blender, as a model file has it.

It is the model, not its look: exposure, levels and an SH limit are the modifier's and stay.
"""

import dataclasses

import bpy
import numpy as np

from ...bridge.affine import transform_gaussians
from ...bridge.camera_list import moved
from ...bridge.errors import BadValueError
from ...bridge.model_file import SPACE, WORLD, Model
from ...bridge.spherical_harmonics import rotated
from ..blender import cloud_of, world_of
from ..similarity import scale_of
from .cleaning import Cleaning
from .look import kept_of
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
    cameras = moved(model.cameras, np.asarray(matrix, np.float64))
    return dataclasses.replace(
        model, position=position, rotation=rotation, scale=scale, log_radiance_sh=sh, cameras=cameras
    )


def edited_model(
    target: bpy.types.Object, cleaning: Cleaning, leave_out: bool = True, apply_transform: bool = False
) -> Model:
    """What a model's object holds now. ``leave_out``: without what ``cleaning`` hides from every side;
    ``apply_transform``: in world space, else in the data set's.

    Raises ``DataMismatchError`` and ``BadValueError`` for what cannot be saved.
    """
    cloud = cloud_of(target)
    model, notes = model_of(cloud), []
    if leave_out:
        keep = kept_of(cloud, cleaning.without_camera())
        model = subset(model, keep)
        if hidden := len(keep) - int(keep.sum()):
            notes.append(f"{hidden} of {len(keep)} Gaussians left out")
    matrix = np.array(world_of(target), np.float64)
    metadata = dict(model.metadata)
    if apply_transform and not np.array_equal(matrix, np.eye(4)):
        model = transformed(model, matrix)
        metadata[SPACE] = WORLD
        notes.append("in the world of the scene")
    metadata["edited"] = f"Blender {bpy.app.version_string}" + "".join(f", {each}" for each in notes)
    return dataclasses.replace(model, metadata=metadata)
