# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Gaussians start, and how bright: points and colours, merged from the training brackets."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch

from ...bridge.errors import BadValueError
from ..model.morton import morton_order
from ..model.tone_mapper import Response
from ..scene.camera import Camera
from ..scene.scene import Scene, View
from .brackets import Votes, log_radiance_picture
from .stereo import stereo_points, stereo_view

#: Metres; what cameras in one place have.
SMALLEST_EXTENT = 1e-3

Source = Literal["auto", "both", "file", "stereo", "random"]

#: Random points lie between these depths of the training cameras, evenly in log depth, in units of the
#: cameras' extent (``scene_extent``).
RANDOM_DEPTH_RANGE = (0.5, 20.0)
#: With fewer points than this, stereo has failed.
FEWEST_STEREO_POINTS = 100
#: More are thinned, as densification knows better where Gaussians are needed: first points fill this share
#: of their budget; stereo's may be as many as the second share in any case, and at most so many.
FILLED, LEAST_STEREO, MOST_STEREO_POINTS = 0.5, 1.0 / 6.0, 40_000


def scene_extent(views: list[View]) -> float:
    """1.1 × the largest distance of a training camera from their mean (3DGS), metres."""
    centres = np.array([view.camera.position for view in views])
    return float(1.1 * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max().clip(SMALLEST_EXTENT))


def random_points(views: list[View], count: int, seed: int) -> np.ndarray:
    """``[count, 3]`` points in the views' frusta, where nothing better is known."""
    rng = np.random.default_rng(seed)
    extent = scene_extent(views)
    near, far = np.log(np.array(RANDOM_DEPTH_RANGE) * (extent if extent > SMALLEST_EXTENT else 1.0))
    cameras = [views[i].camera for i in rng.integers(len(views), size=count)]
    points = np.empty((count, 3))
    for i, camera in enumerate(cameras):
        x = (rng.uniform(0, camera.width) - camera.cx) / camera.fx
        y = (rng.uniform(0, camera.height) - camera.cy) / camera.fy
        depth = math.exp(rng.uniform(near, far))
        in_camera = depth * np.array([x, -y, -1.0])  # OpenGL axes
        points[i] = camera.camera_to_world[:3, :3] @ in_camera + camera.position
    return points


@dataclass(frozen=True)
class FirstPoints:
    """Where Gaussians start, ``positions`` ``[P, 3]`` (metres), and their source: a line for the user.

    ``colours`` ``[P, 3]`` in [0, 1]: those of the data set's points, None where they come from elsewhere.
    ``are_random``: they do not say where the scene is.
    """

    positions: np.ndarray
    message: str
    colours: np.ndarray | None = None
    are_random: bool = False


def initial_points(
    scene: Scene,
    views: list[View],
    exposures: list[tuple[int, ...]],
    response: Response,
    *,
    source: Source,
    random_count: int,
    budget: int,
    seed: int,
) -> FirstPoints:
    """The data set's points, or those of stereo, or random ones, as ``source`` says.

    ``auto``: the data set's if it has any, else stereo's; where views do not overlap, random ones. ``both``:
    as well as the data set's those that stereo finds where it has none. Stereo reads ``views`` (of one light)
    at ``exposures``, their indices that training may see; ``budget``: Gaussians that there may be at last
    (0: any number), of which stereo leaves some to densification. Sorted by place (``morton``), as
    densification keeps them. Raises ``BadValueError`` where ``source`` has none.
    """
    points = _points(scene, views, exposures, response, source, random_count, budget, seed)
    order = morton_order(torch.as_tensor(points.positions)).numpy()
    colours = None if points.colours is None else points.colours[order]
    return replace(points, positions=points.positions[order], colours=colours)


def _points(
    scene: Scene,
    views: list[View],
    exposures: list[tuple[int, ...]],
    response: Response,
    source: Source,
    random_count: int,
    budget: int,
    seed: int,
) -> FirstPoints:
    given = _given_points(scene) if source in ("auto", "both", "file") else None
    if source == "file" and given is None:
        raise BadValueError(
            f"{scene.root} has no points3d.ply",
            "Train with --initial-points auto, which finds points by stereo, or with those of structure from "
            f"motion: physhdr prepare {scene.root} --triangulate, then --points-file points3d_sfm.ply.",
        )
    if given is not None and source != "both":
        return given
    if source == "random":
        return _random(scene, random_count, seed, "as asked for")
    most = most_of_stereo(budget, 0 if given is None else len(given.positions))
    seen = _thinned(seen_points(views, exposures, response), most)
    if len(seen) >= FEWEST_STEREO_POINTS:
        if given is None:
            return FirstPoints(seen, f"{len(seen):,} points by stereo from the training views")
        return _joined(given, seen)
    if given is not None:
        return given
    if source == "stereo":
        raise BadValueError(
            f"stereo found {len(seen)} points on {scene.root}, too few to start from",
            "Its views overlap too little: train with --initial-points random.",
        )
    return _random(
        scene, random_count, seed, "the data set has no points and its views overlap too little for stereo"
    )


