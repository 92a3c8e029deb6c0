# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a ray meets a model: at the depth at which half of the light from behind is gone. numpy alone."""

import numpy as np

from ...bridge.affine import matrices_of
from ...bridge.splatting import ALPHA_MAX, ALPHA_MIN

#: The share of the light that must be gone for the ray to have met something.
OPAQUE = 0.5


def surface_along_ray(
    origin: np.ndarray,
    direction: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    scale: np.ndarray,
    opacity: np.ndarray,
) -> float | None:
    """How many ``direction`` s from ``origin`` the surface lies; None where the ray meets none.

    All ``[3]``, and Gaussians as in a model: ``[N, 3]``, ``[N, 4]`` wxyz, ``[N, 3]`` metres, ``[N]``. Each
    counts with its alpha where the ray passes it nearest, in its own measure, at that place of the ray.
    """
    origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    length = np.linalg.norm(direction)
    # First those whose largest reach comes near the ray at all: a millionth of the rest would do no harm.
    offset = position - origin
    beside = np.linalg.norm(offset - np.outer(offset @ direction, direction / length**2), axis=1)
    reach = np.sqrt(2.0 * np.log(np.maximum(opacity / ALPHA_MIN, 1.0))) * scale.max(axis=1)
    near = np.flatnonzero(beside <= reach)
    if near.size == 0:
        return None
    quaternions = rotation[near] / np.linalg.norm(rotation[near], axis=1, keepdims=True)
    # Rows are the Gaussian's axes over their deviations: there it is a unit ball.
    to_ball = matrices_of(quaternions).transpose(0, 2, 1) / np.maximum(scale[near], 1e-12)[:, :, None]
    start = np.einsum("nij,nj->ni", to_ball, -offset[near])
    heading = np.einsum("nij,j->ni", to_ball, direction)
    along = -np.einsum("ni,ni->n", start, heading) / np.einsum("ni,ni->n", heading, heading)
    closest = start + along[:, None] * heading
    alpha = opacity[near] * np.exp(-0.5 * np.einsum("ni,ni->n", closest, closest))
    alpha = np.where((alpha < ALPHA_MIN) | (along <= 0.0), 0.0, np.minimum(alpha, ALPHA_MAX))
    order = np.argsort(along)
    left = np.cumprod(1.0 - alpha[order])
    met = np.flatnonzero(left <= 1.0 - OPAQUE)
    return float(along[order[met[0]]]) if met.size else None
