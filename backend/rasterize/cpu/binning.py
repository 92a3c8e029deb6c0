# SPDX-License-Identifier: GPL-3.0-or-later
"""From projected Gaussians to a depth-ordered list for every tile.

1. ``sort_by_depth``: the drawn Gaussians, nearest first, ties by index (a radix sort).
2. ``gather``: in that order, a record for the tile kernels (footprint and colours side by side, so that
   a tile touches one cache line per Gaussian), and the numbers of tiles per Gaussian and the reverse.
3. ``fill``: the lists (a counting sort). Each worker takes a contiguous part of the depth order and has
   its own cursor into every tile's list, so the lists do not depend on the number of workers.

A Gaussian belongs to a tile if its ellipse {alpha ≥ 1/255} reaches a pixel centre of it. For a band of
rows, the ellipse's x-range has a closed form: with l₂₁/l₁₁ = s and ρ(dy) = √(R − q dy²)/l₁₁, its edges
are −s dy ± ρ(dy). The right one is concave with its maximum at ``rightmost_y``, so on a band it is largest
at the dy of the band nearest to that; likewise on the left, by symmetry about the centre.
"""

import numpy as np
from numba import njit

from ..contract import ALPHA_MIN
from .compiling import kernel
from .projection import (
    BIAS,
    FOOTPRINT,
    HALF_HEIGHT,
    HALF_WIDTH,
    INVERSE_L11,
    L21,
    MEAN_X,
    MEAN_Y,
    NOT_DRAWN,
    RIGHTMOST_Y,
    Q,
)
from .simd import LANES, prefetch

#: Pixels of a tile. 32 × 16 is 64 blocks of 4 × 2 pixels: one uint64 says which blocks matter.
TILE_WIDTH = 4 * LANES
TILE_HEIGHT = 16

#: Floats of a record before the colours: the first seven of the footprint, and one unused.
RECORD_HEAD = 8

#: t at which alpha = 1/255 (see projection.py).
T_MIN = float(np.log2(ALPHA_MIN)) / 8.0

#: Most Gaussians touch at most this many tiles; ``gather`` notes them down for ``fill``.
NEAR = 4

#: How many Gaussians ahead memory is asked for.
AHEAD = 12

#: Widening of the ellipse's rows, against rounding: pixels, and a fraction of the distances involved.
MARGIN = 0.01
RELATIVE_MARGIN = 4e-7


@kernel
def sort_by_depth(keys, order, scratch_keys, scratch_order):
    """Write the indices of drawn Gaussians to ``order`` ``[N]`` by ascending key; return how many.

    A least-significant-digit radix sort of 11 + 11 + 10 bits; stable, so ties are by index.
    """
    histogram = np.zeros((3, 2048), np.int64)
    count = 0
    for i in range(keys.size):
        key = keys[i]
        if key != NOT_DRAWN:
            histogram[0, key & 2047] += 1
            histogram[1, (key >> 11) & 2047] += 1
            histogram[2, key >> 22] += 1
            count += 1
    for digit in range(3):
        running = 0
        for value in range(2048):
            running, histogram[digit, value] = running + histogram[digit, value], running
    for i in range(keys.size):
        key = keys[i]
        if key != NOT_DRAWN:
            at = histogram[0, key & 2047]
            histogram[0, key & 2047] = at + 1
            scratch_keys[at] = key
            order[at] = i
    for i in range(count):
        key = scratch_keys[i]
        at = histogram[1, (key >> 11) & 2047]
        histogram[1, (key >> 11) & 2047] = at + 1
        keys[at] = key
        scratch_order[at] = order[i]
    for i in range(count):
        at = histogram[2, keys[i] >> 22]
        histogram[2, keys[i] >> 22] = at + 1
        order[at] = scratch_order[i]
    return count


@njit
def _tile_rows(footprints, at, height):
    """First and last tile row of a Gaussian's bounding box; first > last if there is none."""
    mean_y, half_height = footprints[at + MEAN_Y], footprints[at + HALF_HEIGHT] + MARGIN
    # Clamped before they become integers: huge Gaussians reach beyond what an integer holds.
    top = max(np.ceil(mean_y - half_height - np.float32(0.5)), np.float32(0.0))
    bottom = min(np.floor(mean_y + half_height - np.float32(0.5)), np.float32(height - 1))
    if bottom < top:
        return 0, -1
    return int(top) // TILE_HEIGHT, int(bottom) // TILE_HEIGHT