def _given_points(scene: Scene) -> FirstPoints | None:
    if scene.points is None:
        return None
    positions, colours = (a.astype(np.float64) for a in (scene.points.positions, scene.points.colours))
    return FirstPoints(positions, str(scene.points), colours)


def _random(scene: Scene, count: int, seed: int, why: str) -> FirstPoints:
    positions = random_points(scene.train, count, seed)
    return FirstPoints(positions, f"{count:,} random points ({why})", are_random=True)


def seen_points(views: list[View], exposures: list[tuple[int, ...]], response: Response) -> np.ndarray:
    """Points ``[P, 3]`` (metres) that stereo finds in ``views``, each merged from its ``exposures``."""
    votes = Votes(response)
    return stereo_points(
        [
            stereo_view(view.camera, *log_radiance_picture(view, indices, votes))
            for view, indices in zip(views, exposures, strict=True)
        ]
    )


def most_of_stereo(budget: int, given: int) -> int:
    """How many points of stereo a training begins with at most, beside ``given`` ones of the data set."""
    if not budget:
        return MOST_STEREO_POINTS
    room = max(FILLED * budget - given, LEAST_STEREO * budget, FEWEST_STEREO_POINTS)
    return min(round(room), MOST_STEREO_POINTS)


def _thinned(positions: np.ndarray, most: int) -> np.ndarray:
    """At most so many of ``positions`` ``[P, 3]``, evenly spread."""
    if len(positions) > most:
        along = morton_order(torch.as_tensor(positions)).numpy()
        positions = positions[along[np.linspace(0, len(along) - 1, most).astype(int)]]
    return positions


def _joined(given: FirstPoints, seen: np.ndarray) -> FirstPoints:
    """The data set's points, and those of stereo where it has none.

    What lies behind mirrors, panes and windows, and the sky, stereo sees where light seems to come from;
    surfaces that were sampled, or matched sparsely, are not there. A point of stereo that has a given one
    nearer than its own neighbours (the mean distance of three) says nothing new.
    """
    from scipy.spatial import KDTree  # here, because only this needs SciPy

    spacing = KDTree(seen).query(seen, k=4)[0][:, 1:].mean(axis=1)  # its nearest is itself
    new = seen[KDTree(given.positions).query(seen)[0] > spacing]
    message = f"{given.message}, {len(new):,} more by stereo"
    return FirstPoints(np.concatenate([given.positions, new]), message)


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


def largest_sizes(points: np.ndarray, cameras: Sequence[Camera], share: float) -> np.ndarray:
    """``[P]`` metres: what is ``share`` of the width of the picture that sees each of ``points`` nearest.

    Infinite of those that are in no picture. Occlusion is not considered.
    """
    largest = np.full(len(points), np.inf)
    for camera in cameras:
        seen, _ = _pixels(points, camera)
        depth = points[seen] @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
        largest[seen] = np.minimum(largest[seen], share * camera.width / camera.fx * depth)
    return largest


def merged_log_radiance(
    points: np.ndarray,
    views: list[View],
    exposures: list[tuple[int, ...]],
    response: Response,
    bounds: tuple[float, float],
) -> np.ndarray:
    """ln radiance ``[P, 3]`` of points, merged from the pictures that training may see, within ``bounds``.

    ``exposures[i]`` are the indices allowed for ``views[i]``. Points that nobody sees get the mean.
    """
    total = np.zeros((len(points), 3))
    weight_sum = np.full((len(points), 3), 1e-6)
    votes = Votes(response)
    for view, indices in zip(views, exposures, strict=True):
        seen, pixel = _pixels(points, view.camera)
        row, column = pixel[seen].T
        for k in indices:
            mask = view.mask(k)
            compared = None if mask is None else mask[row, column]
            codes = view.image(k)[row, column]
            vote, weight = votes.cast(codes, view.exposures[k], view.encodings[k], compared)
            total[seen] += vote
            weight_sum[seen] += weight
    merged = total / weight_sum
    unseen = weight_sum[:, 0] < 1e-4
    if unseen.any() and not unseen.all():
        merged[unseen] = merged[~unseen].mean(axis=0)
    return merged.clip(*bounds)
