# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as a point cloud, and the way back: ``attributes`` says what stands where."""

import itertools
import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge import native_splats
from ...bridge.camera_list import ListedCamera, camera_text, cameras_of
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.lights import AMBIENT, check_lights
from ...bridge.model_file import PHOTOGRAPHED_EV, SPACE, Model, photographed_ev
from ...bridge.photographed_light import PHOTOGRAPHED_LIGHT, PhotographedLight, photographed_light
from ...bridge.spherical_harmonics import C0
from ..blender import cloud_of
from .attributes import (
    BASE,
    CAMERAS,
    CONFIDENCE,
    EXPOSURES,
    IDENTITY,
    LEVEL_LOG_GAIN,
    LEVELS,
    LIGHT_SHARE,
    LIGHTS,
    LOG_SH,
    MODULATOR,
    POSITION,
    ROTATION,
    SCALE,
    SH_DEGREE,
    SHOWN_SH,
    TONE_CURVE,
    TONE_CURVE_LOG_EXPOSURE,
    TYPES,
    Attribute,
    Numbered,
    metadata_property,
)
from .tone_curve import ToneCurve

#: Quaternions of this length but for rounding are unit: they stay to the bit when imported again.
UNIT_TOLERANCE = 1e-6
#: Where a model is from; kept as custom properties.
METADATA = ("scene", "method", "iteration", "edited", SPACE, PHOTOGRAPHED_EV, PHOTOGRAPHED_LIGHT)


def attributes_of(
    model: Model, colour_sh: np.ndarray | None = None
) -> Iterator[tuple[Attribute, np.ndarray]]:
    """The attributes of a model with their values, one at a time: together they are larger than the model.

    ``colour_sh`` ``[N, K, 3]``: the colours of the PLY that the model was made from. They become Blender
    5.3's attributes as they are, as if it had imported the file; a model of ours gives it sRGB codes of the
    radiance that a display shows, 0 to 1. No scale is 0, which it could not pack (``native_splats``).
    """
    yield POSITION, model.position
    yield SCALE, native_splats.packable(model.scale)
    length = np.linalg.norm(model.rotation, axis=1, keepdims=True)
    length[np.abs(length - 1.0) < UNIT_TOLERANCE] = 1.0
    yield ROTATION, model.rotation / length

    shown_sh = _shown_sh(model) if colour_sh is None else colour_sh
    yield BASE, np.column_stack([shown_sh[:, 0], model.opacity])
    for k in range(1, shown_sh.shape[1]):
        yield SHOWN_SH[k - 1], shown_sh[:, k]

    for k in range(model.log_radiance_sh.shape[1]):
        yield LOG_SH[k], model.log_radiance_sh[:, k]
    if model.light_share is not None:
        for index in range(len(model.lights)):
            yield LIGHT_SHARE[index], model.light_share[:, index]
    if model.level_log_gain is not None:
        for index, gain in enumerate(model.level_log_gain):
            yield LEVEL_LOG_GAIN[index], gain
    if model.confidence is not None:
        yield CONFIDENCE, model.confidence


def _shown_sh(model: Model) -> np.ndarray:
    """What Blender shows by itself: the model under the light of its standard photographs."""
    log_radiance_sh = model.log_radiance_sh
    if any(level != 1.0 for level in model.standard_levels):
        log_radiance_sh = np.array(log_radiance_sh)
        log_radiance_sh[:, 0] += model.log_gain(model.standard_levels) / np.float32(C0)
    return native_splats.shown_sh(log_radiance_sh)


def build_point_cloud(model: Model, name: str, colour_sh: np.ndarray | None = None) -> bpy.types.PointCloud:
    """A point cloud data-block with all attributes and, as custom properties, where the model is from.

    ``colour_sh``: as for ``attributes_of``.
    """
    cloud = bpy.data.pointclouds.new(name)
    cloud.resize(model.count)
    for attribute, values in attributes_of(model, colour_sh):
        write_attribute(cloud, attribute, values)
    for key, value in _provenance(model).items():
        cloud[key] = value
    return cloud


def write_attribute(cloud: bpy.types.PointCloud, attribute: Attribute, values: np.ndarray) -> None:
    """Create or overwrite one attribute of every point with ``values`` ``[N, width]``."""
    width, key = TYPES[attribute.type]
    flat = np.ascontiguousarray(values, np.float32).reshape(-1)
    if flat.size != width * len(cloud.points):
        raise ValueError(f"{attribute.name}: {flat.size} numbers for {len(cloud.points)} points of {width}")
    # Each type of attribute is a class of its own, which has ``data``; what they have in common has not.
    target: Any = cloud.attributes.get(attribute.name)
    if target is None:
        target = cloud.attributes.new(attribute.name, attribute.type, "POINT")
    target.data.foreach_set(key, flat)


def read_attribute(cloud: bpy.types.PointCloud, name: str) -> np.ndarray:
    """``[N]`` or ``[N, width]`` float32 values of an attribute; ``KeyError`` where there is none."""
    attribute: Any = cloud.attributes[name]
    width, key = TYPES[attribute.data_type]
    values = np.empty(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get(key, values)
    return values if width == 1 else values.reshape(-1, width)


def read_numbered(cloud: bpy.types.PointCloud, numbered: Numbered) -> list[np.ndarray]:
    """The values of the attributes with the numbers 0, 1, … as far as there are."""
    names = (numbered[index].name for index in itertools.count())
    there = itertools.takewhile(lambda name: name in cloud.attributes, names)
    return [read_attribute(cloud, name) for name in there]


def lights_of(cloud: bpy.types.PointCloud) -> tuple[str, ...]:
    """The names of the lights of a model's point cloud: the ambient one alone where none are stated.

    Raises ``DataMismatchError`` where they were edited into something else.
    """
    stated = cloud.get(LIGHTS)
    if stated is None:
        return (AMBIENT,)
    try:
        return check_lights(json.loads(stated), f"the point cloud {cloud.name!r}")
    except (TypeError, ValueError, BadValueError) as error:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r} has {LIGHTS} = {stated!r}, which is not a list of lights",
            "Undo the edit, or import the model again.",
        ) from error


