# SPDX-License-Identifier: GPL-3.0-or-later
"""What a capture never saw, guessed from its rim: a panorama's holes are filled smoothly.

A pyramid on the sphere (push and pull): every coarser level is the mean of what is there, by coverage and by
solid angle; holes take their colours from the finest level that knows any, and blend into it. What is much
brighter than most of what was seen, a lamp or a window, counts less: light sources are few, and where nobody
looked there is rarely another one (measured: lab/notebook.md). The weights are the same for all parts, so
that parts of a light that are filled each add up to what their sum is filled with.
"""

import numpy as np

from .panorama import solid_angles

#: The narrowest level of the pyramid, pixels: below it only the mean of the whole sphere is asked for.
NARROWEST = 8
#: Coverage below this tells no colour: what is there is nearly black, and divided by nearly nothing.
FAINTEST = 1e-3
#: What is brighter than so many times the median of what was seen counts the less, the brighter it is.
BRIGHT = 2.0


def filled(parts: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Parts ``[P, H, W, C]``, premultiplied by ``alpha`` ``[H, W]``, over a guess where alpha is below 1.

    Where nothing was seen at all there is nothing to guess from: it stays black. Returns ``[P, H, W, C]`` in
    the parts' dtype.
    """
    count, height, width, channels = parts.shape
    planes = np.moveaxis(parts, 0, 2).reshape(height, width, count * channels)
    coverage = np.where(alpha < FAINTEST, 0.0, alpha)
    trust = np.where(coverage > 0.0, _trust(parts.sum(0), coverage), 0.0)
    guess = _pulled(planes * trust[..., None], coverage * trust)
    whole = planes + (1.0 - alpha)[..., None] * guess
    return np.moveaxis(whole.reshape(height, width, count, channels), 2, 0).astype(parts.dtype)


def _trust(total: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """``[H, W]`` in 0…1: what pixels of a premultiplied light ``[H, W, C]`` tell of what is unseen."""
    bright = total.max(-1) / np.maximum(coverage, FAINTEST)
    order = np.argsort(bright, axis=None)
    weight = np.cumsum((coverage * solid_angles(coverage.shape[1])[:, None]).ravel()[order])
    median = bright.ravel()[order][np.searchsorted(weight, 0.5 * weight[-1])]
    return (
        np.minimum(1.0, BRIGHT * median / np.maximum(bright, 1e-30)) if median > 0.0 else np.ones_like(bright)
    )


def _pulled(planes: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """A colour for every pixel ``[H, W, K]``: its own where it is covered, else that of its surroundings."""
    height, width = coverage.shape
    # A pixel wins over its surroundings as far as it is covered.
    own = planes / np.maximum(coverage, FAINTEST)[..., None]
    if width <= NARROWEST or height % 2 or width % 2:
        weight = coverage * solid_angles(width)[:, None]
        total = weight.sum()
        mean = np.einsum("hw,hwk->k", weight, own) / total if total > 0.0 else np.zeros(planes.shape[-1])
        around = np.broadcast_to(mean, planes.shape)
    else:
        area = solid_angles(width)[:, None]
        coarse_area = _in_fours(np.broadcast_to(area, coverage.shape))
        coarse = _in_fours(planes * area[..., None]) / coarse_area[..., None]
        coarse_coverage = _in_fours(coverage * area) / coarse_area
        # A quarter that is seen is enough to know a colour: holes close from level to level.
        gain = np.where(coarse_coverage > 0.0, np.minimum(1.0, 4.0 * coarse_coverage), 0.0)
        scale = gain / np.maximum(coarse_coverage, 1e-30)
        around = _doubled(_pulled(coarse * scale[..., None], gain))
    return own * coverage[..., None] + around * (1.0 - coverage)[..., None]


def _in_fours(planes: np.ndarray) -> np.ndarray:
    """Sums of 2 × 2 pixels."""
    return planes[::2, ::2] + planes[1::2, ::2] + planes[::2, 1::2] + planes[1::2, 1::2]


def _doubled(planes: np.ndarray) -> np.ndarray:
    """``[2 H, 2 W, K]``: linear between pixels, round the sphere and over its poles."""
    half = planes.shape[1] // 2
    # Beyond a pole lies the same row, half a turn away.
    top, bottom = np.roll(planes[:1], half, axis=1), np.roll(planes[-1:], half, axis=1)
    tall = np.concatenate([top, planes, bottom])
    rows = np.empty((2 * planes.shape[0], *planes.shape[1:]), planes.dtype)
    rows[::2] = 0.75 * planes + 0.25 * tall[:-2]
    rows[1::2] = 0.75 * planes + 0.25 * tall[2:]
    left, right = np.roll(rows, 1, axis=1), np.roll(rows, -1, axis=1)
    whole = np.empty((len(rows), 2 * planes.shape[1], *planes.shape[2:]), planes.dtype)
    whole[:, ::2] = 0.75 * rows + 0.25 * left
    whole[:, 1::2] = 0.75 * rows + 0.25 * right
    return whole
