# SPDX-License-Identifier: GPL-3.0-or-later
"""Views at half their size, as early iterations see them (``half_size_until``).

While Gaussians are few and blurred, a quarter of the pixels teaches as much. Pictures are averaged as they
are, display-referred: at a bright edge that differs from the picture of averaged radiance, which is one more
reason to stop early.
"""

import functools

import torch

from ..scene.camera import Camera

#: Pictures smaller than this (pixels) are not halved: SSIM's windows would see nothing else.
SMALLEST_SIDE = 64


@functools.lru_cache(maxsize=4096)
def half_sized(camera: Camera) -> Camera:
    """The same view at half the width; one object for each camera, so that what is cached for it stays."""
    return camera.resized(camera.width // 2)


def halved(camera: Camera, pictures: list[torch.Tensor]) -> tuple[Camera, list[torch.Tensor]]:
    """A view at half its size: camera and pictures ``[3, H, W]``; small ones are given back as they are."""
    if min(camera.width, camera.height) < 2 * SMALLEST_SIDE:
        return camera, pictures
    half = half_sized(camera)
    size = (half.height, half.width)
    return half, [torch.nn.functional.interpolate(each[None], size, mode="area")[0] for each in pictures]
