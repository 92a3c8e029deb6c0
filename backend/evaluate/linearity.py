# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether radiance is right at every brightness: prediction / truth, from the darkest to the brightest.

One factor of alignment hides a contrast that is lost: radiance with shadows too bright and lamps too dark may
have the right median. Radiance that is right up to a scale has the same ratio everywhere, a slope of 1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from .metrics import SCALE_FLOOR, averaged_to

#: Ends of the bins that are reported, as shares of all values by true radiance: lamps are the last hundredth.
SHARES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0)
#: The slope is that of a line through the medians of so many bins of equal count.
SLOPE_BINS = 16
#: Values that are looked at of each view, evenly spaced: enough for a median to three digits.
VALUES = 200_000


@dataclass(frozen=True)
class RatioBin:
    """Values between the shares ``low`` and ``high``: medians of true radiance and of prediction / truth."""

    low: float
    high: float
    truth: float
    ratio: float


@dataclass(frozen=True)
class Linearity:
    """``slope``: d ln prediction / d ln truth; NaN if the truth is of one brightness."""

    slope: float
    bins: tuple[RatioBin, ...]

    def __str__(self) -> str:
        ratios = " / ".join(f"{each.ratio:.2f}" for each in self.bins)
        shares = " / ".join(f"{100 * each.high:g}" for each in self.bins)
        return (
            f"HDR slope (d ln prediction / d ln truth; below 1: contrast is lost): {self.slope:.3f}; "
            f"prediction / truth up to the {shares} % of true radiance: {ratios}"
        )


@dataclass(frozen=True, eq=False)
class Values:
    """``prediction`` and ``truth`` ``[N]`` float64 of compared values that are not black."""

    prediction: torch.Tensor
    truth: torch.Tensor


def compared_values(prediction: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None) -> Values:
    """Of one view, at most ``VALUES``. ``prediction`` ``[3, h, w]``, ``truth`` ``[3, H, W]``: radiance.

    The truth is averaged to the prediction's size. ``mask`` ``[h, w]`` bool: which pixels count; None: all.
    """
    truth = averaged_to(truth.double(), *prediction.shape[1:])
    if mask is not None:
        prediction, truth = prediction[:, mask], truth[:, mask]
    prediction, truth = prediction.double().flatten(), truth.flatten()
    if not len(truth):
        return Values(prediction, truth)
    is_lit = truth > SCALE_FLOOR * truth.median().clamp(min=0.0)
    prediction, truth = prediction[is_lit], truth[is_lit]
    step = max(1, math.ceil(len(truth) / VALUES))
    return Values(prediction[::step], truth[::step])


def linearity(views: Sequence[Values]) -> Linearity | None:
    """Over the values of all ``views``; None if there are none."""
    prediction = torch.cat([view.prediction for view in views]) if views else torch.zeros(0)
    truth = torch.cat([view.truth for view in views]) if views else torch.zeros(0)
    if not len(truth):
        return None
    truth, order = truth.sort()
    ratio = prediction[order] / truth
    return Linearity(_slope(truth, ratio), tuple(_bins(truth, ratio, SHARES)))


def _bins(truth: torch.Tensor, ratio: torch.Tensor, shares: Sequence[float]) -> list[RatioBin]:
    """Those with any value; ``truth`` rises."""
    ends = [round(share * len(truth)) for share in shares]
    return [
        RatioBin(low, high, truth[a:b].median().item(), ratio[a:b].median().item())
        for low, high, a, b in zip(shares, shares[1:], ends, ends[1:], strict=False)
        if b > a
    ]


def _slope(truth: torch.Tensor, ratio: torch.Tensor) -> float:
    """By least squares through the medians of bins, which few wrong values do not move."""
    bins = _bins(truth, ratio, [k / SLOPE_BINS for k in range(SLOPE_BINS + 1)])
    points = [(math.log(each.truth), math.log(each.ratio)) for each in bins if each.ratio > 0.0]
    if not points:
        return math.nan
    x, y = torch.tensor(points, dtype=torch.float64).T
    x, y = x - x.mean(), y - y.mean()
    spread = x.square().sum().item()
    return 1.0 + (x * y).sum().item() / spread if spread > 1e-6 else math.nan
