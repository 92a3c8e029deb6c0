# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracle: the contract in plain torch, any dtype (float64 for tests), gradients by autograd.

Slow and simple on purpose. Works tile by tile only to bound memory: within a tile every Gaussian whose
footprint can touch it is evaluated densely at every pixel.
"""

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
from .contract import Rasterization

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
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    inverse_determinant = 1.0 / (a * c - b * b)
    conic_a, conic_b, conic_c = c * inverse_determinant, -b * inverse_determinant, a * inverse_determinant

    with torch.no_grad():
        # Where alpha falls to 1/255: dᵀ Σ⁻¹ d = 2 ln(255 · opacity); its bounding box.
        reach = (2.0 * torch.log(opacities / ALPHA_MIN)).clamp_min(0.0).sqrt()
        half_width, half_height = reach * a.sqrt(), reach * c.sqrt()
        drawn = (
            (depth >= NEAR_PLANE)
            & (opacities >= ALPHA_MIN)
            & (screen[:, 0] + half_width > 0)
            & (screen[:, 0] - half_width < camera.width)
            & (screen[:, 1] + half_height > 0)
            & (screen[:, 1] - half_height < camera.height)
        )
        radii = torch.where(drawn, torch.maximum(half_width, half_height), torch.zeros_like(reach))
        order = torch.argsort(depth, stable=True)
        order = order[drawn[order]]

    channels = colours.shape[1]
    image = means.new_zeros(channels, camera.height, camera.width)
    alpha_image = means.new_zeros(camera.height, camera.width)
    rows, row_alphas = [], []
    for top in range(0, camera.height, TILE):
        tiles, tile_alphas = [], []
        bottom = min(top + TILE, camera.height)
        for left in range(0, camera.width, TILE):
            right = min(left + TILE, camera.width)
            with torch.no_grad():
                touches = (
                    (screen[order, 0] + half_width[order] > left)
                    & (screen[order, 0] - half_width[order] < right)
                    & (screen[order, 1] + half_height[order] > top)
                    & (screen[order, 1] - half_height[order] < bottom)
                )
                here = order[touches]
            y, x = torch.meshgrid(
                torch.arange(top, bottom, dtype=means.dtype, device=means.device) + 0.5,
                torch.arange(left, right, dtype=means.dtype, device=means.device) + 0.5,
                indexing="ij",
            )
            dx = x.reshape(1, -1) - screen[here, 0:1]
            dy = y.reshape(1, -1) - screen[here, 1:2]
            power = -0.5 * (conic_a[here, None] * dx * dx + conic_c[here, None] * dy * dy)
            power = power - conic_b[here, None] * dx * dy
            alpha = (opacities[here, None] * torch.exp(power)).clamp_max(ALPHA_MAX)
            alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
            after = torch.cumprod(1.0 - alpha, dim=0)
            before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
            # `after` never rises, so everything behind the Gaussian that finished the pixel is out too.
            weight = torch.where(after > TRANSMITTANCE_MIN, alpha * before, torch.zeros_like(alpha))
            tiles.append((colours[here].T @ weight).reshape(channels, bottom - top, right - left))
            tile_alphas.append(weight.sum(0).reshape(bottom - top, right - left))
        rows.append(torch.cat(tiles, dim=2))
        row_alphas.append(torch.cat(tile_alphas, dim=1))
    image = torch.cat(rows, dim=1)
    alpha_image = torch.cat(row_alphas, dim=0)
    return Rasterization(image, alpha_image, radii)
