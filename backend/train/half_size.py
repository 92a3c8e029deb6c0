# SPDX-License-Identifier: GPL-3.0-or-later
"""Views at half their size, as early iterations see them (``half_size_until``).

While Gaussians are few and blurred, a quarter of the pixels teaches as much. Pictures are averaged as they
are, display-referred: at a bright edge that differs from the picture of averaged radiance, which is one more
reason to stop early.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace

import torch

from ..methods.base import Recording
from ..scene.camera import Camera

#: Pictures smaller than this (pixels) are not halved: SSIM's windows would see nothing else.
SMALLEST_SIDE = 64


@functools.lru_cache(maxsize=4096)
def half_sized(camera: Camera) -> Camera:
    """The same view at half the width; one object for each camera, so that what is cached for it stays."""
    return camera.resized(camera.width // 2)


def halved(camera: Camera, recordings: Sequence[Recording]) -> tuple[Camera, list[Recording]]:
    """A view at half its size; small ones are given back as they are.

    Of a mask a pixel counts where all that it is made of do. An effect that varies over the picture is
    averaged, too.
    """
    if min(camera.width, camera.height) < 2 * SMALLEST_SIDE:
        return camera, list(recordings)
    half = half_sized(camera)
    size = (half.height, half.width)

    def area(image: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.interpolate(image[None], size, mode="area")[0]

    small = []
    for each in recordings:
        changed = replace(each, picture=area(each.picture))
        if each.mask is not None:
            changed = replace(changed, mask=area(each.mask[None].float())[0] > 1.0 - 1e-4)
        if each.effect is not None and each.effect.shape[1:] != (1, 1):
            changed = replace(changed, effect=area(each.effect))
        small.append(changed)
    return half, small
