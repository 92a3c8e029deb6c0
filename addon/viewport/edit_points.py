# SPDX-License-Identifier: GPL-3.0-or-later
"""The points of a model in Edit Mode, over its Gaussians: Blender's own lie beneath the picture."""

import zlib
from contextlib import AbstractContextManager
from typing import Any, cast

import bpy
import gpu
import numpy as np
from mathutils import Matrix

from ..model.attributes import POSITION
from ..model.point_cloud import read_attribute

#: Pixels of a point: many in one place stay a picture.
SIZE = 2.0
#: The opacity of a point that is not selected.
FAINT_ALPHA = 0.35


def checksum(values: np.ndarray) -> int:
    """Another number for another selection (1 M points: 1 ms)."""
    return zlib.crc32(np.packbits(values).tobytes())


class EditPoints:
    """The points of one cloud on the GPU."""

    def __init__(self, cloud: bpy.types.PointCloud, selected: np.ndarray) -> None:
        position = read_attribute(cloud, POSITION.name)
        self._shader = gpu.shader.from_builtin("POINT_UNIFORM_COLOR")
        self._selected = _batch(position[selected])
        self._others = _batch(position[~selected])

    def draw(self, matrix_world: np.ndarray, theme: bpy.types.ThemeView3D) -> None:
        """Into the region that is being drawn: selected ones over everything, others behind its objects."""
        rows: Any = matrix_world.tolist()
        others, selected = (_components(colour) for colour in (theme.vertex, theme.vertex_select))
        with cast(AbstractContextManager[None], gpu.matrix.push_pop()):
            gpu.matrix.multiply_matrix(Matrix(rows))
            gpu.state.blend_set("ALPHA")
            gpu.state.depth_mask_set(False)
            self._shader.bind()
            if self._others is not None:
                gpu.state.depth_test_set("LESS_EQUAL")
                gpu.state.point_size_set(SIZE)
                self._shader.uniform_float("color", (*others, FAINT_ALPHA))
                self._others.draw(self._shader)
            if self._selected is not None:
                gpu.state.depth_test_set("NONE")
                gpu.state.point_size_set(SIZE)
                self._shader.uniform_float("color", (*selected, 1.0))
                self._selected.draw(self._shader)
            gpu.state.point_size_set(1.0)
            gpu.state.depth_test_set("NONE")
            gpu.state.blend_set("NONE")


def _components(colour: Any) -> tuple[float, float, float]:
    return colour[0], colour[1], colour[2]


def _batch(position: np.ndarray) -> gpu.types.GPUBatch | None:
    if not len(position):
        return None
    format = gpu.types.GPUVertFormat()
    format.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(format, len(position))
    values: Any = np.ascontiguousarray(position, np.float32)
    vertices.attr_fill("pos", values)
    return gpu.types.GPUBatch(type="POINTS", buf=vertices)
