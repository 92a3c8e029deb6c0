# SPDX-License-Identifier: GPL-3.0-or-later
"""From projected Gaussians to a depth-ordered list for every tile.

Each worker makes the lists of a range of tiles of its own: it picks the Gaussians that touch them, sorts
those by depth (a radix sort), and hands them out in that order (a counting sort). So nobody waits for
anybody, and the lists do not depend on the number of workers.
"""

import numpy as np

from ...simd import kernel, prefetch

#: How many Gaussians ahead memory is asked for: the order of depth is no order in memory.
AHEAD = 12

#: The sort's digits: 11 + 11 + 10 bits.
_DIGIT = 2048


@kernel
def fill_lists(
    first_tile, last_tile, keys, slot_starts, slot_tiles, tile_starts, scratch, tile_gaussians, tile_slots
):
    """Make the lists of tiles ``first_tile … last_tile − 1``, nearest Gaussian first, ties by index.

    ``keys`` ``[N]``, ``slot_starts`` ``[N + 1]``, ``slot_tiles``: from ``project`` (of a Gaussian's slots the
    tiles ascend); ``tile_starts`` ``[tiles + 1]``: where every list begins; ``scratch`` ``[4, N]``
    int32. Out: ``tile_gaussians`` ``[pairs]`` and, unless its size is 0, ``tile_slots`` ``[pairs]``.
    """
    count = keys.size
    order, scratch_order, sorted_keys, scratch_keys = scratch[0], scratch[1], scratch[2], scratch[3]
    histogram = np.zeros((3, _DIGIT), np.int32)
    mine = 0
    for g in range(count):
        begin, end = slot_starts[g], slot_starts[g + 1]
        if begin < end and slot_tiles[begin] < last_tile and slot_tiles[end - 1] >= first_tile:
            key = keys[g]
            scratch_keys[mine] = key
            scratch_order[mine] = g
            mine += 1
            histogram[0, key & 2047] += 1
            histogram[1, (key >> 11) & 2047] += 1
            histogram[2, key >> 22] += 1
    # A least-significant-digit radix sort; stable, so ties stay in the order of indices.
    for digit in range(3):
        running = 0
        for value in range(_DIGIT):
            running, histogram[digit, value] = running + histogram[digit, value], running
    for i in range(mine):
        key = scratch_keys[i]
        at = histogram[0, key & 2047]
        histogram[0, key & 2047] = at + 1
        sorted_keys[at], order[at] = key, scratch_order[i]
    for i in range(mine):
        key = sorted_keys[i]
        at = histogram[1, (key >> 11) & 2047]
        histogram[1, (key >> 11) & 2047] = at + 1
        scratch_keys[at], scratch_order[at] = key, order[i]
    for i in range(mine):
        key = scratch_keys[i]
        at = histogram[2, key >> 22]
        histogram[2, key >> 22] = at + 1
        order[at] = scratch_order[i]

    cursor = tile_starts[first_tile:last_tile].copy()
    keep_slots = tile_slots.size > 0
    for i in range(mine):
        prefetch(slot_starts, order[min(i + AHEAD, mine - 1)])
        prefetch(slot_tiles, slot_starts[order[min(i + AHEAD // 2, mine - 1)]])
        g = order[i]
        for slot in range(slot_starts[g], slot_starts[g + 1]):
            tile = slot_tiles[slot]
            if first_tile <= tile < last_tile:
                place = cursor[tile - first_tile]
                cursor[tile - first_tile] = place + 1
                tile_gaussians[place] = g
                if keep_slots:
                    tile_slots[place] = slot
