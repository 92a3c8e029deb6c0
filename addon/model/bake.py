# SPDX-License-Identifier: GPL-3.0-or-later
"""A model with its current look as a standard 3DGS PLY, which any viewer opens.

Viewers blend display colours; the model blends radiance, and the response comes last. Where each Gaussian's
colour is converted by itself, the blend of them is another picture: 26.5 dB from the model's own on the
demo's test views, and 6/255 too dark. So the trainer fits them to pictures (``backend/export/fitted_bake``),
where there is one and the data set's cameras are known.
"""

import dataclasses
from pathlib import Path

import bpy
import numpy as np

from ...bridge.affine import transform_gaussians
from ...bridge.display import FITTED_COMMENT, Tone, display_colour_sh, look_comment, turned_colour_sh
from ...bridge.gaussian_ply import write_standard_ply
from ...bridge.model_file import SPACE, WORLD, Model
from ...bridge.spherical_harmonics import coefficient_count
from ..blender import cloud_of, world_of
from .edited_model import subset
from .look import Look, kept_of
from .point_cloud import model_of


def baked_model(target: bpy.types.Object, look: Look) -> Model:
    """The model as it is baked, in its own space: what ``look`` hides is left out, and SH beyond its limit.

    Raises ``DataMismatchError`` and ``BadValueError`` for what cannot be baked.
    """
    cloud = cloud_of(target)
    model = model_of(cloud)
    if not look.cleaning.keeps_everything:
        model = subset(model, kept_of(cloud, look.cleaning.without_camera()))
    degree = min(model.sh_degree, look.sh_limit) if look.view_dependent else 0
    if degree < model.sh_degree:
        sh = model.log_radiance_sh[:, : coefficient_count(degree)]
        model = dataclasses.replace(model, log_radiance_sh=sh)
    return model


def bake(target: bpy.types.Object, path: Path, look: Look, tone: Tone, apply_transform: bool = True) -> Model:
    """Write the PLY with each Gaussian's colour converted by itself, as ``physhdr export --quick`` does;
    returns the model that it holds (``baked_model``).

    ``apply_transform``: in world space (any scale and shear is exact), else in the object's own. Raises what
    ``baked_model`` raises, and ``OutputError``.
    """
    model = baked_model(target, look)
    to_world = np.array(world_of(target)) if apply_transform else np.eye(4)
    shape = moved(model, to_world)  # refuses a map that flattens, before colours are looked at through it
    linear = None if np.array_equal(to_world, np.eye(4)) else to_world[:3, :3]
    colours = display_colour_sh(model, look.exposure, look.lighting_levels, tone, linear)
    _write(path, shape, model.opacity, colours, _comments(model, look, tone, to_world))
    return model


def baked_look(model: Model, look: Look, tone: Tone) -> str:
    """What the file says of its colours: at which levels, of those that the model has the nearest."""
    return look_comment(look.exposure_ev, model.known_levels(look.lighting_levels), tone, model.lights)


def write_fitted(
    path: Path, model: Model, colour_sh: np.ndarray, look: Look, tone: Tone, to_world: np.ndarray
) -> None:
    """Write ``colour_sh``, fitted in the model's own space, and its shape, moved by ``to_world`` ``[4, 4]``.

    Raises ``DataMismatchError`` where that flattens, and ``OutputError``.
    """
    shape = moved(model, to_world)
    if not np.array_equal(to_world, np.eye(4)):
        colour_sh = turned_colour_sh(colour_sh, to_world[:3, :3])
    _write(path, shape, model.opacity, colour_sh, [*_comments(model, look, tone, to_world), FITTED_COMMENT])


def moved(model: Model, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, rotation and scale under ``to_world``; raises ``DataMismatchError`` where that flattens."""
    shape = model.position, model.rotation, model.scale
    return shape if np.array_equal(to_world, np.eye(4)) else transform_gaussians(to_world, *shape)


def _write(
    path: Path,
    shape: tuple[np.ndarray, np.ndarray, np.ndarray],
    opacity: np.ndarray,
    colour_sh: np.ndarray,
    comments: list[str],
) -> None:
    write_standard_ply(
        path,
        positions=shape[0],
        rotations=shape[1],
        scales=shape[2],
        opacities=opacity,
        colour_sh=colour_sh,
        comments=comments,
    )


def _comments(model: Model, look: Look, tone: Tone, to_world: np.ndarray) -> list[str]:
    space = {} if np.array_equal(to_world, np.eye(4)) else {SPACE: WORLD}
    facts = [f"PhysHDR {key}: {value}" for key, value in {**model.metadata, **space}.items()]
    return [*facts, baked_look(model, look, tone)]
