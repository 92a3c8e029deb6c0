# SPDX-License-Identifier: GPL-3.0-or-later
"""What the training views' pixels come to, view by view: all at once may be more than memory holds."""

import math
from collections.abc import Sequence

import numpy as np

from ..bridge.contents import LUMINANCE
from .png import LARGEST_CODE, quantise
from .response import Response

#: Where the dynamic range begins: at the 1st percentile of the luminance.
DARK = 0.01


class TrainingRadiance:
    """Sums over views: besides one of them, only the luminance of the darkest hundredth is held.

    ``pixels``: how many there are in all views together.
    """

    def __init__(self, pixels: int, bracket: Sequence[float], response: Response) -> None:
        self._pixels, self._bracket, self._response = pixels, bracket, response
        self._rank = (pixels - 1) * DARK
        self._darkest = np.empty(0)
        self._white = self._black = 0
        #: The largest luminance.
        self.maximum = -math.inf

    def add(self, radiance: np.ndarray) -> None:
        """A view, ``[height, width, 3]``, scene-linear."""
        brightest = radiance.max(-1).astype(np.float64)
        shortest, longest = (quantise(self._response(brightest * self._bracket[place])) for place in (0, -1))
        self._white += np.count_nonzero(shortest == LARGEST_CODE)
        self._black += np.count_nonzero(longest == 0)
        luminance = (radiance.astype(np.float64) @ LUMINANCE).ravel()
        self.maximum = max(self.maximum, float(luminance.max()))
        wanted = math.floor(self._rank) + 2  # the percentile lies between the last two
        if len(self._darkest) == wanted:
            luminance = luminance[luminance < self._darkest.max()]
        darkest = np.concatenate([self._darkest, luminance])
        if len(darkest) > wanted:
            darkest = np.partition(darkest, wanted - 1)[:wanted].copy()
        self._darkest = darkest

    @property
    def white(self) -> float:
        """The share of pixels that have a channel that is white even at the shortest exposure."""
        return self._white / self._pixels

    @property
    def black(self) -> float:
        """The share of pixels whose channels are all black even at the longest exposure."""
        return self._black / self._pixels

    @property
    def percentile_1(self) -> float:
        """The 1st percentile of the luminance, to the last bit what ``np.percentile`` gives of all pixels."""
        place = math.floor(self._rank)
        rising = np.sort(self._darkest)
        low, high = rising[place], rising[min(place + 1, len(rising) - 1)]
        share = self._rank - place
        return float(low + (high - low) * share if share < 0.5 else high - (high - low) * (1.0 - share))
