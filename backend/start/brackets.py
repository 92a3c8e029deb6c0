# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance merged from brackets, through the response as it is when training starts.

Each picture votes with f⁻¹(code) − ln t; a code near black or white says little and weighs little (the hat
of Debevec and Malik, "Recovering high dynamic range radiance maps from photographs", 1997).
"""

import math

import numpy as np
import torch

from ..model.tone_mapper import Response
from ..scene.encoding import CAMERA, LARGEST, Encoding
from ..scene.scene import View

#: The weight from which a merged value is known: three code values from black or white in one picture.
KNOWN_FROM = 0.02


class Votes:
    """The vote of a code value for ln(exposure × radiance), and its weight, as tables."""

    def __init__(self, response: Response) -> None:
        self._response = response
        self._tables: dict[tuple[Encoding, np.dtype], tuple[np.ndarray, np.ndarray]] = {}

    def cast(
        self, code: np.ndarray, exposure: float, encoding: Encoding = CAMERA, seen: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Votes for ln radiance times their weights, and the weights, both of the shape of ``code``.

        ``code`` ``[…, 3]`` uint8 or uint16 of a picture of ``exposure`` seconds. ``seen`` ``[…]`` bool: which
        are compared; the others say nothing. None: all.
        """
        log_exposure, weights = self._table(encoding, code.dtype)
        weight = weights[code]
        if seen is not None:
            weight = weight * seen[..., None]
        channels = np.arange(3)
        return weight * (log_exposure[code, channels] - math.log(exposure)), weight

    def _table(self, encoding: Encoding, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Of each code: f⁻¹ ``[N, 3]`` for each colour channel, and the weight ``[N]``.

        The hat is not zero at the ends, so that what is clipped in every picture has a value. Where nothing
        clips all weigh alike, but for black, which says "less than".
        """
        if (encoding, dtype) not in self._tables:
            count = LARGEST[dtype] + 1
            if encoding.is_known:
                # Half a code above black: a logarithm wants more than 0.
                places = np.maximum(np.arange(count), 0.5) / encoding.unit(dtype)
                log_exposure = np.log(encoding.decode(places)).repeat(3).reshape(-1, 3)
            else:
                # Half a code of 8 bits from the ends: white says "at least so much", black "at most".
                codes = (torch.arange(count) / float(count - 1)).clamp(0.5 / 255.0, 254.5 / 255.0)
                log_exposure = self._response.inverse(codes.expand(3, -1).contiguous()).numpy().T.copy()
            to_ends = np.minimum(np.arange(count), count - 1 - np.arange(count))
            weight = to_ends / (0.5 * (count - 1)) + 1e-3
            if not encoding.clips:
                weight = np.where(np.arange(count) > 0, 1.0, 1e-3)
            self._tables[encoding, dtype] = log_exposure, weight
        return self._tables[encoding, dtype]


def log_radiance_picture(view: View, indices: tuple[int, ...], votes: Votes) -> tuple[np.ndarray, np.ndarray]:
    """A view's ln radiance ``[H, W, 3]`` float64, merged from its exposures ``indices``; where it is known.

    Known, ``[H, W]`` bool: not black or white, or masked, in every picture and channel.
    """
    each = (votes.cast(view.image(k), view.exposures[k], view.encodings[k], view.mask(k)) for k in indices)
    votes_for, weights = zip(*each, strict=True)
    weight = np.sum(weights, axis=0)
    known = weight.max(axis=2) > KNOWN_FROM
    if any(view.mask(k) is not None for k in indices):
        # What every picture masks has no vote: black there would be an edge, the mean of the rest is none.
        nowhere = weight.max(axis=2) <= 0.0
        weight = np.where(nowhere[..., None], 1.0, weight)
        merged = np.sum(votes_for, axis=0) / weight
        merged[nowhere] = merged[~nowhere].mean(axis=0) if not nowhere.all() else 0.0
        return merged, known
    return np.sum(votes_for, axis=0) / weight, known
