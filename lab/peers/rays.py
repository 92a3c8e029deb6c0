# SPDX-License-Identifier: GPL-3.0-or-later
"""The space that a neural field is sampled in: rays of metric cameras as segments o + t d, 0 ≤ t ≤ 1.

Two ways. *NDC*, for cameras that all face alike: the frustum in front of the near plane, infinity included,
becomes the cube [−1, 1]³ (NeRF, Mildenhall et al. 2020, appendix C), in the frame of the mean camera.
*Metric* otherwise: from the nearest to the farthest point of the scene, moved and scaled into the cube,
because the positional encoding resolves about that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import nn

from ...backend.scene.camera import Camera
from ...bridge.errors import BadValueError

Kind = Literal["ndc", "metric"]
KINDS: tuple[Kind, ...] = ("ndc", "metric")

#: Rays within this angle (degrees) of the mean camera's axis can be in NDC: there they meet its planes.
WIDEST_NDC_ANGLE = 75.0
#: The nearest and the farthest depth are these quantiles of what cameras see: single points may be wrong …
NEAREST, FARTHEST = 0.005, 0.995
#: … with this much margin before and behind (LLFF: the near plane is at 0.75 of the nearest depth).
BEFORE, BEHIND = 0.75, 1.25
#: Without points: depths in units of the largest distance between cameras.
BLIND_RANGE = (0.5, 20.0)
#: Points beyond this many cannot change a quantile that matters.
MOST_POINTS = 20_000


@dataclass(frozen=True)
class Rays:
    """Segments in the field's space: points are ``origins + t · directions`` for t in [0, 1].

    ``origins``, ``directions`` ``[R, 3]``; ``views`` ``[R, 3]``: unit directions of sight in the mean
    camera's frame (not bent by NDC).
    """

    origins: torch.Tensor
    directions: torch.Tensor
    views: torch.Tensor

    def __len__(self) -> int:
        return self.origins.shape[0]

    def split(self, size: int) -> list["Rays"]:
        """Consecutive parts of at most ``size`` rays."""
        parts = zip(*(each.split(size) for each in (self.origins, self.directions, self.views)), strict=True)
        return [Rays(*part) for part in parts]

    def points(self, t: torch.Tensor) -> torch.Tensor:
        """``[R, S, 3]`` for ``t`` ``[R, S]``."""
        return self.origins[:, None] + t[..., None] * self.directions[:, None]


class RaySpace(nn.Module):
    """The map from the world to the field's space, in buffers, so that a checkpoint holds it.

    ``kind``: −1 before ``survey``, then the index in ``KINDS``. ``frame`` ``[4, 4]`` float64: from the world
    into the mean camera's frame (OpenGL axes). ``numbers`` ``[6]`` float64: NDC: near plane (metres), 2 f/W,
    2 f/H; metric: near, far (metres along the ray), scale (1/metres) and centre in the frame.
    """

    kind: torch.Tensor
    frame: torch.Tensor
    numbers: torch.Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("kind", torch.tensor(-1))
        self.register_buffer("frame", torch.eye(4, dtype=torch.float64))
        self.register_buffer("numbers", torch.zeros(6, dtype=torch.float64))

    @property
    def is_known(self) -> bool:
        return int(self.kind) >= 0

    @property
    def name(self) -> Kind:
        """Which of the two ways; raises ``BadValueError`` before ``survey``."""
        if not self.is_known:
            raise BadValueError(
                "this HDR-NeRF has not seen its scene yet",
                "Train it: its rays are set at the first iteration.",
            )
        if int(self.kind) >= len(KINDS):  # of a checkpoint that was made by hand
            raise BadValueError(
                f"there is no kind {int(self.kind)} of rays", "Restore a copy, or train again."
            )
        return KINDS[int(self.kind)]

    def survey(
        self, cameras: Sequence[Camera], points: np.ndarray, kind: Literal["auto", "ndc", "metric"]
    ) -> None:
        """Set the map for ``cameras`` that look at ``points`` ``[P, 3]`` (metres; may be none).

        Raises ``BadValueError`` where NDC is asked for and the cameras do not face alike.
        """
        frame = mean_frame(cameras)
        near, far, seen = _depths(cameras, points, frame)
        why_not = _why_not_ndc(cameras, frame, near)
        if kind == "ndc" and why_not:
            raise BadValueError(f"the rays cannot be in NDC: {why_not}", "Give --set method.rays=metric.")
        if kind == "metric" or why_not:
            near, far, seen = _distances(cameras, points, frame)
            ends = np.concatenate([_apply(frame, np.array([c.position for c in cameras])), seen])
            low, high = ends.min(axis=0), ends.max(axis=0)
            values = [near, far, 2.0 / float((high - low).max()), *(0.5 * (low + high))]
        else:
            width = float(np.mean([2.0 * camera.fx / camera.width for camera in cameras]))
            height = float(np.mean([2.0 * camera.fy / camera.height for camera in cameras]))
            values = [near, width, height, 0.0, 0.0, 0.0]
        self.kind.fill_(KINDS.index("metric" if kind == "metric" or why_not else "ndc"))
        self.frame.copy_(torch.as_tensor(frame))
        self.numbers.copy_(torch.as_tensor(values))

    def poses(self, cameras: Sequence[Camera]) -> torch.Tensor:
        """Camera to mean camera's frame, ``[N, 3, 4]`` float64, where this module is."""
        poses = np.stack([camera.camera_to_world for camera in cameras])
        return (self.frame @ torch.as_tensor(poses).to(self.frame))[:, :3]

    def rays(self, poses: torch.Tensor, directions: torch.Tensor, dtype: torch.dtype) -> Rays:
        """Rays of pixels, computed in float64, given in ``dtype``.

        ``poses`` ``[R or 1, 3, 4]`` as of ``poses``; ``directions`` ``[R, 3]`` in the camera's axes.
        """
        sight = (poses[:, :, :3] @ directions[..., None]).squeeze(-1)
        origins = poses[:, :, 3].expand_as(sight)
        views = sight / sight.norm(dim=1, keepdim=True)
        if self.name == "ndc":
            origins, ends = _ndc(origins, sight, self.numbers[:3])
            steps = ends - origins
        else:
            near, far, scale = self.numbers[:3]
            origins = (origins + near * views - self.numbers[3:]) * scale
            steps = views * (far - near) * scale
        return Rays(origins.to(dtype), steps.to(dtype), views.to(dtype))


