# SPDX-License-Identifier: GPL-3.0-or-later
"""A lens whose corners are darker: the share v of the light that arrives at the angle θ to the camera's axis.

v is a function of ρ = tan²θ over its largest, so that a picture at half its size, a crop and a portrait of
one lens have the same one, whatever their principal point:

    ln v = −(a₁ ln(1 + ρ) + a₂ ρ + a₃ ρ³)

With a ≥ 0 it is 1 on the axis and never rises. The first two are near cos⁴'s law (the wider the lens the
nearer to the first), the third is what a tube or a filter cuts off.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch

from ..scene.camera import Camera

#: How many numbers a lens's falloff has.
COEFFICIENTS = 3
#: Lenses are told apart where their focal lengths, over the picture's diagonal, differ by more than this.
FOCAL_STEP = 1.05


def falloff(rho: torch.Tensor, coefficients: torch.Tensor) -> torch.Tensor:
    """ln v of ρ, of any shape; ``coefficients`` ``[3]``."""
    a, b, c = coefficients.unbind()
    return -(a * rho.log1p() + b * rho + c * rho**3)


def falloff_terms(rho: np.ndarray) -> np.ndarray:
    """``[…, 3]``: what the coefficients multiply in −ln v, of ρ of any shape."""
    return np.stack([np.log1p(rho), rho, rho**3], axis=-1)


def squared_tangent(camera: Camera, like: torch.Tensor) -> torch.Tensor:
    """tan²θ at each pixel's centre, ``[H, W]`` with dtype and device of ``like``."""

    def axis(size: int, centre: float, focal: float) -> torch.Tensor:
        pixels = torch.arange(size, dtype=like.dtype, device=like.device)
        return ((pixels + (0.5 - centre)) / focal).square()

    return axis(camera.height, camera.cy, camera.fy)[:, None] + axis(camera.width, camera.cx, camera.fx)


def widest(camera: Camera) -> float:
    """The largest tan²θ of a corner of the picture."""
    x = max(camera.cx, camera.width - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - camera.cy) / camera.fy
    return x * x + y * y


def lenses(cameras: Sequence[Camera]) -> list[int]:
    """Which lens each camera has, numbered from 0: those of one relative focal length share one."""
    relative = [c.fx / math.hypot(c.width, c.height) for c in cameras]
    order = sorted(range(len(cameras)), key=relative.__getitem__)
    numbers, lens = [0] * len(cameras), 0
    for before, this in itertools.pairwise(order):
        lens += relative[this] > relative[before] * FOCAL_STEP
        numbers[this] = lens
    return numbers
