# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that float before a camera: nearer than anything that it photographs.

Such a Gaussian fills much of one picture and is seen by no other, so that it can explain whatever that
picture has of its own. Nearer than a share of the distance of the nearest first points in a view's frame
there is nothing that anybody photographed.
"""

from collections.abc import Sequence

import numpy as np
import torch

from ..scene.camera import Camera

#: Of the points in a view's frame this share is taken for stray; the rest says how near things are.
STRAY = 0.02
#: Nothing is nearer than this share of that distance.
NEAREST = 0.3
#: With fewer points in its frame a view tells nothing.
FEWEST = 50


def clearances(points: np.ndarray, cameras: Sequence[Camera]) -> torch.Tensor:
    """``[V]`` float32: the depth (metres) before which nothing is, for each camera; 0 where nobody knows."""
    found = []
    for camera in cameras:
        inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        depth = inside[_in_frame(inside, camera), 2]
        found.append(NEAREST * float(np.quantile(depth, STRAY)) if len(depth) >= FEWEST else 0.0)
    return torch.tensor(found)


def floating(means: torch.Tensor, cameras: Sequence[Camera], clearance: torch.Tensor) -> torch.Tensor:
    """``[N]`` bool: which of ``means`` ``[N, 3]`` are in a camera's frame and before its ``clearance``."""
    near = torch.zeros(len(means), dtype=torch.bool)
    points = means.detach().cpu().numpy().astype(np.float64)
    for camera, least in zip(cameras, clearance.tolist(), strict=True):
        inside = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        which = np.flatnonzero((inside > 0.0) & (inside < least))
        if len(which):
            there = points[which] @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            near[which[_in_frame(there, camera)]] = True
    return near.to(means.device)


def _in_frame(inside: np.ndarray, camera: Camera) -> np.ndarray:
    """Which points ``[N, 3]``, in a camera's own axes, are in its picture, ``[N]`` bool."""
    depth = np.maximum(inside[:, 2], 1e-9)
    x = camera.fx * inside[:, 0] / depth + camera.cx
    y = camera.fy * inside[:, 1] / depth + camera.cy
    return (inside[:, 2] > 0.0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
