# SPDX-License-Identifier: GPL-3.0-or-later
"""Test photos of a camera that decides by itself: compared as they state themselves, and fitted.

A photo's true exposure and white balance differ from what it states, and nothing but the photo tells by how
much. So a picture that is right may lie a fifth of a stop beside it. As published work does with photos (a
photo's appearance is found on one half of it, the other half is measured), one gain for each colour channel
is fitted on the left half, by least squares of what is compared, and the right half is measured with it.
Source of the convention: Martin-Brualla et al., "NeRF in the Wild", 2021, section 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from ..scene.camera import Camera
from ..scene.scene import View
from .pictures import Pair, pairs
from .renderer import Renderer

#: The share of the light that arrives at each pixel, ``[1, H, W]``: what is known of a view's lens.
Falloff = Callable[[Camera], torch.Tensor]

#: Gauss and Newton's steps, and the difference (of ln gain) by which slopes are told.
STEPS, DIFFERENCE = 6, 0.01
#: A gain beyond e, 1.4 stops, is no fault of a camera but of a model.
LARGEST = 1.0


@dataclass(frozen=True)
class FittedPhotos:
    """Mean PSNR (dB) of the right halves of ``count`` photos: as they are stated, and with fitted gains.

    ``stops``: root mean square of the fitted gains.
    """

    count: int
    stated: float
    fitted: float
    stops: float

    def __str__(self) -> str:
        return (
            f"With one gain a channel fitted on the left half of each of {self.count} photos, their right "
            f"halves are at {self.fitted:.2f} dB PSNR; as the photos state themselves at {self.stated:.2f} "
            f"(gains: {self.stops:.2f} stops, root mean square)."
        )


def no_falloff(camera: Camera) -> torch.Tensor:
    """Of a lens that is as bright everywhere."""
    return torch.ones(1, 1, 1)


@torch.no_grad()
def falloff_there(renderer: Renderer, views: Sequence[View], falloff: Falloff) -> bool:
    """Whether the pictures of ``views`` have the vignetting: whether their left halves are nearer with it.

    Photos of the same camera have; pictures that were developed with a lens profile, or rendered, have not.
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
    """Fit every photo of ``views``; None where no half has pixels to compare. ``step`` is told each view."""
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
    """``[3, 1, 1]``: the gains under which the left half is nearest to the photo."""
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
