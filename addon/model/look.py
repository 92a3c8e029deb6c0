# SPDX-License-Identifier: GPL-3.0-or-later
"""How a model is looked at: exposure, lighting levels, tone mapping, and what of it is hidden. Inputs of its
modifier, so that they are saved, undone, keyframed and driven as everything in Blender; what draws a model
reads them from here.
"""

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeGuard

import bpy
import mathutils
import numpy as np

from ...bridge.errors import PhysHDRError
from ...bridge.run_folder import same_folder, same_spelling
from ...bridge.spherical_harmonics import MAX_DEGREE
from .. import outside
from ..blender import cloud_of, world_of
from . import nodes
from .attributes import (
    BASE,
    CAMERA_DISTANCE,
    CONFIDENCE,
    FILE,
    IDENTITY,
    POSITION,
    ROTATION,
    SCALE,
    Attribute,
)
from .cleaning import ALL, Cleaning, RenderCamera, kept
from .point_cloud import lights_of, photographed_light_of, read_attribute


def inputs(lights: Sequence[str]) -> list[str]:
    """The labels of the inputs that people use, in the panel's order: a level for each of the lights."""
    levels = [nodes.level_input(lights, index) for index in range(len(lights))]
    return [nodes.EXPOSURE, *levels, nodes.TONE_MAPPER, nodes.VIEW_DEPENDENT]


#: Inputs that decide how a model looks but for its light, and what a panel calls them.
LOOK = {
    nodes.TONE_MAPPER: "Learned Tones",
    nodes.VIEW_DEPENDENT: "View Dependent",
    nodes.CAMERA_SPLATS: "Camera Splats",
    nodes.IMAGE_WIDTH: "Image Width",
}


@dataclass(frozen=True)
class Look:
    """``exposure_ev``: radiance is multiplied by 2 to this power; ``lighting_levels``: the factor of each of
    the model's lights, 1 as captured; ``tone_mapper``: show the learned response's codes, not radiance.
    ``cleaning``: what is hidden; ``sh_limit``: no SH of a higher degree are used."""

    exposure_ev: float = 0.0
    lighting_levels: tuple[float, ...] = (1.0,)
    tone_mapper: bool = False
    view_dependent: bool = True
    cleaning: Cleaning = ALL
    sh_limit: int = MAX_DEGREE

    @property
    def exposure(self) -> float:
        """Seconds: 2^EV."""
        return 2.0**self.exposure_ev


def is_model(target: bpy.types.Object | None) -> TypeGuard[bpy.types.Object]:
    """Whether an object is an imported model (or a copy of one)."""
    return target is not None and target.type == "POINTCLOUD" and IDENTITY in cloud_of(target)


def file_has_model() -> bool:
    """Whether there is a model anywhere in the file, linked ones included. Panels ask at every redraw, and
    point clouds are few where objects are many."""
    return any(IDENTITY in cloud for cloud in bpy.data.pointclouds)


def models_among(objects: Iterable[bpy.types.Object]) -> Iterator[bpy.types.Object]:
    """Those of some objects that are models (20,000 objects: 6 ms; none where the file has no model)."""
    if file_has_model():
        yield from (each for each in objects if each.type == "POINTCLOUD" and is_model(each))


def is_of_run(target: bpy.types.Object | None, run: str) -> TypeGuard[bpy.types.Object]:
    """Whether an object is a model from a run's folder, by whatever path the two are known."""
    if not run or not is_model(target):
        return False
    file = bpy.path.abspath(str(cloud_of(target).get(FILE, "")))
    same = was_same_folder if outside.may_look(file) else same_spelling
    return bool(file) and same(os.path.dirname(file), run)


def was_same_folder(one: str, other: str) -> bool:
    """``same_folder`` as it was a second ago at most."""
    return _same_folder(one, other, int(time.monotonic()))


@lru_cache(maxsize=64)
def _same_folder(one: str, other: str, second: int) -> bool:
    """Asked at every redraw, answered anew each second: links are looked up on disk, or in a network."""
    return same_folder(one, other)


