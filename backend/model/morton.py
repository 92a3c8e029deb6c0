# SPDX-License-Identifier: GPL-3.0-or-later
"""Morton (Z-) order: points that are neighbours in space become neighbours in memory.

A Gaussian is looked up once for every tile that it covers, and the Gaussians of one tile are neighbours in
space. Sorted along this curve they share cache lines. Nothing but the order depends on it.
"""

import torch

#: Bits for each axis: three times 21 fit into an int64. A cell is 1/2,097,152 of the longest side.
BITS = 21

#: Spreads 21 bits so that two zeros follow each: shift left, then keep the bits that are where they belong.
_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_codes(points: torch.Tensor) -> torch.Tensor:
    """Cell numbers ``[N]`` int64 of ``points`` ``[N, 3]`` along a Z-curve through their bounding cube.

    Bit 3i of a code is bit i of the cell's x, bit 3i + 1 that of y, bit 3i + 2 that of z.
    """
    if points.shape[0] == 0:
        return torch.zeros(0, dtype=torch.int64, device=points.device)
    low = points.amin(dim=0)
    side = (points.amax(dim=0) - low).amax().clamp_min(torch.finfo(points.dtype).tiny)
    # In float64, where 21 bits are exact, and so that float32 and float64 points take one path.
    cells = ((points - low).double() / side.double() * 2.0**BITS).long().clamp(0, (1 << BITS) - 1)
    for shift, mask in _SPREAD:
        cells = (cells | (cells << shift)) & mask
    return cells[:, 0] | (cells[:, 1] << 1) | (cells[:, 2] << 2)


def morton_order(points: torch.Tensor) -> torch.Tensor:
    """Indices ``[N]`` int64 that sort ``points`` ``[N, 3]`` along the Z-curve; in one cell by index."""
    return torch.argsort(morton_codes(points), stable=True)
