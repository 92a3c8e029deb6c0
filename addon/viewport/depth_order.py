# SPDX-License-Identifier: GPL-3.0-or-later
"""The order in which Gaussians are blended: radix sorts in numpy (1 M: 10 ms quick, 40 ms exact)."""

import numpy as np


def back_to_front(depth: np.ndarray, exact: bool = True) -> np.ndarray:
    """Indices ``[N]`` uint32 of ``depth`` ``[N]`` float32, the farthest first.

    Equal depths: the higher index first, so that read from its end the order is the rasterisers' (front to
    back, ties by index). Not ``exact``: depths are distinguished to 1/65536 of their range (for a view that
    moves). numpy sorts 16-bit keys with a radix sort; 32 bits are two such passes.
    """
    if depth.size == 0:
        return np.empty(0, np.uint32)
    order = _front_to_back_quick(depth) if not exact else _front_to_back_exact(depth)
    return order[::-1].astype(np.uint32)


def _front_to_back_quick(depth: np.ndarray) -> np.ndarray:
    low, high = float(depth.min()), float(depth.max())
    scale = 65535.0 / max(high - low, 1e-30)
    return np.argsort(((depth - np.float32(low)) * np.float32(scale)).astype(np.uint16), kind="stable")


def _front_to_back_exact(depth: np.ndarray) -> np.ndarray:
    bits = np.ascontiguousarray(depth + np.float32(0.0)).view(np.uint32)  # the sum makes −0 into 0
    # The bits of floats in the order of the floats: negative ones upside down, below the others.
    keys = np.where(bits >> 31, ~bits, bits | np.uint32(0x80000000))
    order = np.argsort((keys & 0xFFFF).astype(np.uint16), kind="stable")
    return order[np.argsort((keys >> 16).astype(np.uint16)[order], kind="stable")]
