# SPDX-License-Identifier: GPL-3.0-or-later
"""A model of any file of Gaussians: PhysHDR's own, a PLY of any kind, or another program's format."""

from dataclasses import replace
from pathlib import Path

from .axes import Up, turn_of_up
from .display import ColorSpace
from .model_file import SUFFIX, Model, read_model
from .ply_model import PlyModel, model_of_cloud, read_ply_model
from .splat_files.cloud import SplatCloud, turned
from .splat_files.reading import format_of, read_any


def is_model_file(path: Path) -> bool:
    """Whether ``path`` is named as a model of PhysHDR, which is in Blender's axes and scene-linear."""
    return path.suffix.lower() == SUFFIX


def read_gaussians(path: Path, color_space: ColorSpace = "SRGB") -> PlyModel:
    """Read a model file, a PLY or another program's file of Gaussians.

    ``color_space`` says what the colours of other programs' files are. Raises what ``read_model``,
    ``read_ply_model`` and ``splat_files.read_splat_file`` raise.
    """
    path = Path(path)
    if is_model_file(path):
        return PlyModel(read_model(path), None, 0, ())
    if format_of(path).name == "PLY":
        return read_ply_model(path, color_space)
    return model_of_cloud(path, read_any(path), color_space)


def upright(model: Model, up: Up) -> Model:
    """``model`` turned about the origin, its places, ellipsoids and light, so that +Z is up as in Blender.

    ``up``: which way is up in its axes.
    """
    if up == "z":
        return model
    cloud = SplatCloud(model.position, model.rotation, model.scale, model.opacity, model.log_radiance_sh)
    whole = turned(cloud, turn_of_up(up, "z"))
    return replace(model, position=whole.position, rotation=whole.rotation, log_radiance_sh=whole.colour_sh)