def pixel_directions(camera: Camera, rows: torch.Tensor, columns: torch.Tensor) -> torch.Tensor:
    """Where pixel centres are seen, ``[R, 3]`` float64 in the camera's (OpenGL) axes with z = −1."""
    x = (columns.double() + 0.5 - camera.cx) / camera.fx
    y = (rows.double() + 0.5 - camera.cy) / camera.fy
    return torch.stack([x, -y, -torch.ones_like(x)], dim=1)


def mean_frame(cameras: Sequence[Camera]) -> np.ndarray:
    """``[4, 4]``: from the world into the frame of the mean camera (OpenGL axes)."""
    poses = np.stack([camera.camera_to_world for camera in cameras])
    backward = _unit(poses[:, :3, 2].sum(axis=0), fallback=poses[0, :3, 2])
    up = poses[:, :3, 1].sum(axis=0)
    right = _unit(np.cross(up, backward), fallback=poses[0, :3, 0])
    right = _unit(right - backward * (right @ backward), fallback=np.roll(backward, 1))
    frame = np.eye(4)
    frame[:3, :3] = np.stack([right, np.cross(backward, right), backward])
    frame[:3, 3] = -frame[:3, :3] @ poses[:, :3, 3].mean(axis=0)
    return frame


def _unit(vector: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-6 else fallback


def _apply(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ frame[:3, :3].T + frame[:3, 3]


def _ndc(
    origins: torch.Tensor, directions: torch.Tensor, numbers: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Where rays start, on the near plane, and where they end, at infinity, in NDC: each ``[R, 3]``.

    A point (x, y, z) is at (−a_x x/z, −a_y y/z, 1 + 2n/z); along a ray it moves on a straight line, whose end
    is (−a_x d_x/d_z, −a_y d_y/d_z, 1).
    """
    near, width, height = numbers
    reach = -(near + origins[:, 2:]) / directions[:, 2:]
    x, y, z = (origins + reach * directions).unbind(1)
    dx, dy, dz = directions.unbind(1)
    starts = torch.stack([-width * x / z, -height * y / z, 1.0 + 2.0 * near / z], dim=1)
    return starts, torch.stack([-width * dx / dz, -height * dy / dz, torch.ones_like(dz)], dim=1)


def _seen(cameras: Sequence[Camera], points: np.ndarray) -> list[np.ndarray]:
    """For each camera the points ``[?, 3]`` that are in its picture; what hides them is not considered."""
    points = points[:: max(1, len(points) // MOST_POINTS)]
    seen = []
    for camera in cameras:
        x, y, z = _apply(camera.world_to_camera, points).T
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = (z > 0.01) & (column > 0) & (column < camera.width) & (row > 0) & (row < camera.height)
        seen.append(points[inside])
    return seen


def _range(depths: np.ndarray, cameras: Sequence[Camera]) -> tuple[float, float]:
    """From where to where something is to be seen: of ``depths``, or of nothing but the cameras."""
    depths = depths[depths > 0.0]
    if len(depths):
        near, far = np.quantile(depths, [NEAREST, FARTHEST])
        return float(BEFORE * near), float(BEHIND * far)
    centres = np.array([camera.position for camera in cameras])
    extent = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()) or 1.0
    return BLIND_RANGE[0] * extent, BLIND_RANGE[1] * extent


def _depths(
    cameras: Sequence[Camera], points: np.ndarray, frame: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Nearest and farthest depth along the mean camera's axis, and the seen points in its frame."""
    seen = _apply(frame, np.concatenate(_seen(cameras, points)))
    return *_range(-seen[:, 2], cameras), seen


def _distances(
    cameras: Sequence[Camera], points: np.ndarray, frame: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Nearest and farthest distance from a camera, and the seen points (or guesses) in the mean frame."""
    each = _seen(cameras, points)
    gaps = [
        np.linalg.norm(some - camera.position, axis=1) for some, camera in zip(each, cameras, strict=True)
    ]
    near, far = _range(np.concatenate(gaps), cameras)
    seen = np.concatenate(each)
    if len(seen):
        seen = np.quantile(_apply(frame, seen), [1.0 - FARTHEST, FARTHEST], axis=0)
    else:
        seen = _apply(frame, np.array([c.position - far * c.camera_to_world[:3, 2] for c in cameras]))
    return near, far, seen


def _why_not_ndc(cameras: Sequence[Camera], frame: np.ndarray, near: float) -> str:
    """Why the rays cannot be in NDC, or nothing."""
    limit = np.cos(np.radians(WIDEST_NDC_ANGLE))
    for camera in cameras:
        edges = torch.tensor([-0.5, camera.height - 0.5]), torch.tensor([-0.5, camera.width - 0.5])
        rows, columns = (grid.reshape(-1) for grid in torch.meshgrid(*edges, indexing="ij"))
        directions = pixel_directions(camera, rows, columns).numpy()
        sight = directions @ (frame[:3, :3] @ camera.camera_to_world[:3, :3]).T
        if (-sight[:, 2] < limit * np.linalg.norm(sight, axis=1)).any():
            return f"cameras look farther than {WIDEST_NDC_ANGLE:g}° from their mean direction"
        if -_apply(frame, camera.position[None])[0, 2] >= near:
            return f"a camera stands beyond the near plane, {near:.3g} m before the mean camera"
    return ""
