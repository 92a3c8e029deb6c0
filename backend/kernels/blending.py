# SPDX-License-Identifier: GPL-3.0-or-later
"""Products with a view's blend weights (``rasterize.cpu.weights``) and with its spherical harmonics.

A view's picture is W Y x of the coefficients x of all Gaussians: ``toward_camera`` is Y, ``blend`` is W,
``gather`` and ``spread`` are their transposes. n Gaussians are in the view, ``seen`` are their numbers among
all N. One thread each; ``spread`` is called on ranges of ``seen``.
"""

import numpy as np

from ..simd import kernel


@kernel
def toward_camera(seen, basis, sh, colours):
    """``colours`` ``[n, 3]``: Σ_k ``basis`` ``[n, K]`` · ``sh`` ``[N, K, 3]`` of those that are ``seen``."""
    for i in range(seen.size):
        g = seen[i]
        red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(basis.shape[1]):
            y = basis[i, k]
            red += y * sh[g, k, 0]
            green += y * sh[g, k, 1]
            blue += y * sh[g, k, 2]
        colours[i, 0], colours[i, 1], colours[i, 2] = red, green, blue


@kernel
def spread(first, last, seen, basis, colours, sh):
    """Add to ``sh`` ``[N, K, 3]`` what ``toward_camera`` takes from it, of ``seen[first : last]``."""
    for i in range(first, last):
        g = seen[i]
        red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
        for k in range(basis.shape[1]):
            y = basis[i, k]
            sh[g, k, 0] += y * red
            sh[g, k, 1] += y * green
            sh[g, k, 2] += y * blue


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
