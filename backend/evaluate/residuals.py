# SPDX-License-Identifier: GPL-3.0-or-later
"""Error images: differences from the truth as colours of rising brightness."""

import numpy as np
import torch

#: Residuals are magnified by this factor: a tenth of the range is the brightest colour.
RESIDUAL_GAIN = 10.0

#: 17 knots of matplotlib's colour map *inferno* (Smith and van der Walt, CC0), but black for no error. Its
#: lightness rises evenly, so that it reads in print and for the colour-blind.
# fmt: off
HEAT = np.array([
    (0, 0, 0), (11, 7, 36), (33, 12, 74), (61, 9, 101), (87, 16, 110), (113, 25, 110), (138, 34, 106),
    (163, 44, 97), (188, 55, 84), (210, 70, 68), (228, 90, 49), (241, 115, 29), (249, 142, 9), (252, 172, 17),
    (249, 203, 53), (242, 234, 105), (252, 255, 164),
], np.float64)
# fmt: on


def heat(values: np.ndarray) -> np.ndarray:
    """``[…]`` in 0…1 (clipped) as ``[…, 3]`` uint8 of the colour map."""
    knots = np.linspace(0.0, 1.0, len(HEAT))
    return np.stack([np.interp(values, knots, HEAT[:, c]).round() for c in range(3)], -1).astype(np.uint8)


def residual(picture: torch.Tensor, reference: torch.Tensor, gain: float = RESIDUAL_GAIN) -> np.ndarray:
    """``[H, W, 3]`` uint8: gain × |picture − reference| of ``[3, H, W]``, the worst channel, in colours."""
    error = (picture.double().cpu() - reference.double().cpu()).abs().amax(dim=0)
    return heat(gain * error.numpy())


def legend(width: int, gain: float = RESIDUAL_GAIN, height: int = 20) -> tuple[str, np.ndarray]:
    """A label, and the colours from no error to the largest that is distinguished: ``[height, width, 3]``."""
    bar = np.broadcast_to(heat(np.linspace(0.0, 1.0, width)), (height, width, 3))
    return f"residual: 0 to {1.0 / gain:.3g} of white", np.ascontiguousarray(bar)
