# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Gaussians start, and how bright: points and colours, merged from the training brackets."""

import math

import numpy as np
import torch

from ...bridge.errors import BadValueError
from ..model.gaussians import LOG_RADIANCE_RANGE
from ..model.tone_mapper import ToneMapper
from ..scene.camera import Camera
from ..scene.scene import Scene, View
from .morton import morton_order

#: Random points lie between these depths (metres) of the training cameras, evenly in log depth.
RANDOM_DEPTH_RANGE = (0.5, 20.0)


def scene_extent(views: list[View]) -> float:
    """1.1 × the largest distance of a training camera from their mean (3DGS), metres."""
    centres = np.array([view.camera.position for view in views])
    return float(1.1 * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max().clip(1e-3))


def random_points(views: list[View], count: int, seed: int) -> np.ndarray:
    """``[count, 3]`` points in the views' frusta, for data sets without points."""
    rng = np.random.default_rng(seed)
    near, far = np.log(RANDOM_DEPTH_RANGE)
    cameras = [views[i].camera for i in rng.integers(len(views), size=count)]
    points = np.empty((count, 3))
    for i, camera in enumerate(cameras):
        x = (rng.uniform(0, camera.width) - camera.cx) / camera.fx
        y = (rng.uniform(0, camera.height) - camera.cy) / camera.fy
        depth = math.exp(rng.uniform(near, far))
        in_camera = depth * np.array([x, -y, -1.0])  # OpenGL axes
        points[i] = camera.camera_to_world[:3, :3] @ in_camera + camera.position
    return points


def initial_points(scene: Scene, source: str, random_count: int, seed: int) -> np.ndarray:
    """The data set's points ``[P, 3]``, or random ones where asked for (``source`` = "random").

    Sorted by place (``morton``), as densification keeps them.
    """
    points = _points(scene, source, random_count, seed)
    return points[morton_order(torch.as_tensor(points)).numpy()]


def _points(scene: Scene, source: str, random_count: int, seed: int) -> np.ndarray:
    if source == "random":
        return random_points(scene.train, random_count, seed)
    if scene.points is None:
        raise BadValueError(
            f"{scene.root} has no points3d.ply",
            "Train with --initial-points random, or give the data set the points of structure from motion.",
        )
    return scene.points.positions.astype(np.float64)


def _pixels(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Which ``points`` are in the picture, ``[P]`` bool, and their pixels (row, column) ``[P, 2]``.

    Occlusion is not considered.
    """
    in_camera = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = in_camera[:, 2].clip(1e-6)
    column = np.floor(camera.fx * in_camera[:, 0] / depth + camera.cx)
    row = np.floor(camera.fy * in_camera[:, 1] / depth + camera.cy)
    seen = (
        (in_camera[:, 2] > 0.01)
        & (column >= 0)
        & (column < camera.width)
        & (row >= 0)
        & (row < camera.height)
    )
    return seen, np.stack([row, column], axis=1).clip(0, [camera.height - 1, camera.width - 1]).astype(int)


def merged_log_radiance(
    points: np.ndarray, views: list[View], exposures: list[tuple[int, ...]], tone_mapper: ToneMapper
) -> np.ndarray:
    """ln radiance ``[P, 3]`` of points, merged from the pictures that training may see.

    Each picture votes with f⁻¹(code) − ln t, f being the response as it is now; a code near black or white
    says little and weighs little (the hat of Debevec and Malik). ``exposures[i]`` are the indices allowed
    for ``views[i]``. Points that nobody sees get the mean.
    """
    total = np.zeros((len(points), 3))
    weight_sum = np.full((len(points), 3), 1e-6)
    codes = torch.arange(256) / 255.0
    log_exposure_of_code = tone_mapper.inverse(codes.expand(3, -1).contiguous()).numpy()
    hat = np.minimum(np.arange(256), 255 - np.arange(256)) / 127.5 + 1e-3
    for view, indices in zip(views, exposures, strict=True):
        seen, pixel = _pixels(points, view.camera)
        row, column = pixel[seen].T
        for k in indices:
            code = view.image(k)[row, column]
            log_exposure = np.stack([log_exposure_of_code[c][code[:, c]] for c in range(3)], axis=1)
            total[seen] += hat[code] * (log_exposure - math.log(view.exposures[k]))
            weight_sum[seen] += hat[code]
    merged = total / weight_sum
    unseen = weight_sum[:, 0] < 1e-4
    if unseen.any() and not unseen.all():
        merged[unseen] = merged[~unseen].mean(axis=0)
    return merged.clip(*LOG_RADIANCE_RANGE)
