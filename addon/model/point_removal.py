# SPDX-License-Identifier: GPL-3.0-or-later
"""Points are taken out of a point cloud with all that they carry, in Object and in Edit Mode."""

from typing import Any

import bpy
import numpy as np

#: What Edit Mode keeps its selection in.
SELECTION = ".selection"

#: Blender's attribute type → (numbers a point, what they are, property that ``foreach_set`` fills).
_TYPES: dict[str, tuple[int, type, str]] = {
    "FLOAT": (1, np.float32, "value"),
    "INT": (1, np.int32, "value"),
    "INT8": (1, np.int32, "value"),
    "BOOLEAN": (1, np.bool_, "value"),
    "FLOAT2": (2, np.float32, "vector"),
    "FLOAT_VECTOR": (3, np.float32, "vector"),
    "FLOAT4": (4, np.float32, "vector"),
    "INT16_2D": (2, np.int32, "value"),
    "INT32_2D": (2, np.int32, "value"),
    "QUATERNION": (4, np.float32, "value"),
    "FLOAT_COLOR": (4, np.float32, "color"),
    "BYTE_COLOR": (4, np.float32, "color_srgb"),
    "FLOAT4X4": (16, np.float32, "value"),
}


def keep_points(cloud: bpy.types.PointCloud, keep: np.ndarray) -> None:
    """Leave only the points of bool ``[N]``, in their order, with every attribute that numbers can hold."""
    count = int(keep.sum())
    compacted: list[tuple[str, str, np.ndarray]] = []
    for attribute in cloud.attributes:
        if attribute.data_type not in _TYPES:
            continue
        width, kind, key = _TYPES[attribute.data_type]
        values = np.empty(len(keep) * width, kind)
        _data(cloud, attribute.name).foreach_get(key, values)
        compacted.append((attribute.name, key, values.reshape(-1, width)[keep].reshape(-1)))
    cloud.resize(count)
    for name, key, values in compacted:
        _data(cloud, name).foreach_set(key, values)
    cloud.update_tag()


def selection_of(cloud: bpy.types.PointCloud) -> np.ndarray:
    """Bool ``[N]``: what is selected in Edit Mode; everything where nobody selected yet."""
    attribute = cloud.attributes.get(SELECTION)
    if attribute is None:
        return np.ones(len(cloud.points), bool)
    selected = np.empty(len(cloud.points), _TYPES[attribute.data_type][1])
    _data(cloud, SELECTION).foreach_get("value", selected)
    return selected.astype(bool)


def select_points(cloud: bpy.types.PointCloud, selected: np.ndarray) -> None:
    """Select the points of bool ``[N]`` and no others."""
    if SELECTION not in cloud.attributes:
        cloud.attributes.new(SELECTION, "BOOLEAN", "POINT")
    kind = _TYPES[cloud.attributes[SELECTION].data_type][1]
    _data(cloud, SELECTION).foreach_set("value", np.ascontiguousarray(selected, kind))
    cloud.update_tag()


def _data(cloud: bpy.types.PointCloud, name: str) -> Any:
    attribute: Any = cloud.attributes[name]  # each type of attribute is a class of its own
    return attribute.data
