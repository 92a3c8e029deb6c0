# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as a point cloud: one row of a table for each attribute (docs/formats.md, names as Blender 5.3)."""

import itertools
import json
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..bridge import spherical_harmonics
from ..bridge.errors import BadValueError, DataMismatchError
from ..bridge.lights import AMBIENT, check_lights
from ..bridge.model_file import Model

#: Blender's attribute type → (numbers a point, property that ``foreach_set`` fills).
TYPES: dict[str, tuple[int, str]] = {
    "FLOAT": (1, "value"),
    "FLOAT_VECTOR": (3, "vector"),
    "FLOAT4": (4, "vector"),
    "FLOAT_COLOR": (4, "color"),
    "QUATERNION": (4, "value"),
}

#: Custom property with the model's identity; survives undo, copies and appending, unlike a reference.
IDENTITY = "physhdr_uuid"
#: Custom property: the names of the lights, as JSON (Blender has no lists of texts).
LIGHTS = "physhdr_lights"
#: The ambient light's share in .blend files of before there were other lights.
OLD_SHARE_ATTRIBUTE = "physhdr:ambient_share"
#: Where a model is from; kept as ``physhdr_…`` custom properties.
METADATA = ("scene", "method", "iteration")


@dataclass(frozen=True, eq=False)
class Attribute:
    """A point attribute: its name, its type (a key of ``TYPES``) and its values ``[N, width]``."""

    name: str
    type: str
    values: np.ndarray


def share_attribute(index: int) -> str:
    """The attribute with the share of the radiance that a light causes."""
    return f"physhdr:light_share_{index}"


def attributes_of(model: Model, colour_sh: np.ndarray | None = None) -> Iterator[Attribute]:
    """The attributes of a model, one at a time: together they are larger than the model.

    ``colour_sh`` ``[N, K, 3]``: the colours of the PLY that the model was made from. They become Blender
    5.3's attributes as they are, as if it had imported the file; a model of ours gives it linear radiance.
    """
    yield Attribute("position", "FLOAT_VECTOR", model.position)
    yield Attribute("scale", "FLOAT_VECTOR", model.scale)
    length = np.linalg.norm(model.rotation, axis=1, keepdims=True)
    yield Attribute("rotation", "QUATERNION", model.rotation / length)

    shown_sh = colour_sh
    if shown_sh is None:
        shown_sh = spherical_harmonics.fit_linear(model.log_radiance_sh)
        # 3DGS, and so Blender 5.3, shows 0.5 + Σ sh_k Y_k.
        shown_sh[:, 0] -= np.float32(0.5 / spherical_harmonics.C0)
    yield Attribute("radiance:base", "FLOAT4", np.column_stack([shown_sh[:, 0], model.opacity]))
    for k in range(1, shown_sh.shape[1]):
        yield Attribute(f"radiance:sh_{k - 1}", "FLOAT_VECTOR", shown_sh[:, k])

    for k in range(model.log_radiance_sh.shape[1]):
        yield Attribute(f"physhdr:log_sh_{k}", "FLOAT_VECTOR", model.log_radiance_sh[:, k])
    if model.light_share is not None:
        for index in range(len(model.lights)):
            yield Attribute(share_attribute(index), "FLOAT_VECTOR", model.light_share[:, index])
    if model.level_log_gain is not None:
        for index, gain in enumerate(model.level_log_gain):
            yield Attribute(f"physhdr:level_log_gain_{index}", "FLOAT_VECTOR", gain)


def build_point_cloud(model: Model, name: str, colour_sh: np.ndarray | None = None) -> bpy.types.PointCloud:
    """A point cloud data-block with all attributes and, as custom properties, where the model is from.

    ``colour_sh``: as for ``attributes_of``.
    """
    cloud = bpy.data.pointclouds.new(name)
    cloud.resize(model.count)
    for attribute in attributes_of(model, colour_sh):
        write_attribute(cloud, attribute)
    for key, value in _provenance(model).items():
        cloud[key] = value
    return cloud


def write_attribute(cloud: bpy.types.PointCloud, attribute: Attribute) -> None:
    """Create or overwrite one attribute of every point."""
    width, key = TYPES[attribute.type]
    values = np.ascontiguousarray(attribute.values, np.float32).reshape(-1)
    if values.size != width * len(cloud.points):
        raise ValueError(f"{attribute.name}: {values.size} numbers for {len(cloud.points)} points of {width}")
    target = cloud.attributes.get(attribute.name)
    if target is None:
        target = cloud.attributes.new(attribute.name, attribute.type, "POINT")
    target.data.foreach_set(key, values)


