# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a file of Gaussians into the scene: a trained model, or another program's."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import bpy

from ...bridge.axes import Up, turn_of_up
from ...bridge.display import ColorSpace
from ...bridge.gaussian_import import is_model_file, read_gaussians
from ...bridge.model_file import PHOTOGRAPHED_EV, SPACE, WORLD, photographed_ev
from ...bridge.photographed_light import PHOTOGRAPHED_LIGHT
from .. import outside
from . import parts, pose
from .attributes import CAPTURE, COLOR_SPACE, FILE, TURN, metadata_property
from .look import cast_no_shadow
from .nodes import EXPOSURE, level_input, set_input
from .origin import capture_of_file, key_of
from .point_cloud import build_point_cloud
from .radiance_tree import add_modifier

Orientation = Literal["AUTO", "AS_IS", "Y_UP", "COLMAP"]

#: Which way is up in the file, where the user has said it.
UPS: dict[Orientation, Up] = {"AS_IS": "z", "Y_UP": "y", "COLMAP": "colmap"}


@dataclass(frozen=True)
class Imported:
    """The new object, and sentences for the user about what the file could not tell."""

    target: bpy.types.Object
    notes: tuple[str, ...]


def import_model(
    path: str | Path, name: str = "", collection: bpy.types.Collection | None = None
) -> bpy.types.Object:
    """Read a file of Gaussians and make it an object that relights and renders without a backend.

    ``name``: the file's name if empty; ``collection``: the scene's own if ``None``. Raises what
    ``read_gaussians`` raises, before anything is made.
    """
    return import_file(path, name, collection).target


def import_file(
    path: str | Path,
    name: str = "",
    collection: bpy.types.Collection | None = None,
    color_space: ColorSpace = "SRGB",
    orientation: Orientation = "AUTO",
) -> Imported:
    """As ``import_model``; ``color_space`` and ``orientation`` do not count for model files, which are
    scene-linear and in Blender's axes. ``AUTO``: as the file says, or its format has it by convention."""
    path = Path(outside.choose(str(path)))
    source = read_gaussians(path, color_space)
    name = name or path.stem
    cloud = build_point_cloud(source.model, name, source.colour_sh)
    cloud[FILE] = str(path)
    # What was written where it stood is of no data set any more: its cameras are not where they were.
    is_of_world = source.model.metadata.get(SPACE) == WORLD
    cloud[CAPTURE] = key_of(str(path)) if is_of_world else capture_of_file(path)
    cloud[TURN] = 0.0 if is_model_file(path) else _turn(UPS.get(orientation, source.up))
    pose.remember(cloud)
    ev, levels = photographed_ev(source.model.metadata), source.model.standard_levels
    if source.colour_sh is not None:
        cloud[COLOR_SPACE] = color_space
        for entry in (PHOTOGRAPHED_EV, PHOTOGRAPHED_LIGHT):  # display colours have these in them
            cloud.pop(metadata_property(entry), None)
        ev, levels = 0.0, (1.0,)
    target = bpy.data.objects.new(name, cloud)
    try:
        target.rotation_euler.x = cloud[TURN]
        modifier = add_modifier(target, source.model)
        set_input(modifier, EXPOSURE, ev)
        for index, level in enumerate(levels):
            set_input(modifier, level_input(source.model.lights, index), level)
        cast_no_shadow(target)
        parts.note(target)
        (collection or bpy.context.scene.collection).objects.link(target)
    except BaseException:
        bpy.data.batch_remove([target, cloud])
        raise
    return Imported(target, source.notes)


def _turn(up: Up) -> float:
    """The turn about X, in radians, that makes the file's up the scene's Z.

    It is the object's rotation: the Gaussians and their spherical harmonics stay as they are in the file.
    """
    turn = turn_of_up(up, "z")
    return math.atan2(turn[2, 1], turn[1, 1])
