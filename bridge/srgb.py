# SPDX-License-Identifier: GPL-3.0-or-later
"""The sRGB transfer function (IEC 61966-2-1), which nodes and shaders write as formulas of these numbers."""

import numpy as np

#: The straight piece near black: its slope, and where it ends, as a code and as a scene-linear value.
SLOPE = 12.92
CODE_KNEE, LINEAR_KNEE = 0.04045, 0.0031308
#: The power piece: linear = ((code + OFFSET) / SCALE)^POWER.
OFFSET, SCALE, POWER = 0.055, 1.055, 2.4


def to_linear(code: np.ndarray | float) -> np.ndarray:
    """Scene-linear values of sRGB codes; codes above 1 follow the curve further."""
    code = np.asarray(code)
    power = ((np.maximum(code, CODE_KNEE) + OFFSET) / SCALE) ** POWER
    return np.where(code <= CODE_KNEE, code / SLOPE, power)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB codes of scene-linear values; values above 1 follow the curve further."""
    linear = np.asarray(linear)
    power = SCALE * np.maximum(linear, LINEAR_KNEE) ** (1.0 / POWER) - OFFSET
    return np.where(linear <= LINEAR_KNEE, linear * SLOPE, power)
