# SPDX-License-Identifier: GPL-3.0-or-later
"""The light at a place from all directions: many narrow renders of a model, combined on the sphere.

A rasteriser treats the projection as affine around a Gaussian's centre: exact on the optical axis, wrong at
the corners of a wide image, and sorts by depth along an axis that differs between images. So a panorama
combines ``VIEWS`` images no wider than ``HALF_VIEW`` to each side, which blend where they overlap, with
weights that are 0 at their rims: there are no seams (docs/light.md has figures).
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...bridge import panorama
from ...bridge.axes import OPENGL_TO_OPENCV
from ...bridge.model_file import Model
from ...bridge.sphere_fill import filled
from ..rasterize import Implementation, rasterize
from ..scene.camera import Camera

#: Directions of a cube's faces, edges and corners: no direction is farther than 28 degrees from one of them.
VIEWS = np.array([v for v in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
#: Half the field of view of each image, radians.
HALF_VIEW = math.radians(32.0)
#: Rows and columns of directions in a pixel; the images are as fine.
SUPERSAMPLING = 2

#: Splats are rendered at least this wide and averaged, because a rasteriser widens them to its pixels.
SPLATS_WIDTH = 512

#: Renders what a camera sees: parts ``[P, 3, H, W]``, premultiplied, and coverage ``[H, W]``; float32.
Draw = Callable[[Camera], tuple[torch.Tensor, torch.Tensor]]
#: Called with the share of the work done.
Report = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """``parts``: ``[P, H, W, 3]`` float32 scene-linear radiance, holes filled; ``unseen``: their share."""

    parts: np.ndarray
    unseen: float


def surroundings(
    draw: Draw,
    at: Sequence[float],
    width: int,
    report: Report = lambda _: None,
    drawn_width: int = SPLATS_WIDTH,
) -> Surroundings:
    """The panorama seen from ``at`` ``[3]`` (metres), ``width`` pixels wide.

    ``drawn_width``: the least width to render at before averaging to ``width``; both are powers of two.
    """
    planes = _seen(draw, np.asarray(at, np.float64), max(width, drawn_width), report)
    while planes.shape[1] > width:
        planes = _halved(planes)
    alpha = planes[..., -1].clip(0.0, 1.0)
    parts = np.moveaxis(planes[..., :-1].reshape(*alpha.shape, -1, 3), 2, 0)
    return Surroundings(filled(parts, alpha).astype(np.float32), panorama.unseen_share(alpha))


def _seen(draw: Draw, at: np.ndarray, width: int, report: Report) -> np.ndarray:
    """``[H, W, 3 P + 1]``: the mean over each pixel's area of the parts, and of the coverage."""
    height, fine = width // 2, SUPERSAMPLING * width
    cameras = view_cameras(at, fine)
    offsets = [(k + 0.5) / SUPERSAMPLING for k in range(SUPERSAMPLING)]
    places = list(itertools.product(offsets, offsets))
    seen = [panorama.directions(width, column, row).astype(np.float32) for row, column in places]
    # A pixel's directions nearer to a pole represent less of it.
    shares = [_row_share(width, row) for row, _ in places]
    blends = [np.sum([_blend(vectors, camera) for camera in cameras], axis=0) for vectors in seen]
    planes: np.ndarray | None = None
    for number, camera in enumerate(cameras):
        parts, alpha = draw(camera)
        picture = torch.cat([parts.flatten(0, 1), alpha[None]]).permute(1, 2, 0).contiguous().cpu().numpy()
        if planes is None:
            planes = np.zeros((height * width, picture.shape[2]), np.float64)
        for vectors, share, blend in zip(seen, shares, blends, strict=True):
            weight = _blend(vectors, camera)
            inside = np.flatnonzero(weight > 0.0)
            at_rows = np.repeat(share, width)[inside]
            factor = weight.reshape(-1)[inside] / blend.reshape(-1)[inside] * at_rows
            values = _looked_up(picture, camera, vectors.reshape(-1, 3)[inside])
            planes[inside] += factor[:, None] * values
        report((number + 1) / len(cameras))
    assert planes is not None
    return planes.reshape(height, width, -1)


def _halved(planes: np.ndarray) -> np.ndarray:
    """Means of 2 × 2 pixels by their solid angles."""
    weights = panorama.solid_angles(planes.shape[1]).reshape(-1, 2)
    weights = 0.5 * weights / weights.sum(axis=1, keepdims=True)
    pairs = (planes[:, ::2] + planes[:, 1::2]).reshape(len(weights), 2, -1, planes.shape[2])
    return np.einsum("hr,hrwk->hwk", weights, pairs)


def view_cameras(at: np.ndarray, fine: int) -> list[Camera]:
    """Square pinhole cameras at ``at``, with pixels as large as those of ``fine`` around the equator."""
    focal = fine / (2.0 * math.pi)
    size = 2 * math.ceil(focal * math.tan(HALF_VIEW) + 1.0)
    return [
        Camera(_looking(at, axis), size, size, focal, focal, 0.5 * size, 0.5 * size)
        for axis in VIEWS / np.linalg.norm(VIEWS, axis=1, keepdims=True)
    ]


