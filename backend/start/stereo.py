# SPDX-License-Identifier: GPL-3.0-or-later
"""First points without structure from motion: plane-sweep stereo on the training brackets.

Each view is compared with its neighbours at a series of inverse depths (a plane sweep, Collins 1996), the
costs are made smooth along eight directions (semi-global matching, Hirschmüller 2008: it carries depth into
walls without texture), and only what neighbouring views agree on becomes a point. Pictures are compared as
merged ln radiance, where an exposure, a lamp or a wrong response is nearly an offset, by correlation of
patches, which is blind to offsets and gains.

What has no texture and no edge of its own gets the depth of what surrounds it: the sky that of the window's
frame. Views from elsewhere see through such points what lies behind, by which they are known and dropped.

Everything metric comes from the cameras: neighbours, the range of depths and its steps. What cameras could
see in common reaches much nearer than what there is, so a rough sweep at half the size comes first: it finds
over which depths the scene lies, for finer steps, and who sees what of it, for neighbours that together see
all of a picture.

Correlation and matching are kernels (``kernels/stereo.py``, with their constants); each thread works on a
view of its own.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.stereo import matching_costs, semi_global
from ..scene.camera import Camera
from ..simd import run_parallel

#: Pictures are shrunk to at most this many pixels across: how exact points are is a matter of it; cost is
#: cubic.
WORK_WIDTH = 200
#: How many neighbours a view is compared with. Once its depths are known on the whole so many of them are
#: simply the nearest; the others are those of ``CANDIDATES`` that see most of what fewer than ``SEEN_OFTEN``
#: see so far.
NEIGHBOURS, NEAREST, CANDIDATES, SEEN_OFTEN = 8, 4, 64, 3
#: Nearer ones than this share of the cameras' extent (their largest distance from their mean) are taken last.
SMALLEST_BASELINE = 0.1
#: Neighbours look in directions at most this far apart (degrees): beyond, patches no longer look alike.
LARGEST_ANGLE = 60.0
#: A depth is considered at first where this share of the pixels is seen by at least two neighbours; and then
#: where all but these shares of a view's points are, and as far beyond as this share of their range.
SMALLEST_OVERLAP, OUTSIDE, BEYOND = 0.25, 0.005, 0.5
#: With fewer points in a view its range counts as unknown.
FEWEST_IN_VIEW = 100
#: At most this many depths; steps are about a pixel of parallax against the farthest neighbour.
FEWEST_DEPTHS, MOST_DEPTHS = 24, 256
#: A pixel is kept if at least this many neighbours have the same depth there, to this many steps.
AGREEING, AGREEMENT = 2, 1.5
#: A view sees through a point where its own surface is farther by more than this many steps. A point goes if
#: more than this share of the views that see a surface at it see through it.
BEHIND, SEEN_THROUGH = 3.0, 0.25


@dataclass(frozen=True)
class StereoView:
    """What stereo sees of a view, at working size: its camera and ln radiance ``[H, W]`` float32, its mean 0.

    ``known`` ``[H, W]`` bool: where there is a surface to find; a void is black (or white) at every exposure.
    """

    camera: Camera
    picture: np.ndarray
    known: np.ndarray


def stereo_view(camera: Camera, log_radiance: np.ndarray, known: np.ndarray) -> StereoView:
    """Shrink a view to the working size; ``log_radiance`` ``[H, W, 3]``, ``known`` ``[H, W]`` bool."""
    stack = np.concatenate([log_radiance, known[..., None]], axis=2).transpose(2, 0, 1)
    small, stack = _shrunk(camera, stack, min(camera.width, WORK_WIDTH))
    grey = stack[:3].mean(axis=0)
    return StereoView(small, grey - grey.mean(), stack[3] > 0.5)


def _shrunk(camera: Camera, stack: np.ndarray, width: int) -> tuple[Camera, np.ndarray]:
    """The camera of a picture so wide, and ``stack`` ``[C, H, W]`` at its size, float32."""
    small = camera.resized(width)
    picture = torch.from_numpy(np.ascontiguousarray(stack, dtype=np.float32))
    if width != camera.width:
        picture = torch.nn.functional.interpolate(
            picture[None], (small.height, small.width), mode="bilinear", antialias=True, align_corners=False
        )[0]
    return small, picture.numpy()


def _halved(view: StereoView) -> StereoView:
    small, stack = _shrunk(view.camera, np.stack([view.picture, view.known]), -(-view.camera.width // 2))
    return StereoView(small, stack[0], stack[1] > 0.5)


def stereo_points(views: list[StereoView]) -> np.ndarray:
    """Surface points ``[P, 3]`` (metres, Blender's world) on which neighbouring views agree.

    About one point for each pixel of the working size that shows a surface no earlier view has shown.
    Deterministic, for any number of threads. Empty where there is nothing to triangulate: one view, views of
    one position, no overlap.

    First at half the size, against the nearest neighbours, over all depths that these could see. That tells
    over which depths the scene lies, mostly a small part of these, and who sees what of it.
    """
    cameras = [view.camera for view in views]
    able = [_able(i, cameras) for i in range(len(views))]
    nearest = [each[:NEIGHBOURS] for each in able]
    rough = _depth_maps([_halved(view) for view in views], nearest, [None] * len(views))
    points = _agreed(rough, nearest)
    limits = [_limits(points, camera) for camera in cameras]
    neighbours = [
        _covering(rough[i], able[i], cameras) if i in rough else nearest[i] for i in range(len(views))
    ]
    return _agreed(_depth_maps(views, neighbours, limits), neighbours)


def _depth_maps(
    views: list[StereoView], neighbours: list[list[int]], limits: list[tuple[float, float] | None]
) -> dict[int, "_DepthMap"]:
    """Those of all views that can be compared with their neighbours, by their numbers, in order."""
    maps: dict[int, _DepthMap] = {}
    waiting = iter(range(len(views)))  # one for all threads: each takes the next view

    def work(_: int) -> None:
        for i in waiting:
            depth_map = _depth_map(views[i], [views[j] for j in neighbours[i]], limits[i])
            if depth_map is not None:
                maps[i] = depth_map

    run_parallel(work)
    return dict(sorted(maps.items()))


def _agreed(maps: dict[int, "_DepthMap"], neighbours: list[list[int]]) -> np.ndarray:
    """The points ``[P, 3]`` of all maps on which enough of those agree that they were compared with."""
    kept: list[np.ndarray] = []
    for i, depth_map in maps.items():
        number = np.flatnonzero(depth_map.usable)
        points = depth_map.points()[number]
        agreeing = np.zeros(len(points), np.int64)
        for j in maps:
            if j in neighbours[i] or i in neighbours[j]:
                agreeing += maps[j].agrees(points)[0]
        keep = agreeing >= min(AGREEING, len(neighbours[i]))
        number, points = number[keep], points[keep]
        # A surface that an earlier view gave is not given again.
        for j in maps:
            if j < i:
                agrees, pixel = maps[j].agrees(points)
                new = ~(agrees & maps[j].kept[pixel])
                number, points = number[new], points[new]
        depth_map.kept[number] = True
        kept.append(points)
    points = np.concatenate([*kept, np.zeros((0, 3))])
    return points[~_seen_through(points, list(maps.values()))]


def _limits(points: np.ndarray, camera: Camera) -> tuple[float, float] | None:
    """Between which inverse depths nearly all of ``points`` ``[P, 3]`` lie that are in the picture."""
    _, depth, inside = _in_picture(points, camera)
    if inside.sum() < FEWEST_IN_VIEW:
        return None
    low, high = np.quantile(1.0 / depth[inside], [OUTSIDE, 1.0 - OUTSIDE])
    margin = BEYOND * (high - low)
    return (max(0.0, float(low - margin)), float(high + margin)) if margin > 0.0 else None


def _seen_through(points: np.ndarray, maps: list["_DepthMap"]) -> np.ndarray:
    """``[P]`` bool: which of ``points`` ``[P, 3]`` stand before what other views see behind them."""
    there, through = np.zeros(len(points)), np.zeros(len(points))
    for depth_map in maps:
        nearer, pixel = depth_map.nearer(points)
        usable = depth_map.usable[pixel]
        with np.errstate(invalid="ignore"):  # NaN where points are not in the picture
            there += usable & (np.abs(nearer) <= AGREEMENT)
            through += usable & (nearer > BEHIND)
    return through > SEEN_THROUGH * there


@dataclass
class _DepthMap:
    """A view's inverse depths ``[H, W]`` float32 (1/m along the optical axis) and their ``step``.

    ``usable`` and ``kept``, ``[H·W]`` bool: where it has a surface, and which pixels became points.
    """

    camera: Camera
    inverse_depth: np.ndarray
    step: float
    usable: np.ndarray
    kept: np.ndarray

    def points(self) -> np.ndarray:
        """Every pixel's point in the world, ``[H·W, 3]`` float64."""
        with np.errstate(divide="ignore", invalid="ignore"):
            in_camera = _rays(self.camera) / self.inverse_depth.reshape(-1, 1).astype(np.float64)
            rotation, translation = _pose(self.camera)
            return (in_camera - translation) @ rotation  # the inverse of X_c = R X + t

    def agrees(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether this view sees a surface at ``points`` ``[P, 3]``, ``[P]`` bool, and their pixels."""
        nearer, pixel = self.nearer(points)
        with np.errstate(invalid="ignore"):
            return np.abs(nearer) <= AGREEMENT, pixel

    def nearer(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How many steps nearer ``points`` ``[P, 3]`` are than what this view sees there, and their pixels.

        Both ``[P]``, NaN and flat number 0 where points are not in the picture.
        """
        pixel, depth, inside = _in_picture(points, self.camera)
        with np.errstate(divide="ignore"):
            inverse_depth = 1.0 / depth
        steps = (inverse_depth - self.inverse_depth.reshape(-1)[pixel]) / self.step
        return np.where(inside, steps, np.nan), pixel


def _pose(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """R ``[3, 3]`` and t ``[3]``, float64, of X_c = R X + t (OpenCV's axes)."""
    matrix = camera.world_to_camera
    return matrix[:3, :3], matrix[:3, 3]


def _in_picture(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where ``points`` ``[P, 3]`` are seen: flat numbers of pixels, depths (m), and whether they are.

    All ``[P]``; those that are not have the number 0.
    """
    rotation, translation = _pose(camera)
    in_camera = points @ rotation.T + translation
    depth = in_camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = camera.fx * in_camera[:, 0] / depth + camera.cx
        y = camera.fy * in_camera[:, 1] / depth + camera.cy
    inside = (depth > 0.0) & (x >= 0.0) & (x < camera.width) & (y >= 0.0) & (y < camera.height)
    column, row = (np.where(inside, place, 0.0).astype(np.int64) for place in (x, y))
    return row * camera.width + column, depth, inside


def _rays(camera: Camera) -> np.ndarray:
    """Points at depth 1 through the pixels' centres, row by row, ``[H·W, 3]`` float64, in the camera."""
    y, x = np.meshgrid(
        (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy,
        (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx,
        indexing="ij",
    )
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)


def _able(index: int, cameras: list[Camera]) -> list[int]:
    """The other cameras that it can be compared with: they look in a similar direction from another place.

    The nearest first that are not too near, for of a video the frames beside one show no parallax; these come
    last, the farthest of them first, where there are not enough others.
    """
    me = cameras[index]
    places = np.array([camera.position for camera in cameras])
    distance = np.linalg.norm(places - me.position, axis=1)
    extent = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    alike = math.cos(math.radians(LARGEST_ANGLE))
    able = [
        int(i)
        for i in np.argsort(distance, kind="stable")
        if distance[i] > 1e-6 * distance.max()
        and me.camera_to_world[:3, 2] @ cameras[i].camera_to_world[:3, 2] > alike
    ]
    far = [i for i in able if distance[i] >= SMALLEST_BASELINE * extent]
    return far if len(far) >= NEIGHBOURS else [*far, *reversed(able[: len(able) - len(far)])]


def _covering(rough: "_DepthMap", able: list[int], cameras: list[Camera]) -> list[int]:
    """Whom a view of these ``rough`` depths is compared with, of those that are ``able``.

    The nearest often look all the same way and leave one side of the picture to nobody.
    """
    if len(able) <= NEIGHBOURS:
        return able
    pixels = _sample(rough.camera)
    rays, inverse_depth = _rays(rough.camera)[pixels], rough.inverse_depth.reshape(-1)[pixels]
    seen = {i: _seen(rays, inverse_depth, rough.camera, cameras[i]) for i in able[:CANDIDATES]}
    chosen, rest = able[:NEAREST], able[NEAREST:CANDIDATES]
    times = np.sum([seen[i] for i in chosen], axis=0)
    while len(chosen) < NEIGHBOURS:
        missing = (SEEN_OFTEN - times).clip(0)
        best = max(rest, key=lambda i: np.sum(missing * seen[i]))  # of equal ones the nearest
        rest.remove(best)
        chosen.append(best)
        times = times + seen[best]
    return chosen


def _homogeneous(rays: np.ndarray, camera: Camera, other: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where points on ``rays`` ``[P, 3]`` lie in the picture of ``other``, homogeneous, float32.

    At inverse depth w, the first ``[3, P]`` + w · the second ``[3]``. Rows 0 and 1 over row 2 are −1 … 1
    across the picture; row 2 is positive in front of the camera. X_o = R r / w + t is, times w, R r + t w:
    finite at infinity too, where w = 0.
    """
    R_me, t_me = _pose(camera)
    R_other, t_other = _pose(other)
    R = R_other @ R_me.T
    t = t_other - R @ t_me
    across = np.array(
        [
            [2.0 * other.fx / other.width, 0.0, 2.0 * other.cx / other.width - 1.0],
            [0.0, 2.0 * other.fy / other.height, 2.0 * other.cy / other.height - 1.0],
            [0.0, 0.0, 1.0],
        ]
    )
    return (across @ R @ rays.T).astype(np.float32), (across @ t).astype(np.float32)


def _sample(camera: Camera) -> np.ndarray:
    """Flat numbers of some 256 of its pixels, evenly spread over the picture."""
    stride = max(1, camera.width * camera.height // 256)
    while math.gcd(stride, camera.width) > 1:  # or the samples would stand in a few columns
        stride += 1
    return np.arange(0, camera.width * camera.height, stride)


def _seen(rays: np.ndarray, inverse_depth: np.ndarray, camera: Camera, other: Camera) -> np.ndarray:
    """Which points on ``rays`` ``[P, 3]`` at ``inverse_depth`` ``[P]`` are in the picture of ``other``."""
    at_infinity, per_inverse_depth = _homogeneous(rays, camera, other)
    x, y, depth = at_infinity + per_inverse_depth[:, None] * inverse_depth
    return (depth > 0.0) & (np.abs(x) < depth) & (np.abs(y) < depth)


def _inverse_depths(
    camera: Camera, others: list[Camera], limits: tuple[float, float] | None
) -> np.ndarray | None:
    """The inverse depths ``[D]`` to try, evenly spread; ``None`` where the views do not overlap.

    Between the ``limits``; or from the farthest to the nearest depth at which neighbours see what the camera
    sees. In steps of about a pixel's motion in the neighbour where it moves most.
    """
    baseline = np.median([np.linalg.norm(other.position - camera.position) for other in others])
    candidates = np.concatenate([np.zeros(1), np.logspace(-3.0, 1.0, 81)]) / baseline
    if limits is not None:
        candidates = np.linspace(*limits, len(candidates))
    seen, motion = _seen_and_moved(camera, others, candidates)
    first, last = 0, len(candidates) - 1
    if limits is None:
        enough = seen.sum(axis=0) >= min(2, len(others))
        possible = np.flatnonzero(enough.mean(axis=1) >= SMALLEST_OVERLAP)
        if len(possible) < 2:
            return None
        first, last = possible[0], possible[-1]
    way = motion[:, first:last].sum(axis=1)  # [neighbours, rays], pixels
    count = int(min(max(math.ceil(np.quantile(way, 0.9, axis=1).max()), FEWEST_DEPTHS), MOST_DEPTHS))
    low, high = candidates[first], candidates[last]
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _seen_and_moved(
    camera: Camera, others: list[Camera], inverse_depths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a sample of the camera's pixels, at ``inverse_depths`` ``[D]``, is in the others' pictures.

    Whether it is seen, ``[neighbours, D, rays]``, and by how many of their pixels it moves from one to the
    next, ``[neighbours, D − 1, rays]``, 0 where it leaves the picture.
    """
    rays = _rays(camera)[_sample(camera)]
    seen, motion = [], []
    for other in others:
        at_infinity, per_inverse_depth = _homogeneous(rays, camera, other)
        x, y, depth = (
            at_infinity[:, None]
            + per_inverse_depth[:, None, None] * inverse_depths.astype(np.float32)[:, None]
        )
        with np.errstate(all="ignore"):  # in the plane of the other camera
            x, y = x / depth, y / depth
            inside = (depth > 0.0) & (np.abs(x) < 1.0) & (np.abs(y) < 1.0)
            pixels = np.diff(x, axis=0) * (0.5 * other.width), np.diff(y, axis=0) * (0.5 * other.height)
            moved = np.sqrt(pixels[0] ** 2 + pixels[1] ** 2)
        seen.append(inside)
        motion.append(np.where(inside[1:] & inside[:-1], moved, 0.0))
    return np.stack(seen), np.stack(motion)


def _depth_map(
    view: StereoView, others: list[StereoView], limits: tuple[float, float] | None
) -> _DepthMap | None:
    """The view's depth map by plane sweep against ``others``; ``None`` where nothing can be compared."""
    cameras = [other.camera for other in others]
    inverse_depths = _inverse_depths(view.camera, cameras, limits) if others else None
    if inverse_depths is None:
        return None
    rays = _rays(view.camera)
    places = [_homogeneous(rays, view.camera, other.camera) for other in others]
    costs = matching_costs(
        view.picture,
        [other.picture for other in others],
        np.stack([at_infinity for at_infinity, _ in places]),
        np.stack([per_inverse_depth for _, per_inverse_depth in places]),
        inverse_depths,
    )
    sums = semi_global(costs)

    best = sums.argmin(axis=2)
    last = len(inverse_depths) - 1
    # The vertex of the parabola through the best depth and the two beside it.
    below, here, above = (
        np.take_along_axis(sums, np.clip(best + d, 0, last)[..., None], axis=2)[..., 0] for d in (-1, 0, 1)
    )
    curvature = np.maximum(below - 2.0 * here + above, 1e-6)
    offset = np.clip(0.5 * (below - above) / curvature, -0.5, 0.5)
    step = float(inverse_depths[1] - inverse_depths[0])
    inverse_depth = (inverse_depths[0] + step * (best + offset)).astype(np.float32)
    usable = ((best > 0) & (best < last) & view.known).reshape(-1)
    return _DepthMap(view.camera, inverse_depth, step, usable, np.zeros_like(usable))
