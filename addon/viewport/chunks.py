# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians in chunks of neighbours, so that a view leaves out at once what it cannot show. numpy alone.

Whether a chunk may reach into a picture is decided as the splats are drawn (backend/rasterize/contract.py),
not as ellipsoids are: a splat's extent in pixels is at most reach · (f k σ / z + √low pass), where k is the
largest length of a row of the projection's Jacobian at focal length 1 and depth 1, which the contract limits.
So a picture never changes by what is left out.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, LOW_PASS, NEAR_PLANE
from .camera import ViewCamera

#: Gaussians in a chunk. A million in a room are 2000 chunks of a few decimetres.
CHUNK = 512
#: Standard deviations to where the alpha of an opaque Gaussian is 1/255.
REACH = math.sqrt(-2.0 * math.log(ALPHA_MIN))
#: Bits of a coordinate in a Morton code: 30 in all, what sorts fast.
_BITS = 10


@dataclass(frozen=True, eq=False)
class Chunks:
    """Of each chunk, in the object's space: a ball around its centres, and its largest standard deviation."""

    centre: np.ndarray
    radius: np.ndarray
    deviation: np.ndarray

    def visible(self, camera: ViewCamera, to_camera: np.ndarray) -> np.ndarray:
        """Indices of the chunks that may show something. ``to_camera``: ``[4, 4]``, ``object_to_camera``."""
        centre = self.centre @ to_camera[:3, :3].T + to_camera[:3, 3]
        size = float(np.linalg.norm(to_camera[:3, :3], ord=2))
        radius, deviation = size * self.radius, size * self.deviation
        seen = np.ones(len(centre), bool)
        if not camera.is_orthographic:
            seen &= centre[:, 2] + radius >= NEAR_PLANE
        for axis, (focal, middle, pixels) in enumerate(
            ((camera.fx, camera.cx, camera.width), (camera.fy, camera.cy, camera.height))
        ):
            blur = REACH * math.sqrt(LOW_PASS)
            margin = JACOBIAN_MARGIN * 0.5 * pixels / focal
            lower, upper = middle + blur, pixels - middle + blur
            steepest = 0.0
            if not camera.is_orthographic:
                steepest = margin + max(abs(middle), abs(pixels - middle)) / focal
            splat = REACH * focal * math.sqrt(1.0 + steepest * steepest) * deviation
            for sign, border in ((1.0, lower), (-1.0, upper)):
                across = sign * focal * centre[:, axis]
                if camera.is_orthographic:
                    seen &= across + border + focal * radius >= -splat
                else:
                    length = math.hypot(focal, border)
                    seen &= across + border * centre[:, 2] + length * radius >= -splat
        return np.flatnonzero(seen)


def morton_order(position: np.ndarray) -> np.ndarray:
    """Indices ``[N]`` that bring positions ``[N, 3]`` into an order in which neighbours are near."""
    if not len(position):
        return np.empty(0, np.int64)
    # Between quantiles: a few Gaussians far away must not take all the bits.
    some = position[:: max(1, len(position) // 65536)]
    low, high = np.quantile(some, (0.01, 0.99), axis=0)
    extent = np.maximum(high - low, 1e-9)
    steps = np.clip((position - low) / extent * (2**_BITS - 1), 0, 2**_BITS - 1).astype(np.uint32)
    code = np.zeros(len(position), np.uint32)
    for axis in range(3):
        code |= _spread(steps[:, axis]) << np.uint32(axis)
    # Two radix sorts of 16 bits, the lower ones first.
    order = np.argsort((code & np.uint32(0xFFFF)).astype(np.uint16), kind="stable")
    return order[np.argsort((code >> np.uint32(16)).astype(np.uint16)[order], kind="stable")]


def chunks_of(position: np.ndarray, scale: np.ndarray) -> Chunks:
    """The chunks of positions ``[N, 3]`` and standard deviations ``[N, 3]``, ``CHUNK`` after ``CHUNK``."""
    count = math.ceil(len(position) / CHUNK)
    if not count:
        return Chunks(np.empty((0, 3)), np.empty(0), np.empty(0))
    starts = np.arange(count) * CHUNK
    low = np.minimum.reduceat(position, starts, axis=0).astype(np.float64)
    high = np.maximum.reduceat(position, starts, axis=0).astype(np.float64)
    deviation = np.maximum.reduceat(scale.max(axis=1), starts).astype(np.float64)
    # float32 positions go through float32 matrices on the GPU: a little more than the box's own.
    radius = 0.5 * np.linalg.norm(high - low, axis=1) * (1.0 + 1e-6) + 1e-6 * np.abs(high).max(axis=1)
    return Chunks(0.5 * (low + high), radius, deviation)


def _spread(values: np.ndarray) -> np.ndarray:
    """Two zero bits after each of the lower ten bits."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        values = (values | (values << np.uint32(shift))) & np.uint32(mask)
    return values
