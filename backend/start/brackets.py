# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance merged from brackets, through the response as it is when training starts.

Each picture votes with f⁻¹(code) − ln t; a code near black or white says little and weighs little (the hat
of Debevec and Malik, "Recovering high dynamic range radiance maps from photographs", 1997).
"""

import math

import numpy as np
import torch

from ..model.tone_mapper import ToneMapper
from ..scene.scene import View

#: The weight from which a merged value is known: three code values from black or white in one picture.
KNOWN_FROM = 0.02


class Votes:
    """What a code value says of ln(exposure × radiance), and how much that weighs, as tables."""

    def __init__(self, tone_mapper: ToneMapper) -> None:
        codes = torch.arange(256) / 255.0
        #: ``[256, 3]``: f⁻¹ for each colour channel.
        self.log_exposure = tone_mapper.inverse(codes.expand(3, -1).contiguous()).numpy().T.copy()
        #: ``[256]``: the hat; not zero at the ends, so that what is clipped in every picture has a value.
        self.weight = np.minimum(np.arange(256), 255 - np.arange(256)) / 127.5 + 1e-3

    def cast(self, code: np.ndarray, exposure: float) -> tuple[np.ndarray, np.ndarray]:
        """Votes for ln radiance times their weights, and the weights, both of the shape of ``code``.

        ``code`` ``[…, 3]`` uint8 of a picture of ``exposure`` seconds.
        """
        weight = self.weight[code]
        channels = np.arange(3)
        return weight * (self.log_exposure[code, channels] - math.log(exposure)), weight


def log_radiance_picture(view: View, indices: tuple[int, ...], votes: Votes) -> tuple[np.ndarray, np.ndarray]:
    """A view's ln radiance ``[H, W, 3]`` float64, merged from its exposures ``indices``; where it is known.

    Known, ``[H, W]`` bool: not black or white in every picture and channel.
    """
    votes_for, weights = zip(*(votes.cast(view.image(k), view.exposures[k]) for k in indices), strict=True)
    weight = np.sum(weights, axis=0)
    return np.sum(votes_for, axis=0) / weight, weight.max(axis=2) > KNOWN_FROM
