# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics with the signs and the order of 3D Gaussian splatting (degree 0 to 3).

A direction is the unit vector **from the camera to the Gaussian** (3DGS, gsplat). The basis is
orthonormal on the sphere. Coefficients are ordered by degree, then by order −l … l, so the first
(l+1)² of them are a complete basis of degree l.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from .cores import usable_cores

MAX_DEGREE = 3

#: Normalisation constants, as in 3DGS (``utils/sh_utils.py``), here in closed form. Signs included.
C0 = 0.5 / math.sqrt(math.pi)
C1 = math.sqrt(3.0 / (4.0 * math.pi))
C2 = (
    0.5 * math.sqrt(15.0 / math.pi),
    -0.5 * math.sqrt(15.0 / math.pi),
    0.25 * math.sqrt(5.0 / math.pi),
    -0.5 * math.sqrt(15.0 / math.pi),
    0.25 * math.sqrt(15.0 / math.pi),
)
C3 = (
    -0.25 * math.sqrt(35.0 / (2.0 * math.pi)),
    0.5 * math.sqrt(105.0 / math.pi),
    -0.25 * math.sqrt(21.0 / (2.0 * math.pi)),
    0.25 * math.sqrt(7.0 / math.pi),
    -0.25 * math.sqrt(21.0 / (2.0 * math.pi)),
    0.25 * math.sqrt(105.0 / math.pi),
    -0.25 * math.sqrt(35.0 / (2.0 * math.pi)),
)

#: ``exponential`` limits log radiance to ±this, so that float32 neither overflows nor underflows.
LOG_LIMIT = 80.0
#: In ``refit`` one product takes so many Gaussians: above 2¹⁸ multiplications OpenBLAS starts threads, which
#: spin, and where other processes want the cores a product then takes four times as long.
_GROUP = 32
#: So many groups are worked on at a time: the buffers stay near the size of a CPU's cache.
_GROUPS = 24
#: Evenly spread directions at which a baked colour is fitted.
FIT_DIRECTIONS = 64


def coefficient_count(degree: int) -> int:
    """K = (degree + 1)²."""
    return (degree + 1) ** 2


def degree_of(count: int) -> int:
    """The degree that has ``count`` coefficients; ``ValueError`` if there is none from 0 to 3."""
    degree = math.isqrt(max(count, 1)) - 1
    if coefficient_count(degree) != count or degree > MAX_DEGREE:
        raise ValueError(f"{count} is not a number of SH coefficients: 1, 4, 9 or 16")
    return degree


def basis(directions: np.ndarray, degree: int) -> np.ndarray:
    """Y_k(ω) ``[N, K]`` for unit vectors ``directions`` ``[N, 3]`` (camera to Gaussian)."""
    directions = np.asarray(directions)
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, C0)]
    if degree >= 1:
        columns += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        columns += [
            C2[0] * x * y,
            C2[1] * y * z,
            C2[2] * (2.0 * zz - xx - yy),
            C2[3] * x * z,
            C2[4] * (xx - yy),
        ]
    if degree >= 3:
        columns += [
            C3[0] * y * (3.0 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4.0 * zz - xx - yy),
            C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
            C3[4] * x * (4.0 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3.0 * yy),
        ]
    return np.stack(columns, axis=1)


def quadrature(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions ``[2 nodes², 3]`` and weights (they sum to 4π) of a product rule on the sphere.

    Gauss-Legendre along z, equally spaced around it: exact for polynomials up to degree 2 nodes − 1.
    """
    z, z_weights = np.polynomial.legendre.leggauss(nodes)
    azimuth = (np.arange(2 * nodes) + 0.5) * (math.pi / nodes)
    z, azimuth = (grid.ravel() for grid in np.meshgrid(z, azimuth, indexing="ij"))
    ring = np.sqrt(1.0 - z * z)
    directions = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    return directions, np.repeat(z_weights * (math.pi / nodes), 2 * nodes)


def fibonacci_sphere(count: int) -> np.ndarray:
    """``[count, 3]`` evenly spread unit vectors."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def refit(
    sh: np.ndarray, function: Callable[[np.ndarray], np.ndarray], evaluate: np.ndarray, project: np.ndarray
) -> np.ndarray:
    """SH coefficients ``[N, K, 3]`` (float32) of ``function`` of what ``sh`` ``[N, K, 3]`` describes.

    ``evaluate`` ``[Q, K]``: the basis at Q directions; ``project`` ``[K, Q]``: from values there back to
    coefficients (a quadrature or a pseudo-inverse). ``function`` gets ``[…, 3, n]`` float32 values, which it
    may overwrite, and gives as many; threads call it. The result is a view of ``[K, N, 3]``:
    ``result[:, k]`` is contiguous.
    """
    evaluate, project = (np.ascontiguousarray(matrix, np.float32) for matrix in (evaluate, project))
    (directions, coefficients), count = evaluate.shape, len(sh)
    fitted = np.empty((len(project), count, 3), np.float32)

    def work(start: int) -> None:
        chunk = sh[start : start + _GROUPS * _GROUP]
        groups = -(-len(chunk) // _GROUP)
        padded = np.zeros((groups * _GROUP, coefficients, 3), np.float32)
        padded[: len(chunk)] = chunk
        # [groups, K, 3 · _GROUP]: one product for many Gaussians.
        columns = padded.reshape(groups, _GROUP, coefficients, 3).transpose(0, 2, 3, 1)
        values = evaluate @ columns.reshape(groups, coefficients, 3 * _GROUP)
        values = function(values.reshape(groups, directions, 3, _GROUP))
        back = project @ values.reshape(groups, directions, 3 * _GROUP)
        back = back.reshape(groups, len(project), 3, _GROUP).transpose(1, 0, 3, 2)
        fitted[:, start : start + len(chunk)] = back.reshape(len(project), -1, 3)[:, : len(chunk)]

    with ThreadPoolExecutor(usable_cores()) as pool:
        list(pool.map(work, range(0, count, _GROUPS * _GROUP)))  # a list: an error comes back here
    return fitted.transpose(1, 0, 2)


def exponential(values: np.ndarray) -> np.ndarray:
    """exp in place, of values limited to ±``LOG_LIMIT``."""
    if not (values.max(initial=0.0) <= LOG_LIMIT and values.min(initial=0.0) >= -LOG_LIMIT):
        np.clip(values, -LOG_LIMIT, LOG_LIMIT, out=values)
    return np.exp(values, out=values)


def rotated(sh: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """SH coefficients ``[N, K, 3]`` of the function turned by ``turn`` ``[3, 3]``: f'(ω) = f(turn⁻¹ ω).

    A rotation keeps each degree to itself. Its matrices are the integrals of Y_j(ω) Y_k(turn⁻¹ ω), which this
    quadrature gives exactly; reckoned in float64, returned in the type of ``sh``.
    """
    degree = degree_of(sh.shape[1])
    directions, weights = quadrature(degree + 1)
    there = basis(directions, degree).T * weights
    matrix = there @ basis(directions @ np.asarray(turn, np.float64), degree)
    turned = np.empty_like(sh)
    for each in range(degree + 1):
        band = slice(each**2, (each + 1) ** 2)
        turned[:, band] = np.einsum("jk,nkc->njc", matrix[band, band], sh[:, band])
    turned[:, 0] = sh[:, 0]  # to the bit
    return turned
