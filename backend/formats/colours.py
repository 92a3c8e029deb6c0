# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of Gaussians from one kind to another, as SH of what is described: Σ sh·Y + ½.

Each is sampled over the sphere, converted there and fitted again: exact for degree 0, least squares for the
others. Display-referred to logarithms of radiance, and a model's look, are in ``bridge/display.py``.
"""

import numpy as np

from ...bridge import srgb
from ...bridge.lights import Levels
from ...bridge.model_file import Model
from ...bridge.spherical_harmonics import (
    C0,
    FIT_DIRECTIONS,
    basis,
    degree_of,
    exponential,
    fibonacci_sphere,
    refit,
)

#: The loss of a conversion is measured on this many Gaussians, evenly spread.
_SOME = 20_000


def radiance_sh(model: Model, exposure: float = 1.0, level: Levels = 1.0) -> np.ndarray:
    """``[N, K, 3]``: SH of ``exposure`` (seconds) × scene-linear radiance at ``level``.

    A radiance that varies much with the direction, whose logarithm the model has, is met less well by linear
    SH of the same degree, and may be below 0 where it is dark: renderers take 0 there. Raises what
    ``Model.log_gain`` raises.
    """
    sh = np.array(model.log_radiance_sh, np.float32)
    sh[:, 0] += (model.log_gain(level) + np.log(exposure)).astype(np.float32) / np.float32(C0)

    def radiance(logarithm: np.ndarray) -> np.ndarray:
        values = exponential(logarithm)
        values -= np.float32(0.5)
        return values

    return _refitted(sh, radiance)


def linear_of_display(colour_sh: np.ndarray) -> np.ndarray:
    """``[N, K, 3]``: linear values of sRGB codes, both as Σ sh·Y + ½. Codes below 0 are 0."""
    return _refitted(colour_sh, lambda codes: _half_off(srgb.to_linear(np.maximum(codes + 0.5, 0.0))))


def display_of_linear(colour_sh: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """``[N, K, 3]``: sRGB codes of ``exposure`` × linear values, both as Σ sh·Y + ½.

    Values above 1 continue along the curve, as colours of 3DGS may; values below 0 are 0.
    """
    return _refitted(
        colour_sh, lambda values: _half_off(srgb.to_srgb(exposure * np.maximum(values + 0.5, 0.0)))
    )


def lost_by_decoding(colour_sh: np.ndarray, linear_sh: np.ndarray) -> float:
    """How far codes of ``linear_sh`` are from the ``colour_sh`` that it was made of: root mean square.

    As a screen shows them, 0…1, over all directions. SH of a few degrees describe no decoded SH exactly.
    """
    some = slice(None, None, -(-len(colour_sh) // _SOME))
    directions = basis(fibonacci_sphere(FIT_DIRECTIONS), degree_of(colour_sh.shape[1]))
    shown = [
        np.einsum("qk,nkc->nqc", directions, sh) + 0.5
        for sh in (colour_sh[some], display_of_linear(linear_sh[some]))
    ]
    return float(np.sqrt(np.square(np.clip(shown[0], 0.0, 1.0) - np.clip(shown[1], 0.0, 1.0)).mean()))


def exposed(colour_sh: np.ndarray, exposure: float) -> np.ndarray:
    """``[N, K, 3]``: ``exposure`` × linear values, both as Σ sh·Y + ½; exact."""
    scaled = np.float32(exposure) * colour_sh
    scaled[:, 0] += np.float32(0.5 * (exposure - 1.0) / C0)
    return scaled


def _half_off(values: np.ndarray) -> np.ndarray:
    return (values - 0.5).astype(np.float32)


def _refitted(sh: np.ndarray, function) -> np.ndarray:
    directions = fibonacci_sphere(FIT_DIRECTIONS)
    evaluate = basis(directions, degree_of(sh.shape[1]))
    return refit(sh, function, evaluate, np.linalg.pinv(evaluate))