def read_attribute(cloud: bpy.types.PointCloud, name: str) -> np.ndarray:
    """``[N]`` or ``[N, width]`` float32 values of an attribute; ``KeyError`` where there is none."""
    attribute = cloud.attributes[name]
    width, key = TYPES[attribute.data_type]
    values = np.empty(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get(key, values)
    return values if width == 1 else values.reshape(-1, width)


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
            f"the point cloud {cloud.name!r} has {LIGHTS} = {stated!r}, which is no list of lights",
            "Undo the edit, or import the model again.",
        ) from error


def read_shares(cloud: bpy.types.PointCloud) -> list[np.ndarray]:
    """``[N, 3]`` float32 shares of each of ``lights_of(cloud)``; ``KeyError`` where one is missing."""
    count = len(lights_of(cloud))
    if count == 1 and share_attribute(0) not in cloud.attributes and OLD_SHARE_ATTRIBUTE in cloud.attributes:
        return [read_attribute(cloud, OLD_SHARE_ATTRIBUTE)]
    return [read_attribute(cloud, share_attribute(index)) for index in range(count)]


def model_of(cloud: bpy.types.PointCloud) -> Model:
    """The model that a point cloud holds now, edits included.

    Raises ``DataMismatchError`` where it has not the attributes of a model, and what ``Model`` raises for
    their values.
    """
    try:
        base = read_attribute(cloud, "radiance:base")
        arrays = {name: read_attribute(cloud, name) for name in ("position", "scale", "rotation")}
        sh = [read_attribute(cloud, f"physhdr:log_sh_{k}") for k in range(_count(cloud, "physhdr:log_sh_"))]
        levels = tuple(float(level) for level in cloud.get("physhdr_levels", ()))
        light: dict[str, Any]
        if levels:
            names = [f"physhdr:level_log_gain_{index}" for index in range(len(levels))]
            light = {"level_log_gain": np.stack([read_attribute(cloud, name) for name in names])}
        else:
            light = {"light_share": np.stack(read_shares(cloud), axis=1), "lights": lights_of(cloud)}
    except KeyError as error:
        raise DataMismatchError(
            f"the point cloud {cloud.name!r} is no PhysHDR model: {error.args[0]}",
            "Choose an imported model, or import it again.",
        ) from error
    places, curve = cloud.get("physhdr_tone_curve_log_exposure"), cloud.get("physhdr_tone_curve")
    if places is not None and curve is not None:
        light["tone_curve_log_exposure"] = np.array(places, np.float32)
        light["tone_curve"] = np.array(curve, np.float32).reshape(-1, 3)
    metadata = {key: str(cloud[f"physhdr_{key}"]) for key in METADATA if f"physhdr_{key}" in cloud}
    return Model(
        **arrays,
        opacity=np.ascontiguousarray(base[:, 3]),
        # [N, K, 3] in memory order K: as it is read, and as it is worked on.
        log_radiance_sh=np.array(sh).reshape(len(sh), -1, 3).transpose(1, 0, 2),
        levels=levels,
        **light,
        exposures=tuple(float(seconds) for seconds in cloud.get("physhdr_exposures", ())),
        metadata=metadata,
    )


def _count(cloud: bpy.types.PointCloud, prefix: str) -> int:
    """How many attributes ``prefix0``, ``prefix1``, … there are."""
    return next(k for k in itertools.count() if f"{prefix}{k}" not in cloud.attributes)


def _provenance(model: Model) -> dict[str, Any]:
    properties: dict[str, Any] = {f"physhdr_{key}": value for key, value in model.metadata.items()}
    properties |= {
        IDENTITY: uuid.uuid4().hex,
        "physhdr_modulator": model.modulator,
        "physhdr_sh_degree": model.sh_degree,
        LIGHTS: json.dumps(list(model.lights)),
        "physhdr_levels": list(model.levels),
        "physhdr_exposures": list(model.exposures),
    }
    if model.tone_curve is not None and model.tone_curve_log_exposure is not None:
        properties["physhdr_tone_curve_log_exposure"] = model.tone_curve_log_exposure.tolist()
        properties["physhdr_tone_curve"] = model.tone_curve.reshape(-1).tolist()
    return properties
