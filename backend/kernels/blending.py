# SPDX-License-Identifier: GPL-3.0-or-later
"""Products with a view's blend weights (``rasterize.cpu.weights``) and with its spherical harmonics.

A view's picture is W Y x of the coefficients x of all Gaussians: ``toward_camera`` is Y, ``blend`` is W,
``gather`` and ``spread`` are their transposes. n Gaussians are in the view, ``seen`` are their numbers among
all N. One thread each; ``spread`` is called on ranges of ``seen``.
"""

import numpy as np
from numba import njit

from ...bridge.spherical_harmonics import C0, C1, C2, C3
from ..simd import kernel

_C0, _C1 = np.float32(C0), np.float32(C1)
_C2, _C3 = np.array(C2, np.float32), np.array(C3, np.float32)


@njit(error_model="numpy")
def _harmonics(x, y, z, found):
    """The first K of Y_k toward the unit vector (x, y, z) into ``found`` ``[K]``: 1, 4, 9 or 16."""
    found[0] = _C0
    if found.size >= 4:
        found[1], found[2], found[3] = -_C1 * y, _C1 * z, -_C1 * x
    if found.size >= 9:
        found[4], found[5] = _C2[0] * x * y, _C2[1] * y * z
        found[6] = _C2[2] * (z * z + z * z - x * x - y * y)
        found[7], found[8] = _C2[3] * x * z, _C2[4] * (x * x - y * y)
    if found.size >= 16:
        xx, yy, zz = x * x, y * y, z * z
        four = np.float32(4.0) * zz - xx - yy
        three = np.float32(3.0)
        found[9], found[10] = _C3[0] * y * (three * xx - yy), _C3[1] * x * y * z
        found[11], found[13] = _C3[2] * y * four, _C3[4] * x * four
        found[12] = _C3[3] * z * (zz + zz - three * (xx + yy))
        found[14], found[15] = _C3[5] * z * (xx - yy), _C3[6] * x * (xx - three * yy)


@kernel
def toward_camera(seen, directions, sh, colours):
    """``colours`` ``[n, 3]``: Σ_k Y_k(``directions`` ``[n, 3]``) · ``sh`` ``[N, K, 3]`` of those ``seen``."""
    harmonics = np.empty(sh.shape[1], np.float32)
    for i in range(seen.size):
        g = seen[i]
        _harmonics(directions[i, 0], directions[i, 1], directions[i, 2], harmonics)
        red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(harmonics.size):
            red += harmonics[k] * sh[g, k, 0]
            green += harmonics[k] * sh[g, k, 1]
            blue += harmonics[k] * sh[g, k, 2]
        colours[i, 0], colours[i, 1], colours[i, 2] = red, green, blue


@kernel
def spread(first, last, seen, directions, colours, sh):
    """Add to ``sh`` ``[N, K, 3]`` what ``toward_camera`` takes from it, of ``seen[first : last]``."""
    harmonics = np.empty(sh.shape[1], np.float32)
    for i in range(first, last):
        g = seen[i]
        _harmonics(directions[i, 0], directions[i, 1], directions[i, 2], harmonics)
        red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
        for k in range(harmonics.size):
            sh[g, k, 0] += harmonics[k] * red
            sh[g, k, 1] += harmonics[k] * green
            sh[g, k, 2] += harmonics[k] * blue


@kernel
def spread_squares(seen, directions, squares, diagonal):
    """Add to ``diagonal`` ``[N, K]`` each Gaussian's Y_k² times its ``squares`` ``[n]``."""
    harmonics = np.empty(diagonal.shape[1], np.float32)
    for i in range(seen.size):
        _harmonics(directions[i, 0], directions[i, 1], directions[i, 2], harmonics)
        for k in range(harmonics.size):
            diagonal[seen[i], k] += harmonics[k] * harmonics[k] * squares[i]


@kernel
def blend(starts, gaussians, weights, colours, pixels):
    """``pixels`` ``[P, 3]``: the blend of ``colours`` ``[n, 3]``."""
    for p in range(starts.size - 1):
        red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for at in range(starts[p], starts[p + 1]):
            i, w = gaussians[at], weights[at]
            red += w * colours[i, 0]
            green += w * colours[i, 1]
            blue += w * colours[i, 2]
        pixels[p, 0], pixels[p, 1], pixels[p, 2] = red, green, blue


@kernel
def gather(starts, gaussians, weights, pixels, sums):
    """Add to ``sums`` ``[n, 3]`` each Gaussian's Σ_p w_p ``pixels`` ``[P, 3]``."""
    for p in range(starts.size - 1):
        red, green, blue = pixels[p, 0], pixels[p, 1], pixels[p, 2]
        for at in range(starts[p], starts[p + 1]):
            i, w = gaussians[at], weights[at]
            sums[i, 0] += w * red
            sums[i, 1] += w * green
            sums[i, 2] += w * blue


@kernel
def gather_squares(gaussians, weights, sums):
    """Add to ``sums`` ``[n]`` each Gaussian's Σ_p w_p²."""
    for at in range(weights.size):
        sums[gaussians[at]] += weights[at] * weights[at]
