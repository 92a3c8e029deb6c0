# SPDX-License-Identifier: GPL-3.0-or-later
"""A viewer of standard PLYs, as 3DGS draws them: by the reference rasteriser, in float64."""

import numpy as np
import torch

from physhdr.backend.rasterize.reference import rasterize
from physhdr.bridge.spherical_harmonics import basis


def viewed(vertices, camera):
    """``[3, H, W]``: the picture of a PLY's element ``vertex``; colours have a floor at 0 and no ceiling."""

    def stacked(*names):
        return torch.from_numpy(np.stack([vertices[name] for name in names], axis=1).astype(np.float64))

    means = stacked(*"xyz")
    rest = sum(p.name.startswith("f_rest_") for p in vertices.properties) // 3
    sh = [stacked(*(f"f_dc_{c}" for c in range(3)))]
    sh += [stacked(*(f"f_rest_{c * rest + k}" for c in range(3))) for k in range(rest)]
    offset = means.numpy() - camera.position
    y = basis(offset / np.linalg.norm(offset, axis=1, keepdims=True), int(np.sqrt(rest + 1)) - 1)
    colours = (torch.einsum("nk,knc->nc", torch.from_numpy(y), torch.stack(sh)) + 0.5).clamp_min(0.0)
    shape = stacked(*(f"rot_{k}" for k in range(4))), stacked(*(f"scale_{k}" for k in range(3))).exp()
    return rasterize(means, *shape, stacked("opacity")[:, 0].sigmoid(), colours, camera, None).image
