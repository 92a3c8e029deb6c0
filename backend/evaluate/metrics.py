# SPDX-License-Identifier: GPL-3.0-or-later
"""PSNR, SSIM, μ-law and the HDR comparison, by the conventions of the paper's code lineage.

Pictures are ``[3, H, W]`` tensors, in 0…1 unless they are radiance. Numbers are computed in float64: the
variances of SSIM are differences of squares, and float32 loses the fifth digit in flat regions.
"""

import functools
import math
from dataclasses import dataclass

import torch

from ...bridge.errors import BadValueError, DataMismatchError

#: Parameter of the μ-law for comparing HDR pictures (HDR-NeRF, GaussHDR, the paper).
MU = 5000.0
#: Maximum PSNR in dB: equal pictures would score infinity, and so would any mean with one of them.
#: Pictures of 8 bit come near it only where a few values in all are off by one code (400×400: three).
PSNR_CAP = 100.0
#: SSIM's window and constants: 3DGS, after Wang et al. 2004.
SSIM_WINDOW, SSIM_SIGMA = 11, 1.5
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
#: Channel values below this share of the picture's median (noise and black) do not count for the scale.
SCALE_FLOOR = 0.01
#: Render and truth may differ in aspect by this much (odd sizes, halved) and still be the same picture.
ASPECT_TOLERANCE = 0.02


def quantise(picture: torch.Tensor) -> torch.Tensor:
    """The picture as read back from an 8-bit PNG: clamped to 0…1, rounded half up, float64."""
    return torch.floor(picture.double().clamp(0.0, 1.0) * 255.0 + 0.5) / 255.0


def psnr(picture: torch.Tensor, truth: torch.Tensor) -> float:
    """Peak signal-to-noise ratio in dB for a range of 1; at most ``PSNR_CAP``, also for equal pictures.

    NaN for no pixels, and if a value is NaN.
    """
    _require_same_shape(picture, truth)
    error = (picture.double() - truth.double()).square().mean().item()
    if math.isnan(error):
        return math.nan  # min() may ignore it
    return PSNR_CAP if error == 0.0 else min(PSNR_CAP, -10.0 * math.log10(error))


