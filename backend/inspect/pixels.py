# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the training pictures: shares of clipped pixels, and dynamic range in stops."""

import math

import numpy as np

from ...bridge.contents import LUMINANCE, stops_between
from ..scene.encoding import eight_bits
from .findings import DynamicRange, Inspection

#: The response assumed when estimating radiance from pictures: (x / (1 + x))^(1 / 2.2), HDR-NeRF-Syn's
#: camera.
GAMMA = 2.2
#: Luminance is counted by the first bits of a float32: its exponent, and twelve of the 23 following.
LEFT_OUT_BITS = 11


class LuminanceCounts:
    """A histogram of luminance, accurate to a part in 4096: any number of pictures needs 8 MB."""

    def __init__(self) -> None:
        self._counts = np.zeros(1 << (31 - LEFT_OUT_BITS), np.int64)
        self.maximum = 0.0

    def add(self, luminance: np.ndarray) -> None:
        """Finite values of any shape; those below 0 count as black."""
        if not luminance.size:
            return
        self.maximum = max(self.maximum, float(luminance.max()))
        bits = np.maximum(luminance, 0.0).astype(np.float32).ravel().view(np.uint32) >> LEFT_OUT_BITS
        self._counts += np.bincount(bits, minlength=len(self._counts))

    def percentile(self, share: float) -> float:
        """As ``np.percentile``, of values rounded down; 0 without any."""
        rising = np.cumsum(self._counts)
        if not rising[-1]:
            return 0.0
        rank = 0.01 * share * (rising[-1] - 1)
        bins = np.searchsorted(rising, [math.floor(rank), math.ceil(rank)], side="right")
        low, high = (bins.astype(np.uint32) << LEFT_OUT_BITS).view(np.float32).astype(np.float64)
        return float(low + (rank - math.floor(rank)) * (high - low))


class TrainingPixels:
    """Counts of the pictures and luminance of the truth; ``summarise`` adds the results."""

    def __init__(self) -> None:
        self._clipped: dict[int, list[tuple[float, float]]] = {}
        self._codes: dict[float, np.ndarray] = {}
        self._luminance: LuminanceCounts | None = None

    def add_picture(
        self, picture: np.ndarray, place: int, seconds: float, mask: np.ndarray | None = None
    ) -> None:
        """``picture`` ``[H, W, 3]`` uint8 or uint16, a camera's, its place in the bracket and exposure.

        ``mask``: pixels that count, ``[H, W]`` bool; None: all. 16 bits are rounded to 8. White is a pixel
        with a channel at 255, black one with all at 0; codes are means over channels.
        """
        picture = eight_bits(picture)
        if mask is not None:
            picture = picture[mask]
            if not len(picture):
                return
        brightest = picture.max(-1)
        self._clipped.setdefault(place, []).append(((brightest == 255).mean(), (brightest == 0).mean()))
        codes = np.round(picture.mean(-1)).astype(np.int64)
        counted = np.bincount(codes.ravel(), minlength=256)
        self._codes[seconds] = self._codes.get(seconds, np.zeros(256, np.int64)) + counted

    def add_radiance(self, exposed: np.ndarray, seconds: float) -> None:
        """The counted pixels ``[…, 3]`` of a picture of exposure × radiance."""
        if exposed.size:
            self._add_luminance(exposed.astype(np.float64) @ LUMINANCE / seconds)

    def add_truth(self, radiance: np.ndarray) -> None:
        """``radiance`` ``[H, W, 3]``, scene-linear."""
        self._add_luminance(radiance.astype(np.float64) @ LUMINANCE)

    def _add_luminance(self, luminance: np.ndarray) -> None:
        self._luminance = self._luminance or LuminanceCounts()
        self._luminance.add(luminance)

    def summarise(self, found: Inspection) -> None:
        """Add the clipped shares of each exposure, and the dynamic range, of the truth if there is any."""
        for exposure in found.exposures:
            if exposure.place in self._clipped:
                means = np.mean(self._clipped[exposure.place], axis=0)
                exposure.white, exposure.black = (round(float(value), 5) for value in means)
        if self._luminance is not None:
            low, high = self._luminance.percentile(1), self._luminance.maximum
            found.dynamic_range = DynamicRange(low, high, stops_between(low, high))
        elif self._codes:
            found.dynamic_range = self._estimate()

    def _estimate(self) -> DynamicRange:
        """From pictures: the brightest pixel of the shortest exposure over the 1st percentile of the longest,
        both through the inverse of the assumed response.
        """
        shortest, longest = min(self._codes), max(self._codes)
        brightest = int(np.nonzero(self._codes[shortest])[0][-1])
        share = np.cumsum(self._codes[longest]) / self._codes[longest].sum()
        darkest = int(np.searchsorted(share, 0.01))
        high, low = _radiance(min(brightest, 254), shortest), _radiance(max(darkest, 1), longest)
        clipped = brightest == 255 or darkest == 0
        stops = round(math.log2(high / low), 1) if high > low else 0.0
        return DynamicRange(low, high, stops, estimated=True, at_least=clipped)


def _radiance(code: int, seconds: float) -> float:
    linear = (code / 255.0) ** GAMMA
    return linear / (1.0 - linear) / seconds
