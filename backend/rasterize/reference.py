# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracle: the contract in plain torch, any dtype (float64 for tests), gradients by autograd.

Slow and simple on purpose. Works tile by tile only to bound memory: within a tile every Gaussian whose
footprint can touch it is evaluated densely at every pixel.
"""

from dataclasses import dataclass

import torch

from ...bridge.splatting import (
    ALPHA_MAX,
    ALPHA_MIN,
    JACOBIAN_MARGIN,
    LOW_PASS,
    NEAR_PLANE,
    TRANSMITTANCE_MIN,
)
from ..scene.camera import Camera
from .contract import MEDIAN_TRANSMITTANCE, Rasterization

TILE = 16


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices ``[N, 3, 3]`` of quaternions ``[N, 4]`` (wxyz, any length but zero)."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    return torch.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        dim=-1,
    ).reshape(-1, 3, 3)


def project(
    means: torch.Tensor, quaternions: torch.Tensor, scales: torch.Tensor, camera: Camera
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """EWA projection (paper eq. 1): where and how large Gaussians are on the screen.

    Returns means ``[N, 2]`` px, covariances ``[N, 2, 2]`` px² and depths ``[N]`` m. The
    low-pass filter is included. Entries behind the near plane are finite and meaningless.
    """
    view = camera.view_matrix(means)
    R, t = view[:3, :3], view[:3, 3]
    in_camera = means @ R.T + t
    depth = in_camera[:, 2]
    z = depth.clamp_min(NEAR_PLANE)
    tan_x, tan_y = in_camera[:, 0] / z, in_camera[:, 1] / z

    margin_x = JACOBIAN_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = JACOBIAN_MARGIN * 0.5 * camera.height / camera.fy
    limited_x = tan_x.clamp(
        -(camera.cx / camera.fx + margin_x), (camera.width - camera.cx) / camera.fx + margin_x
    )
    limited_y = tan_y.clamp(
        -(camera.cy / camera.fy + margin_y), (camera.height - camera.cy) / camera.fy + margin_y
    )
    zero = torch.zeros_like(z)
    J = torch.stack(
        [camera.fx / z, zero, -camera.fx * limited_x / z, zero, camera.fy / z, -camera.fy * limited_y / z],
        dim=-1,
    ).reshape(-1, 2, 3)

    # Σ = R_q S Sᵀ R_qᵀ, so J W Σ Wᵀ Jᵀ = A Aᵀ with A = J W R_q S.
    A = J @ R @ rotation_matrices(quaternions) * scales[:, None, :]
    covariance = A @ A.transpose(1, 2) + LOW_PASS * torch.eye(2, dtype=means.dtype, device=means.device)
    screen = torch.stack([camera.fx * tan_x + camera.cx, camera.fy * tan_y + camera.cy], dim=-1)
    return screen, covariance, depth


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``; this is that function in plain torch."""
    screen, covariance, depth = project(means, quaternions, scales, camera)
    if screen_offsets is not None:
        screen = screen + screen_offsets
    conic = _conic(covariance)
    half_size, order = _in_sight(screen, covariance, depth, opacities, camera)
    drawn = torch.zeros(means.shape[0], dtype=torch.bool, device=means.device)
    drawn[order] = True
    radii = torch.where(drawn, half_size.amax(dim=1), 0.0)
    channels = colours.shape[1]
    rows, row_alphas = [], []
    for row in _tiles(camera):
        tiles, tile_alphas = [], []
        for tile in row:
            here, alpha = _alphas_in(tile, screen, conic, opacities, half_size, order)
            after = torch.cumprod(1.0 - alpha, dim=0)
            before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
            # `after` never rises, so everything behind the Gaussian that finished the pixel is out too.
            weight = torch.where(after > TRANSMITTANCE_MIN, alpha * before, torch.zeros_like(alpha))
            tiles.append((colours[here].T @ weight).reshape(channels, *tile.shape))
            tile_alphas.append(weight.sum(0).reshape(tile.shape))
        rows.append(torch.cat(tiles, dim=2))
        row_alphas.append(torch.cat(tile_alphas, dim=1))
    return Rasterization(torch.cat(rows, dim=1), torch.cat(row_alphas, dim=0), radii)


