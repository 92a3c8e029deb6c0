# SPDX-License-Identifier: GPL-3.0-or-later
"""First points without structure from motion: plane-sweep stereo on the training brackets.

Each view is compared with its neighbours at a series of inverse depths (a plane sweep, Collins 1996), the
costs are made smooth along eight directions (semi-global matching, Hirschmüller 2008: it carries depth into
walls without texture), and only what neighbouring views agree on becomes a point. Pictures are compared as
merged ln radiance, where an exposure, a lamp or a wrong response is nearly an offset, by correlation of
patches, which is blind to offsets and gains.

Everything metric comes from the cameras: neighbours, the range of depths and its steps.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch

from ..scene.camera import Camera

#: Pictures are shrunk to at most this many pixels across: points need not be denser, and cost is cubic.
WORK_WIDTH = 100
#: How many neighbours a view is compared with, and how many of them (the best) a pixel believes: what one
#: side does not see, the other may.
NEIGHBOURS, BELIEVED = 6, 3
#: Neighbours look in directions at most this far apart (degrees): beyond, patches no longer look alike.
LARGEST_ANGLE = 60.0
#: A depth is considered where this share of the pixels is seen by at least two neighbours.
SMALLEST_OVERLAP = 0.25
#: At most this many depths; steps are about a pixel of parallax against the farthest neighbour.
FEWEST_DEPTHS, MOST_DEPTHS = 24, 128
#: Sides of the patches, pixels (odd).
PATCH = 5
#: Contrast (standard deviation of ln radiance) below which a patch is noise: a code of 8 bits is about this.
NOISE = 0.02
#: Semi-global matching: penalties for a step of one depth and for any larger one, in units of 1 − score.
SMALL_STEP, LARGE_STEP = 0.05, 0.4
#: A pixel is kept if at least this many neighbours have the same depth there, to this many steps.
AGREEING, AGREEMENT = 2, 1.0


@dataclass(frozen=True)
class StereoView:
    """What stereo sees of a view, at working size: its camera and ln radiance ``[3, H, W]`` float32.

    ``known`` ``[H, W]`` bool: where there is a surface to find; a void is black (or white) at every exposure.
    """

    camera: Camera
    picture: torch.Tensor
    known: torch.Tensor


def stereo_view(camera: Camera, log_radiance: np.ndarray, known: np.ndarray) -> StereoView:
    """Shrink a view to the working size; ``log_radiance`` ``[H, W, 3]``, ``known`` ``[H, W]`` bool."""
    small = camera.resized(min(camera.width, WORK_WIDTH))
    stack = np.concatenate([log_radiance, known[..., None]], axis=2).transpose(2, 0, 1)
    picture = torch.from_numpy(np.ascontiguousarray(stack, dtype=np.float32))
    if small.width != camera.width:
        size = (small.height, small.width)
        picture = torch.nn.functional.interpolate(
            picture[None], size, mode="bilinear", antialias=True, align_corners=False
        )[0]
    return StereoView(small, picture[:3], picture[3] > 0.5)


def stereo_points(views: list[StereoView]) -> np.ndarray:
    """Surface points ``[P, 3]`` (metres, Blender's world) on which neighbouring views agree.

    About one point for each pixel of the working size that shows a surface no earlier view has shown.
    Deterministic. Empty where there is nothing to triangulate: one view, views of one position, no overlap.
    """
    neighbours = [_neighbours(i, [view.camera for view in views]) for i in range(len(views))]
    found = [
        _depth_map(view, [views[j] for j in others]) for view, others in zip(views, neighbours, strict=True)
    ]
    maps = {i: depth_map for i, depth_map in enumerate(found) if depth_map is not None}
    kept: list[np.ndarray] = []
    for i, depth_map in maps.items():
        points = depth_map.points()
        others = [maps[j] for j in neighbours[i] if j in maps]
        agreeing = torch.stack([other.agrees(points) for other in others] + [points[:, 0] < -math.inf]).sum(
            dim=0
        )
        keep = depth_map.kept & (agreeing >= min(AGREEING, len(neighbours[i])))
        # A surface that an earlier view gave is not given again.
        for j in range(i):
            if j in maps:
                keep &= ~maps[j].gave(points)
        depth_map.kept = keep
        kept.append(points[keep].numpy())
    return np.concatenate([*kept, np.zeros((0, 3))])


@dataclass
class _DepthMap:
    """A view's inverse depths ``[H, W]`` float32 (1/m along the optical axis) and their ``step``.

    ``kept``: which pixels become points, ``[H·W]`` bool; before they are checked, which ones may.
    """

    camera: Camera
    inverse_depth: torch.Tensor
    step: float
    kept: torch.Tensor

    def points(self) -> torch.Tensor:
        """Every pixel's point in the world, ``[H·W, 3]`` float64."""
        in_camera = _rays(self.camera) / self.inverse_depth.double().reshape(-1, 1)
        rotation, translation = _pose(self.camera)
        return (in_camera - translation) @ rotation  # the inverse of X_c = R X + t

    def _pixels(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Flat pixel numbers ``[P]``, which points are in the picture ``[P]``, inverse depths ``[P]``."""
        rotation, translation = _pose(self.camera)
        pixel, depth = _project(self.camera, points @ rotation.T + translation)
        inside = _inside(self.camera, pixel, depth)
        column, row = pixel.nan_to_num(0.0, 0.0, 0.0).floor().long().unbind(-1)
        number = torch.where(inside, row * self.camera.width + column, torch.zeros_like(row))
        return number, inside, 1.0 / depth

    def agrees(self, points: torch.Tensor) -> torch.Tensor:
        """Whether this view sees a surface where the ``points`` ``[P, 3]`` are, ``[P]`` bool."""
        number, inside, inverse_depth = self._pixels(points)
        difference = (self.inverse_depth.reshape(-1)[number] - inverse_depth).abs()
        return inside & (difference <= AGREEMENT * self.step)

    def gave(self, points: torch.Tensor) -> torch.Tensor:
        """Whether this view already gave a point where the ``points`` ``[P, 3]`` are, ``[P]`` bool."""
        number, _, _ = self._pixels(points)
        return self.agrees(points) & self.kept[number]


def _pose(camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """R ``[3, 3]`` and t ``[3]``, float64, of X_c = R X + t (OpenCV's axes)."""
    matrix = torch.from_numpy(camera.world_to_camera)
    return matrix[:3, :3], matrix[:3, 3]


def _rays(camera: Camera) -> torch.Tensor:
    """Points at depth 1 through the pixels' centres, row by row, ``[H·W, 3]`` float64, in the camera."""
    y, x = torch.meshgrid(
        (torch.arange(camera.height, dtype=torch.float64) + 0.5 - camera.cy) / camera.fy,
        (torch.arange(camera.width, dtype=torch.float64) + 0.5 - camera.cx) / camera.fx,
        indexing="ij",
    )
    return torch.stack([x, y, torch.ones_like(x)], dim=-1).reshape(-1, 3)


def _project(camera: Camera, in_camera: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Pixels ``[…, 2]`` (x, y) and depths ``[…]`` of points in the camera's axes."""
    depth = in_camera[..., 2]
    x = camera.fx * in_camera[..., 0] / depth + camera.cx
    y = camera.fy * in_camera[..., 1] / depth + camera.cy
    return torch.stack([x, y], dim=-1), depth


def _inside(camera: Camera, pixel: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
    x, y = pixel.unbind(-1)
    return (depth > 0.0) & (x >= 0.0) & (x < camera.width) & (y >= 0.0) & (y < camera.height)


def _neighbours(index: int, cameras: list[Camera]) -> list[int]:
    """The nearest other cameras that look in a similar direction from another place."""
    me = cameras[index]
    distance = [float(np.linalg.norm(other.position - me.position)) for other in cameras]
    alike = math.cos(math.radians(LARGEST_ANGLE))
    able = [
        i
        for i, other in enumerate(cameras)
        if distance[i] > 1e-6 * max(distance)
        and me.camera_to_world[:3, 2] @ other.camera_to_world[:3, 2] > alike
    ]
    return sorted(able, key=lambda i: distance[i])[:NEIGHBOURS]


def _homogeneous(
    rays: torch.Tensor, inverse_depths: torch.Tensor, camera: Camera, other: Camera
) -> torch.Tensor:
    """Where points on ``rays`` ``[P, 3]`` lie in the picture of ``other``: ``[3, D, P]`` float32.

    Rows 0 and 1 over row 2 are −1 … 1 across the picture; row 2 is positive in front of the camera.
    X_o = R r / w + t is, times w, R r + t w: finite at infinity too, where w = 0.
    """
    R_me, t_me = _pose(camera)
    R_other, t_other = _pose(other)
    R = R_other @ R_me.T
    t = t_other - R @ t_me
    across = torch.tensor(
        [
            [2.0 * other.fx / other.width, 0.0, 2.0 * other.cx / other.width - 1.0],
            [0.0, 2.0 * other.fy / other.height, 2.0 * other.cy / other.height - 1.0],
            [0.0, 0.0, 1.0],
        ],
        dtype=torch.float64,
    )
    at_infinity = (across @ R @ rays.T).float()
    per_inverse_depth = (across @ t).float()
    return at_infinity[:, None] + per_inverse_depth[:, None, None] * inverse_depths.float()[:, None]


def _inverse_depths(camera: Camera, others: list[Camera]) -> torch.Tensor | None:
    """The inverse depths ``[D]`` to try, evenly spread; ``None`` where the views do not overlap.

    From the farthest to the nearest depth at which neighbours see what the camera sees, in steps of about a
    pixel's motion in the neighbour where it moves most.
    """
    rays = _rays(camera)[:: max(1, camera.width * camera.height // 256)]
    baseline = np.median([np.linalg.norm(other.position - camera.position) for other in others])
    candidates = torch.cat([torch.zeros(1), torch.logspace(-3.0, 1.0, 81)]).double() / float(baseline)
    seen, motion = [], []
    for other in others:
        homogeneous = _homogeneous(rays, candidates, camera, other)
        place = homogeneous[:2] / homogeneous[2]
        inside = (homogeneous[2] > 0.0) & (place.abs() < 1.0).all(dim=0)
        seen.append(inside)
        pixels = (
            (place[:, 1:] - place[:, :-1]) * torch.tensor([other.width, other.height])[:, None, None] / 2.0
        )
        moved = torch.linalg.vector_norm(pixels, dim=0)
        motion.append(torch.where(inside[1:] & inside[:-1], moved, 0.0))
    enough = torch.stack(seen).sum(dim=0) >= min(2, len(others))
    possible = (enough.double().mean(dim=1) >= SMALLEST_OVERLAP).nonzero().flatten()
    if possible.numel() < 2:
        return None
    first, last = int(possible[0]), int(possible[-1])
    way = torch.stack(motion)[:, first:last].sum(dim=1)  # [neighbours, rays], pixels
    count = int(min(max(math.ceil(float(way.quantile(0.9, dim=1).max())), FEWEST_DEPTHS), MOST_DEPTHS))
    low, high = float(candidates[first]), float(candidates[last])
    return low + (high - low) * (torch.arange(count, dtype=torch.float64) + 0.5) / count


def _means(stack: torch.Tensor) -> torch.Tensor:
    """Means over patches of ``[N, H, W]``; the border is repeated outward.

    Sums of shifted slices: torch's pooling takes ten times as long on a CPU.
    """
    half = PATCH // 2
    height, width = stack.shape[1:]
    padded = torch.nn.functional.pad(stack[None], (half, half, half, half), mode="replicate")[0]
    rows = padded[:, :height].clone()
    for i in range(1, PATCH):
        rows += padded[:, i : i + height]
    result = rows[:, :, :width].clone()
    for i in range(1, PATCH):
        result += rows[:, :, i : i + width]
    return result.div_(PATCH**2)


def _scores(view: StereoView, other: StereoView, inverse_depths: torch.Tensor) -> torch.Tensor:
    """Correlation of patches of ``view`` with ``other`` at each depth, ``[D, H, W]`` in −1 … 1.

    0 where ``other`` does not see the point, and near 0 where there is nothing to see.
    """
    camera = view.camera
    shape = (inverse_depths.numel(), camera.height, camera.width)
    homogeneous = _homogeneous(_rays(camera), inverse_depths, camera, other.camera)
    x, y = homogeneous[0] / homogeneous[2], homogeneous[1] / homogeneous[2]
    inside = (homogeneous[2] > 0.0) & (x.abs() < 1.0) & (y.abs() < 1.0)
    grid = torch.stack([x, y], dim=-1).nan_to_num_(2.0, 2.0, 2.0)[None]
    grey, other_grey = (v.picture.mean(dim=0, keepdim=True) for v in (view, other))
    # Less the mean over the picture: float32's squares of large numbers would leave nothing of small ones.
    grey, other_grey = grey - grey.mean(), other_grey - other_grey.mean()
    warped = torch.nn.functional.grid_sample(
        other_grey[None], grid, padding_mode="border", align_corners=False
    ).view(shape)
    mean, warped_mean = _means(grey), _means(warped)
    variance = (_means(grey * grey) - mean * mean).clamp_min_(0.0) + NOISE**2
    warped_variance = _means(warped * warped).addcmul_(warped_mean, warped_mean, value=-1.0)
    warped_variance = warped_variance.clamp_min_(0.0).add_(NOISE**2)
    covariance = _means(grey * warped).addcmul_(mean, warped_mean, value=-1.0)
    score = covariance * (variance * warped_variance).rsqrt_()
    return torch.where(inside.view(shape), score, 0.0)


def _believed(scores: Iterable[torch.Tensor]) -> torch.Tensor:
    """The mean of the ``BELIEVED`` best of some scores ``[D, H, W]`` at each place."""
    best: list[torch.Tensor] = []
    for score in scores:
        for i, better in enumerate(best):
            best[i], score = torch.maximum(better, score), torch.minimum(better, score)
        if len(best) < BELIEVED:
            best.append(score)
    return sum(best[1:], start=best[0]) / len(best)


def _semi_global(cost: torch.Tensor) -> torch.Tensor:
    """Sum over eight directions of the cheapest path to each pixel at each depth, ``[D, H, W]``."""
    total = torch.zeros_like(cost)
    for turned in (False, True):
        turn = (lambda x: x.transpose(-1, -2)) if turned else (lambda x: x)
        both_ways = torch.stack([turn(cost), turn(cost).flip(1)])
        for shift in (0,) if turned else (-1, 0, 1):
            down, up = _paths(both_ways, shift)
            total += turn(down + up.flip(1))
    return total


def _paths(cost: torch.Tensor, shift: int) -> torch.Tensor:
    """The cheapest paths that come from the row above, ``shift`` columns to the side, ``[B, D, H, W]``."""
    result = torch.empty_like(cost)
    result[:, :, 0] = cost[:, :, 0]
    for row in range(1, cost.shape[2]):
        before = result[:, :, row - 1].roll(shift, dims=-1)
        least = before.amin(dim=1, keepdim=True)
        way = torch.minimum(before, least + LARGE_STEP)
        way[:, 1:] = torch.minimum(way[:, 1:], before[:, :-1] + SMALL_STEP)
        way[:, :-1] = torch.minimum(way[:, :-1], before[:, 1:] + SMALL_STEP)
        way -= least
        if shift:
            way[..., 0 if shift > 0 else -1] = 0.0  # paths begin at the picture's border
        result[:, :, row] = cost[:, :, row] + way
    return result


def _depth_map(view: StereoView, others: list[StereoView]) -> _DepthMap | None:
    """The view's depth map by plane sweep against ``others``; ``None`` where nothing can be compared."""
    inverse_depths = _inverse_depths(view.camera, [other.camera for other in others]) if others else None
    if inverse_depths is None:
        return None
    cost = _semi_global(1.0 - _believed(_scores(view, other, inverse_depths) for other in others))

    best = cost.argmin(dim=0, keepdim=True)
    last = inverse_depths.numel() - 1
    # The vertex of the parabola through the best depth and the two beside it.
    below, here, above = (cost.gather(0, (best + d).clamp(0, last))[0] for d in (-1, 0, 1))
    curvature = (below - 2.0 * here + above).clamp_min(1e-6)
    offset = (0.5 * (below - above) / curvature).clamp(-0.5, 0.5)
    step = float(inverse_depths[1] - inverse_depths[0])
    inverse_depth = float(inverse_depths[0]) + step * (best[0] + offset)
    usable = (best[0] > 0) & (best[0] < last) & view.known
    return _DepthMap(view.camera, inverse_depth, step, usable.reshape(-1))