def _looking(at: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """``[4, 4]``: camera to world, looking along ``axis``."""
    pose = np.eye(4)
    aside = np.eye(3)[np.abs(axis).argmin()]
    right = np.cross(axis, aside)
    right /= np.linalg.norm(right)
    pose[:3, :3] = np.stack([right, np.cross(right, axis), -axis], axis=1)
    pose[:3, 3] = at
    return pose


def _row_share(width: int, row: float) -> np.ndarray:
    """``[H]``: the share of a pixel's solid angle represented by directions at ``row`` (0…1 in it)."""
    fine = panorama.solid_angles(SUPERSAMPLING * width).reshape(-1, SUPERSAMPLING)
    return fine[:, int(row * SUPERSAMPLING)] / (fine.sum(axis=1) * SUPERSAMPLING)


def _blend(vectors: np.ndarray, camera: Camera) -> np.ndarray:
    """Weight of a camera's image along unit ``vectors`` ``[…, 3]``: falls smoothly to 0 at ``HALF_VIEW``."""
    forward = (-camera.camera_to_world[:3, 2]).astype(np.float32)
    least = math.cos(HALF_VIEW)
    inner = ((vectors @ forward - least) / (1.0 - least)).clip(0.0, 1.0)
    return inner * inner * (3.0 - 2.0 * inner)


def _looked_up(picture: np.ndarray, camera: Camera, vectors: np.ndarray) -> np.ndarray:
    """``[M, K]``: the image ``[H, W, K]`` along world directions ``[M, 3]``, linearly interpolated."""
    own = vectors @ (camera.camera_to_world[:3, :3] @ OPENGL_TO_OPENCV[:3, :3]).astype(np.float32)
    x = camera.fx * own[:, 0] / own[:, 2] + (camera.cx - 0.5)
    y = camera.fy * own[:, 1] / own[:, 2] + (camera.cy - 0.5)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    x, y = (x - left)[:, None], (y - top)[:, None]
    flat, width = picture.reshape(-1, picture.shape[2]), camera.width
    corner = top * width + left
    above = flat[corner] * (1.0 - x) + flat[corner + 1] * x
    below = flat[corner + width] * (1.0 - x) + flat[corner + width + 1] * x
    return above * (1.0 - y) + below * y


# ---- splats ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LitSplats:
    """Splats as seen from a place. ``parts`` ``[P, M, 3]``: of the radiance, the fixed one first.

    ``means`` ``[M, 3]``, ``quaternions`` ``[M, 4]`` wxyz, ``scales`` ``[M, 3]``, ``opacities`` ``[M]``.
    """

    means: torch.Tensor
    quaternions: torch.Tensor
    scales: torch.Tensor
    opacities: torch.Tensor
    parts: torch.Tensor

    def beyond(self, at: Sequence[float], near: float) -> "LitSplats":
        """Without splats too near to ``at`` (``bridge.panorama.too_near``)."""
        means, quaternions, scales = (
            each.detach().cpu().numpy() for each in (self.means, self.quaternions, self.scales)
        )
        close = panorama.too_near(means, quaternions, scales, np.asarray(at), near)
        if not close.any():
            return self
        far = torch.from_numpy(np.flatnonzero(~close)).to(self.means.device)
        return LitSplats(
            self.means[far],
            self.quaternions[far],
            self.scales[far],
            self.opacities[far],
            self.parts[:, far],
        )

    def drawn(self, camera: Camera, implementation: Implementation) -> tuple[torch.Tensor, torch.Tensor]:
        """As ``Draw``: one pass of three channels per part, whose kernel every machine has compiled."""
        shape = (self.means, self.quaternions, self.scales, self.opacities)
        passes = [
            rasterize(*shape, colours.contiguous(), camera, implementation=implementation)
            for colours in self.parts
        ]
        return torch.stack([each.image for each in passes]), passes[0].alpha


def parted(radiance: torch.Tensor, shares: torch.Tensor) -> torch.Tensor:
    """``[1 + C, M, 3]``: radiance ``[M, 3]`` as its fixed part and each light's, by shares ``[M, C, 3]``."""
    fixed = radiance * (1.0 - shares.sum(dim=1)).clamp_min(0.0)
    return torch.cat([fixed[None], radiance * shares.transpose(0, 1)])


def lit_model(model: Model, at: Sequence[float]) -> LitSplats:
    """A model file's Gaussians as seen from ``at``; one part if its lights cannot be separated."""
    offset = model.position - np.asarray(at, np.float32)
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    radiance = torch.from_numpy(model.radiance(offset / np.maximum(length, 1e-12)).astype(np.float32))
    shares = model.light_share
    parts = radiance[None] if shares is None else parted(radiance, torch.from_numpy(shares.copy()))
    means, quaternions, scales, opacities = (
        torch.from_numpy(np.array(each))
        for each in (model.position, model.rotation, model.scale, model.opacity)
    )
    return LitSplats(means, quaternions, scales, opacities, parts)
