# SPDX-License-Identifier: GPL-3.0-or-later
"""What the confidence of a radiance is, in words, in numbers and in colours; one meaning in all rooms.

A Gaussian's confidence, 0 to 1, is the probability that its radiance is within a tenth of a stop of the true
one (the mean over red, green and blue of |ln radiance − ln truth| is below ``TOLERANCE``). It is blended as a
colour is: of a pixel it is the sum of the Gaussians' confidences by their weights, and where nothing is drawn
it is 0. How it is estimated: ``backend/export/confidence.py``; against truth: docs/light.md.
"""

import math

import numpy as np

#: A tenth of a stop, as a natural logarithm: 7 %.
STOPS = 0.1
TOLERANCE = STOPS * math.log(2.0)
MEANING = "probability that the radiance is within a tenth of a stop of the true one, 0 to 1"

#: 9 knots of matplotlib's colour map *viridis* (van der Walt and Smith, CC0), sRGB: lightness rises evenly,
#: for the colour-blind, too.
# fmt: off
RAMP = np.array([
    (68, 1, 84), (72, 40, 120), (62, 74, 137), (49, 104, 142), (38, 130, 142), (31, 158, 137), (53, 183, 121),
    (110, 206, 88), (253, 231, 37),
], np.float64) / 255.0
# fmt: on


def colours(confidence: np.ndarray) -> np.ndarray:
    """``[…]`` in 0 … 1 (clipped) as ``[…, 3]`` sRGB values 0 … 1: from violet, unsure, to yellow, sure."""
    knots = np.linspace(0.0, 1.0, len(RAMP))
    return np.stack([np.interp(confidence, knots, RAMP[:, channel]) for channel in range(3)], axis=-1)
