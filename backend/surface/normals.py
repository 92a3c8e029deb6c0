# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way a surface faces of which only points are known, the centres of Gaussians.

The direction in which a point's neighbours spread least (Hoppe 1992). The shortest axis of a Gaussian itself
says less: most are no flat discs (on the demo 24° of median error, where the neighbours' is half of that).
"""

import numpy as np

#: Neighbours of a point: fewer are noisier, more round off edges.
NEIGHBOURS = 32
#: Fainter Gaussians are no surface.
LEAST_OPACITY = 0.1
#: Neighbourhoods that are looked at together, which bounds memory.
AT_ONCE = 65_536


def point_normals(positions: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """``[N, 3]`` float32 unit normals at ``positions`` ``[N, 3]``, each of either sign.

    By the nearest positions with an opacity ``[N]`` of at least ``LEAST_OPACITY``; 0 where there are not
    enough of them for a plane.
    """
    from scipy.spatial import KDTree  # here, because only this needs SciPy

    positions = positions.astype(np.float64)
    solid = positions[opacities >= LEAST_OPACITY]
    found = np.zeros(positions.shape, np.float32)
    if len(solid) < 3:
        return found
    tree = KDTree(solid)
    for first in range(0, len(positions), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        _, near = tree.query(positions[part], k=min(NEIGHBOURS, len(solid)))
        around = solid[near]
        around -= around.mean(axis=1, keepdims=True)
        _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
        found[part] = axes[:, :, 0]  # of the least eigenvalue
    return found


def facing(normals: np.ndarray, positions: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    """``normals`` ``[N, 3]`` at ``positions`` ``[N, 3]``, turned to the side on which ``viewpoint`` is."""
    away = np.einsum("ni,ni->n", normals, positions - viewpoint) > 0.0
    return np.where(away[:, None], -normals, normals).astype(np.float32)
