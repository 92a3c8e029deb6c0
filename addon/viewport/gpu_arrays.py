# SPDX-License-Identifier: GPL-3.0-or-later
"""numpy arrays to and from the GPU, and the small things that every shader here needs.

Blender's types do not say that its functions take numpy's arrays, nor that ``bind`` is for ``with``.
"""

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Literal, cast

import gpu
import mathutils
import numpy as np

#: What a texture holds.
Texels = Literal["RGBA32F", "RGBA16F", "R32F"]


def bound(framebuffer: gpu.types.GPUFrameBuffer) -> AbstractContextManager[Any]:
    """Draw into ``framebuffer`` within a ``with``, and afterwards into the one before."""
    return cast(Any, framebuffer.bind())


def set_matrix(shader: gpu.types.GPUShader, name: str, array: np.ndarray) -> None:
    """Set a shader's uniform to a ``[4, 4]`` array."""
    matrix: Any = mathutils.Matrix(np.asarray(array, np.float64).tolist())
    shader.uniform_float(name, matrix)


def texture(array: np.ndarray, format: Texels) -> gpu.types.GPUTexture:
    """A 2D texture of ``[H, W, C]``, or a 2D array texture of ``[L, H, W, C]``; row 0 is the first row.

    ``C`` must be that of ``format``; half formats take float32, too: the driver converts. (Blender uploads
    nothing but floats.)
    """
    *layers, height, width, _ = array.shape
    # No copy: the buffer borrows the array's memory, and the upload is done when this returns.
    values: Any = np.ascontiguousarray(array, np.float32).reshape(-1)
    data = gpu.types.Buffer("FLOAT", array.size, values)
    return gpu.types.GPUTexture((width, height), layers=layers[0] if layers else 0, format=format, data=data)


def read_colour(
    framebuffer: gpu.types.GPUFrameBuffer, size: tuple[int, int], slot: int = 0, channels: int = 4
) -> np.ndarray:
    """``[H, W, channels]`` float32 of a colour attachment, top row first. Waits for the GPU.

    ``channels``: as many as the attachment has; with Vulkan other numbers give rubbish.
    """
    width, height = size
    with bound(framebuffer):
        data: Any = framebuffer.read_color(0, 0, width, height, channels, slot, "FLOAT")
    data.dimensions = width * height * channels
    return np.array(data, np.float32).reshape(height, width, channels)[::-1]


def triangles(count: int) -> gpu.types.GPUBatch:
    """``count`` times the triangle around the unit circle: 3 vertices with the attribute ``corner``."""
    corners = np.array([(0.0, 2.0), (-math.sqrt(3.0), -1.0), (math.sqrt(3.0), -1.0)], np.float32)
    indices: Any = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return batch("TRIS", np.tile(corners, (count, 1)), gpu.types.GPUIndexBuf(type="TRIS", seq=indices))


def batch(
    kind: Literal["TRIS", "TRI_STRIP"],
    corners: Sequence[tuple[float, float]] | np.ndarray,
    indices: gpu.types.GPUIndexBuf | None = None,
) -> gpu.types.GPUBatch:
    """A batch with one vertex attribute ``corner`` (VEC2)."""
    format = gpu.types.GPUVertFormat()
    format.attr_add(id="corner", comp_type="F32", len=2, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(format, len(corners))
    vertices.attr_fill("corner", cast(Any, corners))
    if indices is None:
        return gpu.types.GPUBatch(type=kind, buf=vertices)
    return gpu.types.GPUBatch(type=kind, buf=vertices, elem=indices)
