# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians are likely floaters: a suggestion for a person to look at. numpy alone.

A floater hangs alone in free space. *Alone*: of what is opaque near a usual Gaussian, it has less than a
tenth around it. That holds for much of a sparse background, too; so it must also be *near a camera* of the
data set (nearer than a quarter of the usual distance), or both *large* (four times the usual) and *faint*.
Everything is measured against the model's own middle values, so that a model's scale does not matter.
"""

import itertools

import numpy as np

#: Neighbours are looked for in cells this many times the median size of a Gaussian.
CELL = 6.0
#: Of the median opacity around a Gaussian: below it is alone.
ALONE = 0.1
#: Of the median distance to the nearest camera.
NEAR = 0.25
#: Of the median size, and opacity.
LARGE, FAINT = 4.0, 0.3


def floaters(
    position: np.ndarray,
    scale: np.ndarray,
    opacity: np.ndarray,
    camera_distance: np.ndarray | None = None,
) -> np.ndarray:
    """Bool ``[N]`` of Gaussians as in a model. ``camera_distance`` ``[N]``: to the nearest camera of the data
    set, where it is known."""
    size = scale.max(axis=1)
    usual = float(np.median(size))
    if usual <= 0.0:
        return np.zeros(len(size), bool)
    around = opacity_around(position, opacity, CELL * usual) - opacity
    suspicious = (size > LARGE * usual) & (opacity < FAINT)
    if camera_distance is not None:
        suspicious |= camera_distance < NEAR * np.median(camera_distance)
    return suspicious & (around < ALONE * np.median(around))


def opacity_around(position: np.ndarray, opacity: np.ndarray, cell: float) -> np.ndarray:
    """``[N]``: the sum of the opacities in a point's cell of a grid and the 26 around it, its own too."""
    places = np.floor((position - position.min(axis=0)) / np.float64(cell)).astype(np.int64) + 1
    # One number a cell; a few far points must not make it overflow.
    shape = np.minimum(places.max(axis=0) + 2, 1 << 20)
    keys = np.ravel_multi_index(tuple(np.minimum(places, shape - 1).T), tuple(shape), mode="clip")
    cells, which = np.unique(keys, return_inverse=True)
    mass = np.bincount(which, opacity)
    around = np.zeros(len(cells))
    for dx, dy, dz in itertools.product((-1, 0, 1), repeat=3):
        wanted = cells + (dx * shape[1] + dy) * shape[2] + dz
        at = np.minimum(np.searchsorted(cells, wanted), len(cells) - 1)
        around += np.where(cells[at] == wanted, mass[at], 0.0)
    return around[which]
