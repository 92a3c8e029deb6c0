# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views of a capture are for testing, where nothing else says so: some that others surround.

Who walks along something and takes every eighth picture for testing from the first one on takes the end of
the path, too: what is seen from there only is then trained by nothing, and the numbers tell of that alone.
Here a view is for testing only if it lies *between two others*: among its nearest neighbours, by place and by
viewing direction together, there are two on opposite sides of it.
"""

import numpy as np

#: Of so many views one is for testing, as 3DGS has it.
EVERY = 8
#: Neighbours among which there must be two on opposite sides.
NEIGHBOURS = 8
#: Cosine of the least angle between two that count as on opposite sides: 120°. At the end of a path, in a
#: corner of a grid and outside of a cloud all neighbours are within less; along an edge two are at 180°.
OPPOSITE = -0.5
#: Fewer views are all for training.
FEWEST = 3


def test_places(positions: np.ndarray, directions: np.ndarray, every: int = EVERY) -> list[int]:
    """The indices of the views for testing, rising, of N views in the order in which they were taken.

    ``positions`` ``[N, 3]``, any unit; ``directions`` ``[N, 3]``: unit vectors, where each looks. Of each
    ``every`` views in order at most one is chosen: the nearest to their middle (4, 12, 20 … of eights) that
    lies between two others, which are not for testing themselves. The first and the last in order are never
    chosen. Where no view at all lies between two, the one that comes nearest to it is chosen; of fewer than
    ``FEWEST`` none.
    """
    count = len(positions)
    if count < FEWEST:
        return []
    features = _features(np.asarray(positions, np.float64), np.asarray(directions, np.float64))
    chosen: list[int] = []
    # What is left over at the end is a stretch of its own from half of one on.
    for start in range(0, max(count - every // 2, 1), every):
        stretch = range(start, min(start + every, count))
        middle = start + len(stretch) // 2
        inner = (i for i in stretch if 0 < i < count - 1)
        order = sorted(inner, key=lambda i, middle=middle: (abs(i - middle), i))
        fit = next((i for i in order if _widest(features, i, chosen) <= OPPOSITE), None)
        chosen += [] if fit is None else [fit]
    if not chosen:
        chosen = [min(range(1, count - 1), key=lambda i: (_widest(features, i, []), i))]
    return chosen


def _features(positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``[N, 6]``: places in units of their spread, beside directions: on a ring both say the same."""
    offsets = positions - positions.mean(axis=0)
    spread = float(np.sqrt((offsets**2).sum(axis=1).mean()))
    return np.concatenate([offsets / spread if spread > 0.0 else offsets, directions], axis=1)


def _widest(features: np.ndarray, i: int, without: list[int]) -> float:
    """Cosine of the widest angle under which view ``i`` has two of its nearest neighbours; 1 without two."""
    offsets = features - features[i]
    distances = np.linalg.norm(offsets, axis=1)
    there = distances > 1e-9  # a picture from the very same place is on no side
    there[without] = False
    others = np.flatnonzero(there)
    nearest = others[np.argsort(distances[others], kind="stable")[:NEIGHBOURS]]
    units = offsets[nearest] / distances[nearest, None]
    return float((units @ units.T).min(initial=1.0))