def look_of(target: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Look:
    """The look of a model: its values now, or with ``depsgraph`` as evaluated there (a frame being rendered).

    A model whose modifier was removed has the look it was captured with. Raises ``DataMismatchError`` as
    ``lights_of`` and ``photographed_light_of`` do.
    """
    lights = lights_of(cloud_of(target))
    values = _values(target, (*inputs(lights), *nodes.CLEANING, *nodes.CULLING), depsgraph)
    standard = photographed_light_of(cloud_of(target))[0].of(lights)
    levels = [values.get(nodes.level_input(lights, k), level) for k, level in enumerate(standard)]
    return Look(
        exposure_ev=values.get(nodes.EXPOSURE, 0.0),
        lighting_levels=tuple(levels),
        tone_mapper=values.get(nodes.TONE_MAPPER, False),
        view_dependent=values.get(nodes.VIEW_DEPENDENT, True),
        cleaning=_cleaning(target, values, depsgraph),
        sh_limit=values.get(nodes.SH_DEGREE, MAX_DEGREE),
    )


def cleaning_of(target: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Cleaning:
    """What of a model is hidden, as ``look_of``; nothing where its modifier was removed."""
    values = _values(target, (*nodes.CLEANING, *nodes.CULLING), depsgraph)
    return _cleaning(target, values, depsgraph)


def kept_of(
    cloud: bpy.types.PointCloud, cleaning: Cleaning, camera: RenderCamera | None = None
) -> np.ndarray:
    """Bool ``[N]``: which Gaussians of a model's point cloud ``cleaning.kept`` keeps."""

    def known(attribute: Attribute) -> np.ndarray | None:
        return read_attribute(cloud, attribute.name) if attribute.name in cloud.attributes else None

    return kept(
        cleaning,
        read_attribute(cloud, POSITION.name),
        read_attribute(cloud, SCALE.name),
        read_attribute(cloud, BASE.name)[:, 3],
        known(CAMERA_DISTANCE),
        camera,
        known(CONFIDENCE),
    )


def shown_shape(target: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Position ``[N, 3]``, rotation ``[N, 4]`` (wxyz), scale ``[N, 3]`` and opacity ``[N]`` of a model's
    Gaussians that are not hidden from every side, in the model's own space."""
    cloud = cloud_of(target)
    keep = kept_of(cloud, cleaning_of(target).without_camera())
    position, rotation, scale, base = (
        read_attribute(cloud, each.name)[keep] for each in (POSITION, ROTATION, SCALE, BASE)
    )
    return position, rotation, scale, base[:, 3]


def _values(
    target: bpy.types.Object, labels: Sequence[str], depsgraph: bpy.types.Depsgraph | None
) -> dict[str, Any]:
    """The values of those inputs that the model's modifier has."""
    modifier = nodes.find_modifier(target)
    if modifier is None:
        return {}
    # Labels are looked up in the original; an evaluated object has only the values of its own.
    identifiers = nodes.identifiers(modifier)
    if depsgraph is not None:
        modifier = target.evaluated_get(depsgraph).modifiers[modifier.name]
    found = nodes.inputs_of(modifier)
    return {label: getattr(found, identifiers[label]).value for label in labels if label in identifiers}


def _cleaning(
    target: bpy.types.Object, values: dict[str, Any], depsgraph: bpy.types.Depsgraph | None
) -> Cleaning:
    if not values:
        return ALL

    def value(label: str, default: Any = 0.0) -> Any:
        return values.get(label, default)

    def relative(label: str) -> mathutils.Matrix | None:
        """From the space of an input's object to the model's."""
        other = values.get(label)
        if other is None:
            return None
        return world_of(target, depsgraph).inverted_safe() @ world_of(other, depsgraph)

    crop = None
    if value(nodes.CROP, False) and (box := relative(nodes.CROP_BOX)) and box.determinant() != 0.0:
        crop = tuple(number for row in box.inverted() for number in row)
    # Asked for only where it counts: nearly all of the time nothing is hidden.
    centre = relative(nodes.DISTANCE_FROM) if value(nodes.LARGEST_DISTANCE) > 0.0 else None
    return Cleaning(
        crop=crop,
        keep_outside=value(nodes.KEEP_OUTSIDE, False),
        largest_size=value(nodes.LARGEST_SIZE),
        smallest_opacity=value(nodes.SMALLEST_OPACITY),
        largest_elongation=value(nodes.LARGEST_ELONGATION),
        largest_distance=value(nodes.LARGEST_DISTANCE),
        centre=(centre.translation.x, centre.translation.y, centre.translation.z) if centre else ALL.centre,
        clear_of_photos=value(nodes.CLEAR_OF_PHOTOS),
        smallest_confidence=value(nodes.SMALLEST_CONFIDENCE),
        clear_of_camera=value(nodes.CLEAR_OF_CAMERA),
        farthest=value(nodes.FARTHEST),
        only_in_view=value(nodes.ONLY_IN_VIEW, False),
        view_margin=value(nodes.VIEW_MARGIN, ALL.view_margin),
    )


def slider_name(lights: Sequence[str], index: int) -> str:
    """What a panel calls a light's level: by its name alone, which is all there is room for."""
    return nodes.level_input(lights, 0) if len(lights) == 1 else lights[index]


def draw_sliders(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """Exposure and a level for each light, with keyframe buttons; a label where the modifier was removed."""
    modifier = nodes.find_modifier(target)
    if modifier is None:
        layout.label(text="Its PhysHDR modifier was removed: import it again", icon="ERROR")
        return
    try:
        lights = lights_of(cloud_of(target))
    except PhysHDRError as error:
        layout.label(text=str(error), icon="ERROR")
        return
    names = {nodes.level_input(lights, index): slider_name(lights, index) for index in range(len(lights))}
    _draw_inputs(layout, modifier, {nodes.EXPOSURE: nodes.EXPOSURE, **names})


def draw_look(layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    """The rest of how a model looks, with keyframe buttons; nothing where the modifier was removed."""
    modifier = nodes.find_modifier(target)
    if modifier is not None:
        _draw_inputs(layout, modifier, LOOK)


def _draw_inputs(
    layout: bpy.types.UILayout, modifier: bpy.types.NodesModifier, names: dict[str, str]
) -> None:
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = True
    for label, name in names.items():
        if nodes.has_input(modifier, label):
            socket = getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, label))
            column.prop(socket, "value", text=name)


def cast_no_shadow(target: bpy.types.Object) -> None:
    """Gaussians carry their light with them and cast no shadow.

    Beside a sun EEVEE would draw the shadow of every one (60 thousand at 120×120: it had not ended after 15
    minutes; without it takes 20 seconds).
    """
    target.visible_shadow = False
