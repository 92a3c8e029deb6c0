# SPDX-License-Identifier: GPL-3.0-or-later
"""Test photos of a camera with automatic settings: compared as stated, and with fitted gains.

A photo's true exposure and white balance differ from what it states, by an amount known only from the photo,
so a correct render may be off by a fifth of a stop. As in published work on photos (appearance is fitted on
one half of a photo, the other half is measured), one gain per colour channel is fitted on the left half, by
least squares of the compared values, and the right half is measured with it.
Source of the convention: Martin-Brualla et al., "NeRF in the Wild", 2021, section 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from ..scene.camera import Camera
from ..scene.scene import View
from .pictures import Pair, pairs
from .renderer import Renderer

#: The share of the light that reaches each pixel, ``[1, H, W]``, through a view's lens.
Falloff = Callable[[Camera], torch.Tensor]

#: Gauss-Newton steps, and the finite difference (of ln gain) for slopes.
STEPS, DIFFERENCE = 6, 0.01
#: Limit of ln gain: beyond e, 1.4 stops, the error is the model's, not the camera's.
LARGEST = 1.0


@dataclass(frozen=True)
class FittedPhotos:
    """Mean PSNR (dB) of the right halves of ``count`` photos: as stated, and with fitted gains.

    ``stops``: root mean square of the fitted gains.
    """

    count: int
    stated: float
    fitted: float
    stops: float

    def __str__(self) -> str:
        return (
            f"With one gain per channel fitted on the left half of each of {self.count} photos, their right "
            f"halves are at {self.fitted:.2f} dB PSNR; as stated by the photos at {self.stated:.2f} "
            f"(gains: {self.stops:.2f} stops, root mean square)."
        )


def no_falloff(camera: Camera) -> torch.Tensor:
    """The falloff of a lens without vignetting."""
    return torch.ones(1, 1, 1)


@torch.no_grad()
def falloff_there(renderer: Renderer, views: Sequence[View], falloff: Falloff) -> bool:
    """Whether the pictures of ``views`` have the vignetting, that is, their left halves match better with it.

    Photos of the same camera have it; rendered pictures, or ones developed with a lens profile, do not.
    """

    def error(view: View, k: int, effect: torch.Tensor) -> float:
        half = _left(_pair(renderer, view, k, effect))
        error = (half.picture - half.reference).square().mean(dim=0)
        return float((error if half.mask is None else error[half.mask]).sum())

    every = [(view, k) for view in views for k in range(len(view.exposures))]
    gained = [error(v, k, no_falloff(v.camera)) - error(v, k, falloff(v.camera)) for v, k in every]
    return sum(gained) > 0.0


def fitted_photos(
    renderer: Renderer,
    views: Sequence[View],
    falloff: Falloff,
    step: Callable[[str], None] = lambda what: None,
) -> FittedPhotos | None:
    """Fit every photo of ``views``; None if no half has pixels to compare. Calls ``step`` for each view."""
    stated, fitted, gains = [], [], []
    for view in views:
        step(f"fit {view.name}")
        arriving = falloff(view.camera)
        for k in range(len(view.exposures)):
            gain = _fit(renderer, view, k, arriving)
            halves = [_right(_pair(renderer, view, k, effect)) for effect in (arriving, arriving * gain)]
            if any(half.mask is not None and not half.mask.any() for half in halves):
                continue
            stated.append(halves[0].psnr())
            fitted.append(halves[1].psnr())
            gains.append(gain.log2().square().mean())
    if not gains:
        return None
    count, stops = len(gains), torch.stack(gains).mean().sqrt().item()
    return FittedPhotos(count, sum(stated) / count, sum(fitted) / count, stops)


def _fit(renderer: Renderer, view: View, k: int, arriving: torch.Tensor) -> torch.Tensor:
    """``[3, 1, 1]``: the gains that best match the left half to the photo."""
    log_gain = torch.zeros(3, 1, 1)
    for _ in range(STEPS):
        here, there = (
            _left(_pair(renderer, view, k, arriving * (log_gain + offset).exp()))
            for offset in (0.0, DIFFERENCE)
        )
        counts = torch.ones(1) if here.mask is None else here.mask
        slope = (there.picture - here.picture) / DIFFERENCE * counts
        error = (here.reference - here.picture) * counts
        steepness = slope.square().sum(dim=(1, 2), keepdim=True)
        wanted = (slope * error).sum(dim=(1, 2), keepdim=True) / steepness.clamp_min(1e-12)
        log_gain = (log_gain + wanted.float()).clamp(-LARGEST, LARGEST)
    return log_gain.exp()


def _pair(renderer: Renderer, view: View, k: int, effect: torch.Tensor) -> Pair:
    (pair,) = pairs(renderer, view, [k], rounded=False, effect=effect)
    return pair


def _left(pair: Pair) -> Pair:
    return _columns(pair, slice(None, pair.picture.shape[2] // 2))


def _right(pair: Pair) -> Pair:
    return _columns(pair, slice(pair.picture.shape[2] // 2, None))


def _columns(pair: Pair, part: slice) -> Pair:
    mask = None if pair.mask is None else pair.mask[:, part]
    return Pair(pair.picture[..., part], pair.reference[..., part], mask)