def read_shares(cloud: bpy.types.PointCloud) -> list[np.ndarray]:
    """``[N, 3]`` float32 shares of each of ``lights_of(cloud)``; ``KeyError`` where one is missing."""
    return [read_attribute(cloud, LIGHT_SHARE[index].name) for index in range(len(lights_of(cloud)))]


def read_levels(cloud: bpy.types.PointCloud) -> tuple[float, ...]:
    """The levels of a baked-levels model; empty for the additive modulator."""
    return tuple(float(level) for level in cloud.get(LEVELS, ()))


def read_tone_curve(cloud: bpy.types.PointCloud) -> ToneCurve | None:
    """The learned response that came with the model, if any."""
    places, values = cloud.get(TONE_CURVE_LOG_EXPOSURE), cloud.get(TONE_CURVE)
    if places is None or values is None:
        return None
    return ToneCurve(np.array(places, np.float32), np.array(values, np.float32).reshape(-1, 3))


def model_of(cloud: bpy.types.PointCloud) -> Model:
    """The model that a point cloud holds now, edits included.

    Raises ``DataMismatchError`` where it has not the attributes of a model, and what ``Model`` raises for
    their values.
    """
    try:
        base = read_attribute(cloud, BASE.name)
        position, scale, rotation = (read_attribute(cloud, a.name) for a in (POSITION, SCALE, ROTATION))
        sh = read_numbered(cloud, LOG_SH)
        levels = read_levels(cloud)
        light: dict[str, Any]
        if levels:
            names = [LEVEL_LOG_GAIN[index].name for index in range(len(levels))]
            light = {"level_log_gain": np.stack([read_attribute(cloud, name) for name in names])}
        else:
            light = {"light_share": np.stack(read_shares(cloud), axis=1), "lights": lights_of(cloud)}
    except KeyError as error:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r} is no PhysHDR model: {error.args[0]}",
            "Choose an imported model, or import it again.",
        ) from error
    if curve := read_tone_curve(cloud):
        light |= {"tone_curve_log_exposure": curve.log_exposure, "tone_curve": curve.values}
    if CONFIDENCE.name in cloud.attributes:
        # Whatever an edit made of it, it is a probability.
        light["confidence"] = read_attribute(cloud, CONFIDENCE.name).clip(0.0, 1.0)
    metadata = {
        key: str(cloud[metadata_property(key)]) for key in METADATA if metadata_property(key) in cloud
    }
    return Model(
        position=position,
        scale=scale,
        rotation=rotation,
        opacity=np.ascontiguousarray(base[:, 3]),
        # [N, K, 3] in memory order K: as it is read, and as it is worked on.
        log_radiance_sh=np.array(sh).reshape(len(sh), -1, 3).transpose(1, 0, 2),
        levels=levels,
        **light,
        exposures=tuple(float(seconds) for seconds in cloud.get(EXPOSURES, ())),
        metadata=metadata,
        cameras=cameras_in(cloud),
    )


def cameras_in(cloud: bpy.types.PointCloud) -> tuple[ListedCamera, ...]:
    """The cameras that came with the model, in its space.

    Raises ``DataMismatchError`` where they were edited into something else.
    """
    try:
        return cameras_of(json.loads(str(cloud.get(CAMERAS, "[]"))), Path(cloud.name), "")
    except (ValueError, FileDamagedError) as error:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r} has {CAMERAS} that are not a list of cameras",
            "Undo the edit, or import the model again.",
        ) from error


def photographed_ev_of(target: bpy.types.Object) -> float:
    """The EV at which a model looks as its photographs; 0 where it is of none."""
    stored = cloud_of(target).get(metadata_property(PHOTOGRAPHED_EV), "")
    return photographed_ev({PHOTOGRAPHED_EV: str(stored)})


def photographed_light_of(cloud: bpy.types.PointCloud) -> tuple[PhotographedLight, ...]:
    """The light that a model's photographs were taken under, the standard one first.

    Raises ``DataMismatchError`` where it was edited into something else.
    """
    stored = cloud.get(metadata_property(PHOTOGRAPHED_LIGHT))
    try:
        return photographed_light({} if stored is None else {PHOTOGRAPHED_LIGHT: str(stored)})
    except BadValueError as error:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r}: {error.message}", "Undo the edit, or import the model again."
        ) from error


def _provenance(model: Model) -> dict[str, Any]:
    # Others' entries have names that properties cannot have, or that ours have.
    there = (key for key in METADATA if key in model.metadata)
    properties: dict[str, Any] = {metadata_property(key): model.metadata[key] for key in there}
    properties |= {
        IDENTITY: uuid.uuid4().hex,
        MODULATOR: model.modulator,
        SH_DEGREE: model.sh_degree,
        LIGHTS: json.dumps(list(model.lights)),
        LEVELS: list(model.levels),
        EXPOSURES: list(model.exposures),
    }
    if model.cameras:
        properties[CAMERAS] = camera_text(model.cameras)
    if model.tone_curve is not None and model.tone_curve_log_exposure is not None:
        properties[TONE_CURVE_LOG_EXPOSURE] = model.tone_curve_log_exposure.tolist()
        properties[TONE_CURVE] = model.tone_curve.reshape(-1).tolist()
    return properties
