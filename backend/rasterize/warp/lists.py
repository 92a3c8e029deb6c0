# SPDX-License-Identifier: GPL-3.0-or-later
"""From projected Gaussians to a depth-ordered list for every tile, by torch's sorts and scans.

Gaussians are sorted by depth, give out their (Gaussian, tile) pairs in that order, and a stable sort of the
pairs by tile alone leaves every tile's in the order of depth, ties by index. Against one sort of 64-bit
keys (tile ‖ depth) that moves a third of the bytes. Torch's own sort and scan are CUB's on a card and
allocate where everything else does.
"""

from functools import cache
from typing import NamedTuple

import torch

from ..contract import refuse_too_many_pairs
from .arrays import Array, launch, wp
from .projection import View, emit

#: Pairs of a picture: what an int32 indexes, with room for twelve floats each.
MOST_PAIRS = 1 << 30


class Lists(NamedTuple):
    """``tile_starts`` ``[tiles + 1]`` int32 into ``gaussians`` ``[pairs]`` int32, nearest first.

    Pairs have numbers as they were given out, a Gaussian's in a row: ``numbers`` ``[pairs]`` int32 of the
    lists' entries; Gaussian ``order[i]`` has ``ends[i] − counts[order[i]] … ends[i] − 1``.
    """

    tile_starts: torch.Tensor
    gaussians: torch.Tensor
    numbers: torch.Tensor
    order: torch.Tensor
    counts: torch.Tensor
    ends: torch.Tensor


def make_lists(
    depths: torch.Tensor, counts: torch.Tensor, records: torch.Tensor, view: View, tiles_x: int, tiles: int
) -> Lists:
    """Lists of what ``project`` found. The host waits for the device once, for the number of pairs."""
    device = depths.device
    order = depths.sort(stable=True).indices
    ends = counts[order].cumsum(0)  # int64: N Gaussians that cover all tiles are more than an int32 holds
    pairs = int(ends[-1]) if len(ends) else 0
    refuse_too_many_pairs(len(depths), pairs, MOST_PAIRS)
    unsorted, by_depth = (torch.empty(pairs, dtype=torch.int32, device=device) for _ in range(2))
    launch(
        emit,
        len(depths) if pairs else 0,
        [
            *(Array(order, wp.int64), Array(counts, wp.int32), Array(ends, wp.int64)),
            *(Array(records, wp.float32), view, tiles_x, tiles),
            *(Array(unsorted, wp.int32), Array(by_depth, wp.int32)),
        ],
        device,
    )
    # Half the passes of a radix sort, wherever the numbers of tiles fit (to 8.3 megapixels).
    keys = unsorted.short() if tiles < 1 << 15 else unsorted
    keys, numbers = keys.sort(stable=True)
    starts = torch.searchsorted(keys, _numbers(tiles + 1, keys.dtype, device), out_int32=True)
    return Lists(starts, by_depth[numbers], numbers.int(), order, counts, ends)


@cache
def _numbers(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    return torch.arange(count, dtype=dtype, device=device)
