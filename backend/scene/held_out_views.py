# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views of a capture are for testing, where nothing states them: some that others surround.

Who walks along something and takes every eighth picture for testing from the first one on takes the end of
the path, too: what is seen from there only is then trained by nothing, and the numbers tell of that alone.
Here a view is for testing only if it lies *between two others*: among its nearest neighbours, by place and by
viewing direction together, there are two on opposite sides of it.

Pictures that were taken from one place (an exposure bracket that somebody reads as single pictures) are for
testing together, or for training: else each would be tested where its sibling was trained.
"""

import numpy as np

#: One of so many views is for testing, as in 3DGS.
EVERY = 8
#: Neighbours among which there must be two on opposite sides.
NEIGHBOURS = 8
#: Cosine of the least angle between two that count as on opposite sides: 120°. At the end of a path, in a
#: corner of a grid and outside of a cloud all neighbours are within less; along an edge two are at 180°.
OPPOSITE = -0.5
#: Fewer places are all for training.
FEWEST = 3
#: Pictures are of one place where they are together within a quarter of one of these, and all others farther
#: than it. In units of the places' spread, or radians: from hand-held brackets of places far apart down to a
#: tripod's of places near to each other, whose poses differ by their errors alone.
REACHES = (0.1, 0.03, 0.01, 0.003, 0.001)
APART = 4.0


def held_out_places(positions: np.ndarray, directions: np.ndarray, every: int = EVERY) -> list[int]:
    """The indices of the views for testing, rising, of N views in the order in which they were taken.

    ``positions`` ``[N, 3]``, any unit; ``directions`` ``[N, 3]``: unit vectors, where each looks. Of each
    ``every`` places (``same_places``) in order at most one is chosen, with all its views: the nearest to
    their middle (4, 12, 20 … of eights) that lies between two others, which are not for testing themselves.
    Those of the first and of the last view are never chosen. Where no place at all lies between two, the one
    that comes nearest to it is chosen; of fewer than ``FEWEST`` none.
    """
    groups = same_places(positions, directions)
    count = len(groups)
    if count < FEWEST:
        return []
    everything = _features(positions, directions)
    features = np.stack([everything[group].mean(axis=0) for group in groups])
    last = len(everything) - 1
    inner = {i for i, group in enumerate(groups) if 0 not in group and last not in group}
    chosen: list[int] = []
    # A rest at the end is a stretch of its own if it is at least half of one.
    for start in range(0, max(count - every // 2, 1), every):
        stretch = range(start, min(start + every, count))
        middle = start + len(stretch) // 2
        order = sorted((i for i in stretch if i in inner), key=lambda i, middle=middle: (abs(i - middle), i))
        fit = next((i for i in order if _widest(features, i, chosen) <= OPPOSITE), None)
        chosen += [] if fit is None else [fit]
    if not chosen:
        chosen = [min(inner, key=lambda i: (_widest(features, i, []), i))]
    return sorted(view for i in chosen for view in groups[i])


def same_places(positions: np.ndarray, directions: np.ndarray) -> list[list[int]]:
    """N views by the place and direction that they were taken from, in the order of each place's first.

    Arguments as ``held_out_places`` has them. Most are alone: only what is much nearer to each other than to
    all else is one place, so that frames of a film are none, however near they are.
    """
    from scipy.spatial import KDTree  # here, because only this needs SciPy

    if len(positions) == 0:
        return []
    features = _features(positions, directions)
    tree = KDTree(features)
    place = np.full(len(features), -1)
    for reach in REACHES:
        for view in range(len(features)):
            if place[view] >= 0:
                continue
            near = np.array(tree.query_ball_point(features[view], reach))
            together = float(np.linalg.norm(np.ptp(features[near], axis=0))) <= reach / APART
            if len(near) > 1 and together and (place[near] < 0).all():
                place[near] = view
    groups: dict[int, list[int]] = {}
    for view, first in enumerate(place.tolist()):
        groups.setdefault(first if first >= 0 else view, []).append(view)
    return list(groups.values())


def _features(positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``[N, 6]``: places in units of their spread, beside directions: on a ring both say the same."""
    positions, directions = np.asarray(positions, np.float64), np.asarray(directions, np.float64)
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
