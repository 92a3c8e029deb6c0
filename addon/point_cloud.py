# SPDX-License-Identifier: GPL-3.0-or-later
"""A model as a point cloud: one row of a table for each attribute (docs/formats.md, names as Blender 5.3)."""

import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..bridge import spherical_harmonics
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


@dataclass(frozen=True, eq=False)
class Attribute:
    """A point attribute: its name, its type (a key of ``TYPES``) and its values ``[N, width]``."""

    name: str
    type: str
    values: np.ndarray


def attributes_of(model: Model) -> Iterator[Attribute]:
    """The attributes of a model, one at a time: together they are larger than the model."""
    yield Attribute("position", "FLOAT_VECTOR", model.position)
    yield Attribute("scale", "FLOAT_VECTOR", model.scale)
    length = np.linalg.norm(model.rotation, axis=1, keepdims=True)
    yield Attribute("rotation", "QUATERNION", model.rotation / length)

    linear_sh = spherical_harmonics.fit_linear(model.log_radiance_sh)
    # 3DGS, and so Blender 5.3, shows 0.5 + Σ sh_k Y_k.
    base = np.column_stack([linear_sh[:, 0] - 0.5 / spherical_harmonics.C0, model.opacity])
    yield Attribute("radiance:base", "FLOAT4", base)
    for k in range(1, linear_sh.shape[1]):
        yield Attribute(f"radiance:sh_{k - 1}", "FLOAT_VECTOR", linear_sh[:, k])

    for k in range(model.log_radiance_sh.shape[1]):
        yield Attribute(f"physhdr:log_sh_{k}", "FLOAT_VECTOR", model.log_radiance_sh[:, k])
    if model.ambient_share is not None:
        yield Attribute("physhdr:ambient_share", "FLOAT_VECTOR", model.ambient_share)
    if model.level_log_gain is not None:
        for index, gain in enumerate(model.level_log_gain):
            yield Attribute(f"physhdr:level_log_gain_{index}", "FLOAT_VECTOR", gain)


def build_point_cloud(model: Model, name: str) -> bpy.types.PointCloud:
    """A point cloud data-block with all attributes and, as custom properties, where the model is from."""
    cloud = bpy.data.pointclouds.new(name)
    cloud.resize(model.count)
    for attribute in attributes_of(model):
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


def _provenance(model: Model) -> dict[str, Any]:
    properties: dict[str, Any] = {f"physhdr_{key}": value for key, value in model.metadata.items()}
    properties |= {
        IDENTITY: uuid.uuid4().hex,
        "physhdr_modulator": model.modulator,
        "physhdr_sh_degree": model.sh_degree,
        "physhdr_levels": list(model.levels),
        "physhdr_exposures": list(model.exposures),
    }
    if model.tone_curve is not None and model.tone_curve_log_exposure is not None:
        properties["physhdr_tone_curve_log_exposure"] = model.tone_curve_log_exposure.tolist()
        properties["physhdr_tone_curve"] = model.tone_curve.reshape(-1).tolist()
    return properties