@njit
def _tile_span(footprints, at, tile_y, width):
    """First and last tile column that a Gaussian touches in row ``tile_y``; first > last if none."""
    mean_x, mean_y = footprints[at + MEAN_X], footprints[at + MEAN_Y]
    half_height = footprints[at + HALF_HEIGHT]
    low = np.float32(tile_y * TILE_HEIGHT) + np.float32(0.5) - mean_y
    high = low + np.float32(TILE_HEIGHT - 1)
    low, high = max(low, -half_height), min(high, half_height)
    slope = footprints[at + L21] * footprints[at + INVERSE_L11]
    extent = footprints[at + BIAS] - np.float32(T_MIN)
    peak = footprints[at + RIGHTMOST_Y]
    dy = min(max(peak, low), high)
    rho = np.sqrt(max(extent - footprints[at + Q] * dy * dy, np.float32(0.0))) * footprints[at + INVERSE_L11]
    right = rho - slope * dy
    dy = min(max(-peak, low), high)
    rho = np.sqrt(max(extent - footprints[at + Q] * dy * dy, np.float32(0.0))) * footprints[at + INVERSE_L11]
    left = -rho - slope * dy
    margin = np.float32(MARGIN) + np.float32(RELATIVE_MARGIN) * (abs(mean_x) + footprints[at + HALF_WIDTH])
    first = max(np.ceil(mean_x + left - margin - np.float32(0.5)), np.float32(0.0))
    last = min(np.floor(mean_x + right + margin - np.float32(0.5)), np.float32(width - 1))
    if last < first:
        return 0, -1
    return int(first) // TILE_WIDTH, int(last) // TILE_WIDTH


@kernel
def gather(
    first,
    last,
    order,
    footprints,
    colours,
    channels,
    width,
    height,
    tiles_x,
    records,
    stride,
    touched,
    histogram,
    counts,
    near_tiles,
):
    """Records of the Gaussians at ranks ``first … last − 1`` of the depth order, and tile counts.

    Out: ``records[stride · rank :]``, ``touched[g]`` tiles of Gaussian g, ``histogram`` ``[tiles]`` of this
    part of the order (to be zero before); ``counts[rank]`` tiles, of which the first ``NEAR`` are
    ``near_tiles[NEAR · rank :]``.
    """
    for rank in range(first, last):
        # The order of depth is no order in memory: without this, waiting for it is half of the time.
        ahead = order[min(rank + AHEAD, last - 1)]
        prefetch(footprints, FOOTPRINT * ahead)
        prefetch(footprints, FOOTPRINT * ahead + FOOTPRINT - 1)
        prefetch(colours, channels * ahead)
        prefetch(touched, ahead)
        g = order[rank]
        at = FOOTPRINT * g
        for field in range(RECORD_HEAD - 1):
            records[rank * stride + field] = footprints[at + field]
        for c in range(channels):
            records[rank * stride + RECORD_HEAD + c] = colours[g * channels + c]
        count = 0
        top, bottom = _tile_rows(footprints, at, height)
        for tile_y in range(top, bottom + 1):
            left, right = _tile_span(footprints, at, tile_y, width)
            for tile_x in range(left, right + 1):
                tile = tile_y * tiles_x + tile_x
                histogram[tile] += 1
                if count < NEAR:
                    near_tiles[NEAR * rank + count] = tile
                count += 1
        touched[g] = count
        counts[rank] = count


@kernel
def fill(
    first,
    last,
    order,
    footprints,
    width,
    height,
    tiles_x,
    counts,
    near_tiles,
    cursor,
    slot_starts,
    tile_ranks,
    tile_slots,
):
    """Append ranks ``first … last − 1`` to the lists of the tiles that they touch.

    ``counts``, ``near_tiles``: from ``gather``; ``cursor`` ``[tiles]``: where this part begins in
    every tile's list. Out: ``tile_ranks`` ``[pairs]``; ``tile_slots`` ``[pairs]`` (size 0: not wanted), the
    number of the (Gaussian, tile) pair counted Gaussian by Gaussian, in the order of indices.
    """
    keep_slots = tile_slots.size > 0
    for rank in range(first, last):
        if keep_slots:
            prefetch(slot_starts, order[min(rank + AHEAD, last - 1)])
        g = order[rank]
        slot = slot_starts[g] if keep_slots else 0
        if counts[rank] <= NEAR:
            for k in range(counts[rank]):
                tile = near_tiles[NEAR * rank + k]
                place = cursor[tile]
                cursor[tile] = place + 1
                tile_ranks[place] = rank
                if keep_slots:
                    tile_slots[place] = slot + k
            continue
        top, bottom = _tile_rows(footprints, FOOTPRINT * g, height)
        for tile_y in range(top, bottom + 1):
            left, right = _tile_span(footprints, FOOTPRINT * g, tile_y, width)
            for tile in range(tile_y * tiles_x + left, tile_y * tiles_x + right + 1):
                place = cursor[tile]
                cursor[tile] = place + 1
                tile_ranks[place] = rank
                if keep_slots:
                    tile_slots[place] = slot
                    slot += 1
