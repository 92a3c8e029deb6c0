# SPDX-License-Identifier: GPL-3.0-or-later
"""The contract on CUDA, through gsplat's kernels (Apache-2.0), called step by step.

Step by step, because ``screen_offsets`` must enter between projection and rasterisation. gsplat compiles its
kernels at first use, which takes minutes; ``unavailable_reason`` finds out without crashing.
"""

from functools import cache

import torch

from ..scene.camera import NEAR_PLANE, Camera
from .contract import LOW_PASS, Rasterization

TILE = 16


@cache
def unavailable_reason() -> str | None:
    """Why the CUDA path cannot be used here, or ``None`` where it can. May compile the kernels."""
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        from gsplat.cuda._backend import _C
    except Exception as error:  # noqa: BLE001 (a build can fail in any way; the reason is passed on)
        return f"gsplat's kernels cannot be used: {error}"
    return None if _C is not None else "gsplat's kernels could not be built (is nvcc installed?)"


def rasterize(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colours: torch.Tensor,
    camera: Camera,
    screen_offsets: torch.Tensor | None = None,
) -> Rasterization:
    """See ``rasterize.rasterize``."""
    import gsplat

    intrinsics = torch.tensor(
        [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]],
        dtype=means.dtype,
        device=means.device,
    )
    radii, screen, depths, conics, _ = gsplat.fully_fused_projection(
        means,
        None,
        quaternions,
        scales,
        camera.view_matrix(means)[None],
        intrinsics[None],
        camera.width,
        camera.height,
        eps2d=LOW_PASS,
        near_plane=NEAR_PLANE,
        opacities=opacities,
    )
    if screen_offsets is not None:
        screen = screen + screen_offsets[None]
    tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
    with torch.no_grad():
        _, keys, indices = gsplat.isect_tiles(screen, radii, depths, TILE, tiles_x, tiles_y)
        offsets = gsplat.isect_offset_encode(keys, 1, tiles_x, tiles_y)
    image, alpha = gsplat.rasterize_to_pixels(
        screen,
        conics,
        colours[None],
        opacities[None],
        camera.width,
        camera.height,
        TILE,
        offsets,
        indices,
    )
    largest = radii[0].amax(dim=-1).to(means.dtype)
    return Rasterization(image[0].permute(2, 0, 1), alpha[0, ..., 0], largest)