@functools.cache
def _ssim_kernel() -> tuple[float, ...]:
    """The window's 11 weights, which sum to 1."""
    weights = [math.exp(-((i - SSIM_WINDOW // 2) ** 2) / (2.0 * SSIM_SIGMA**2)) for i in range(SSIM_WINDOW)]
    return tuple(weight / sum(weights) for weight in weights)


def _window_mean(planes: torch.Tensor) -> torch.Tensor:
    """The Gaussian-weighted mean around each pixel of ``[B, H, W]``, zeros outside (separable).

    As sums of shifted planes: torch has no fast float64 convolution on CPUs (measured: five times slower).
    """
    pad = SSIM_WINDOW // 2
    kernel = _ssim_kernel()
    for dim, padding in ((1, (0, 0, pad, pad)), (2, (pad, pad))):
        size = planes.shape[dim]
        padded = torch.nn.functional.pad(planes, padding)
        planes = kernel[pad] * padded.narrow(dim, pad, size)
        for i in range(pad):  # the window is symmetric
            pair = padded.narrow(dim, i, size) + padded.narrow(dim, 2 * pad - i, size)
            planes.add_(pair, alpha=kernel[i])
    return planes


def ssim_map(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """SSIM at each pixel and channel, ``[3, H, W]`` float64; the padding counts as black, as in 3DGS."""
    _require_same_shape(picture, truth)
    x, y = picture.double(), truth.double()
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    variance_x = _window_mean(x * x) - mean_x * mean_x
    variance_y = _window_mean(y * y) - mean_y * mean_y
    covariance = _window_mean(x * y) - mean_x * mean_y
    luminance = (2.0 * mean_x * mean_y + SSIM_C1) / (mean_x.square() + mean_y.square() + SSIM_C1)
    return luminance * (2.0 * covariance + SSIM_C2) / (variance_x + variance_y + SSIM_C2)


def ssim(picture: torch.Tensor, truth: torch.Tensor) -> float:
    """Mean SSIM over all pixels and channels: 11×11 Gaussian window, σ 1.5, zero-padded (3DGS)."""
    return ssim_map(picture, truth).mean().item()


def mu_law(x: torch.Tensor, mu: float = MU) -> torch.Tensor:
    """ln(1 + μx) / ln(1 + μ) for ``x`` in 0…1."""
    return torch.log1p(mu * x) / math.log1p(mu)


def hdr_normaliser(truth: torch.Tensor) -> float:
    """M of the HDR protocol: the largest channel value of the full-resolution truth.

    Raises ``BadValueError`` if the truth is black.
    """
    largest = truth.max().item()
    if not largest > 0.0:
        raise BadValueError(
            f"the largest radiance of the true picture is {largest}: nothing to normalise by",
            "Check that this EXR is not black, or remove the view from the test split.",
        )
    return largest


def display(radiance: torch.Tensor, normaliser: float) -> torch.Tensor:
    """Radiance as the HDR protocol sees it: μ-law(clip(radiance / M, 0, 1)), float64, not quantised."""
    return mu_law((radiance.double() / normaliser).clamp(0.0, 1.0))


def averaged_to(radiance: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """True radiance ``[3, H, W]`` as a camera of ``height`` × ``width`` pixels sees it, float64.

    Each pixel is the mean over its area, for any factor; radiance of that size is returned unchanged.
    Raises ``DataMismatchError`` for another aspect.
    """
    if radiance.shape[1:] == (height, width):
        return radiance
    _require_one_aspect(radiance, height, width)
    return _averaged_along(2, _averaged_along(1, radiance.double(), height), width)


def _averaged_along(dim: int, planes: torch.Tensor, size: int) -> torch.Tensor:
    """``planes`` with ``size`` values along ``dim``, each the mean over its part of that side."""
    side = planes.shape[dim]
    scale = side / size
    begin = torch.arange(size, dtype=torch.float64) * scale
    shape = [-1 if each == dim else 1 for each in range(planes.ndim)]
    total = torch.zeros((), dtype=torch.float64)
    for k in range(math.ceil(scale) + 1):  # a part that starts within a pixel touches one more
        at = begin.floor() + k
        share = (torch.minimum(at + 1.0, begin + scale) - torch.maximum(at, begin)).clamp(min=0.0) / scale
        total = total + share.reshape(shape) * planes.index_select(dim, at.long().clamp(max=side - 1))
    return total


def _resized_as_published(shown: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """The μ-law'd truth resized as in GaussHDR's code: bilinear with aligned corners.

    It picks single pixels rather than averaging. Raises ``DataMismatchError`` for another aspect.
    """
    if shown.shape[1:] == (height, width):
        return shown
    _require_one_aspect(shown, height, width)
    size = height, width
    return torch.nn.functional.interpolate(shown[None], size, mode="bilinear", align_corners=True)[0]


def _require_one_aspect(truth: torch.Tensor, height: int, width: int) -> None:
    if abs(truth.shape[2] / truth.shape[1] * height / width - 1.0) > ASPECT_TOLERANCE:
        raise DataMismatchError(
            f"the true picture is {truth.shape[2]}×{truth.shape[1]}, the render {width}×{height}",
            "Give truth and pictures of the same aspect.",
        )


@dataclass(frozen=True)
class HdrPair:
    """Prediction and truth, μ-law'd and quantised, ``[3, H, W]`` in 0…1, ready for any LDR metric."""

    prediction: torch.Tensor
    truth: torch.Tensor
    normaliser: float


def hdr_pair(prediction: torch.Tensor, truth: torch.Tensor, *, published: bool = False) -> HdrPair:
    """The HDR protocol of GaussHDR (https://arxiv.org/abs/2503.10143) and the paper: no alignment of scale.

    ``prediction`` ``[3, h, w]`` and ``truth`` ``[3, H, W]`` are radiance. M is the maximum of the truth at
    its full resolution. A larger truth is averaged to the prediction's size and then μ-law'd, like a perfect
    prediction. ``published``: it is μ-law'd at its full size and then resized, as in GaussHDR's code and for
    the figures of published benchmarks. Both are quantised to 8 bit.
    """
    shown, normaliser = hdr_shown(truth, prediction.shape[1], prediction.shape[2], published=published)
    return HdrPair(quantise(display(prediction, normaliser)), shown, normaliser)


def hdr_shown(
    truth: torch.Tensor, height: int, width: int, *, published: bool = False
) -> tuple[torch.Tensor, float]:
    """The truth of an ``HdrPair`` of that size, and M: for comparing several predictions with one truth."""
    normaliser = hdr_normaliser(truth)
    if published:
        return quantise(_resized_as_published(display(truth, normaliser), height, width)), normaliser
    return quantise(display(averaged_to(truth, height, width), normaliser)), normaliser


def scale_ratio(prediction: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None = None) -> float:
    """The median of prediction / truth: how far the absolute scale of the radiance is off (1: not).

    Over all pixels and channels whose truth is above ``SCALE_FLOOR`` × the truth's median: black has no
    scale. The truth is averaged to the prediction's size. ``mask``: the pixels of the prediction that count,
    ``[H, W]`` bool; None: all. NaN if no channel value qualifies.
    """
    truth = averaged_to(truth.double(), prediction.shape[1], prediction.shape[2])
    if mask is not None:
        prediction, truth = prediction[:, mask], truth[:, mask]
    if truth.numel() == 0:
        return math.nan
    lit = truth > SCALE_FLOOR * truth.median().clamp(min=0.0)
    return (prediction.double()[lit] / truth[lit]).median().item() if bool(lit.any()) else math.nan


def _require_same_shape(picture: torch.Tensor, truth: torch.Tensor) -> None:
    if picture.shape != truth.shape:
        raise DataMismatchError(
            f"cannot compare pictures of different shapes: {tuple(picture.shape)} and {tuple(truth.shape)}",
            "Render at the size of the data set's pictures.",
        )