@torch.no_grad()
def median_gaussian(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    camera: Camera,
) -> torch.Tensor:
    """``[H, W]``: which Gaussian brings a pixel's transmittance to a half, −1 where none does."""
    screen, covariance, depth = project(means, quaternions, scales, camera)
    conic = _conic(covariance)
    half_size, order = _in_sight(screen, covariance, depth, opacities, camera)
    rows = []
    for row in _tiles(camera):
        tiles = []
        for tile in row:
            here, alpha = _alphas_in(tile, screen, conic, opacities, half_size, order)
            is_beyond = torch.cumprod(1.0 - alpha, dim=0) <= MEDIAN_TRANSMITTANCE
            # Of a column of False and then True the sum says how many stand before the first True.
            first = (~is_beyond).sum(dim=0)
            tiles.append(torch.cat([here, here.new_full((1,), -1)])[first].reshape(tile.shape))
        rows.append(torch.cat(tiles, dim=1))
    return torch.cat(rows, dim=0)


@dataclass(frozen=True)
class _Tile:
    """Pixels from ``left``, ``top`` up to ``right``, ``bottom``, which are not in it."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.bottom - self.top, self.right - self.left


def _tiles(camera: Camera) -> list[list[_Tile]]:
    """The tiles of a picture, row by row."""
    width, height = camera.width, camera.height
    return [
        [_Tile(left, top, min(left + TILE, width), min(top + TILE, height)) for left in range(0, width, TILE)]
        for top in range(0, height, TILE)
    ]


@torch.no_grad()
def _in_sight(
    screen: torch.Tensor,
    covariance: torch.Tensor,
    depth: torch.Tensor,
    opacities: torch.Tensor,
    camera: Camera,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Half the width and height of each footprint ``[N, 2]`` px, and the drawn Gaussians, nearest first."""
    # Where alpha falls to 1/255: dᵀ Σ⁻¹ d = 2 ln(255 · opacity); its bounding box.
    reach = (2.0 * torch.log(opacities / ALPHA_MIN)).clamp_min(0.0).sqrt()
    half_width, half_height = reach * covariance[:, 0, 0].sqrt(), reach * covariance[:, 1, 1].sqrt()
    drawn = (
        (depth >= NEAR_PLANE)
        & (opacities >= ALPHA_MIN)
        & (screen[:, 0] + half_width > 0)
        & (screen[:, 0] - half_width < camera.width)
        & (screen[:, 1] + half_height > 0)
        & (screen[:, 1] - half_height < camera.height)
    )
    order = torch.argsort(depth, stable=True)
    return torch.stack([half_width, half_height], dim=1), order[drawn[order]]


def _conic(covariance: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The inverses of ``[N, 2, 2]``: xx, xy and yy, ``[N]`` each."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    inverse_determinant = 1.0 / (a * c - b * b)
    return c * inverse_determinant, -b * inverse_determinant, a * inverse_determinant


def _alphas_in(
    tile: _Tile,
    screen: torch.Tensor,
    conic: tuple[torch.Tensor, torch.Tensor, torch.Tensor],
    opacities: torch.Tensor,
    half_size: torch.Tensor,
    order: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Which Gaussians of ``order`` touch a tile ``[G]``, and their alpha at each of its pixels ``[G, P]``."""
    with torch.no_grad():
        touches = (
            (screen[order, 0] + half_size[order, 0] > tile.left)
            & (screen[order, 0] - half_size[order, 0] < tile.right)
            & (screen[order, 1] + half_size[order, 1] > tile.top)
            & (screen[order, 1] - half_size[order, 1] < tile.bottom)
        )
        here = order[touches]
    y, x = torch.meshgrid(
        torch.arange(tile.top, tile.bottom, dtype=screen.dtype, device=screen.device) + 0.5,
        torch.arange(tile.left, tile.right, dtype=screen.dtype, device=screen.device) + 0.5,
        indexing="ij",
    )
    dx = x.reshape(1, -1) - screen[here, 0:1]
    dy = y.reshape(1, -1) - screen[here, 1:2]
    conic_a, conic_b, conic_c = (each[here, None] for each in conic)
    power = -0.5 * (conic_a * dx * dx + conic_c * dy * dy)
    power = power - conic_b * dx * dy
    alpha = (opacities[here, None] * torch.exp(power)).clamp_max(ALPHA_MAX)
    return here, torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
