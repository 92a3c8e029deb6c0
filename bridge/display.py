# SPDX-License-Identifier: GPL-3.0-or-later
"""Between scene-linear radiance and the display-referred colours of standard 3DGS files.

A standard file's colour toward a camera is Σ_k sh_k Y_k(ω) + ½, as a screen shows it. Ours is
exp(Σ_k sh_k Y_k(ω)), scene-linear. Going either way, the function of the direction is sampled over the
sphere, converted there, and fitted again.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from . import srgb
from .errors import BadValueError
from .lights import AMBIENT, Levels, as_levels, in_words
from .model_file import Model
from .spherical_harmonics import (
    C0,
    FIT_DIRECTIONS,
    basis,
    degree_of,
    exponential,
    fibonacci_sphere,
    quadrature,
    refit,
)

ColorSpace = Literal["SRGB", "LINEAR"]
Tone = Literal["LEARNED", "SRGB"]

#: What a baked PLY's header says of each.
TONE_WORDS: dict[Tone, str] = {"LEARNED": "the learned response", "SRGB": "the sRGB curve"}

#: What a PLY's header says of colours that were fitted, beside the look that they are of.
FITTED_COMMENT = "colours fitted to pictures: their blend is the model's own picture, response after blending"

#: Display colours below this (2.5 of 255) are lifted to it before their logarithm is taken: black has none,
#: and a deeper floor makes the fit ring. The fitted colour of random degree 3 Gaussians is then off by 0.006
#: of 1 (root mean square) where their coefficients vary by 0.05, tests/bridge/test_ply_model.py.
DISPLAY_FLOOR = 0.01
#: Nodes of the quadrature with which ln radiance is fitted, by degree.
_LOG_FIT_NODES = (1, 3, 4, 5)


def log_radiance_of(
    colour_sh: np.ndarray, color_space: ColorSpace = "SRGB", ceiling: float = np.inf
) -> np.ndarray:
    """``[N, K, 3]``: SH of ln radiance for the colours Σ sh·Y + ½ of a standard 3DGS file.

    ``color_space``: ``SRGB``, display-referred, is linearised; ``LINEAR`` is taken as radiance. Exact for
    degree 0 above the floor (``DISPLAY_FLOOR``), least squares over all directions for the others.
    ``ceiling``: what is above it is taken as it.
    """
    degree = degree_of(colour_sh.shape[1])
    directions, weights = quadrature(_LOG_FIT_NODES[degree])
    evaluate = basis(directions, degree)
    linear_floor = np.float32(srgb.to_linear(DISPLAY_FLOOR))

    def log_of_linear(colour: np.ndarray) -> np.ndarray:
        colour += np.float32(0.5)
        np.clip(colour, linear_floor, np.float32(ceiling), out=colour)
        return np.log(colour, out=colour)

    def log_of_srgb(code: np.ndarray) -> np.ndarray:
        # ln of the power piece: one logarithm instead of a power and a logarithm.
        code += np.float32(0.5)
        np.minimum(code, np.float32(ceiling), out=code)
        straight = np.flatnonzero(code < srgb.CODE_KNEE)
        low = np.log(np.maximum(code.reshape(-1)[straight] / np.float32(srgb.SLOPE), linear_floor))
        np.maximum(code, np.float32(DISPLAY_FLOOR), out=code)
        code += np.float32(srgb.OFFSET)
        code *= np.float32(1.0 / srgb.SCALE)
        np.log(code, out=code)
        code *= np.float32(srgb.POWER)
        code.reshape(-1)[straight] = low
        return code

    function = log_of_srgb if color_space == "SRGB" else log_of_linear
    return refit(colour_sh, function, evaluate, (evaluate * weights[:, None]).T)


def display_colour_sh(
    model: Model,
    exposure: float = 1.0,
    level: Levels = 1.0,
    tone: Tone = "LEARNED",
    to_world: np.ndarray | None = None,
) -> np.ndarray:
    """``[N, K, 3]``: SH of the display colour (colour = Σ sh·Y + ½) of the model's look.

    ``exposure``: seconds (2^EV); ``level``: the lighting level of each of the model's lights, or of the
    first, limited to a baked-levels model's range; ``tone``: the model's learned response, or the plain sRGB
    curve, which continues above 1, as 3DGS's colours may. ``to_world`` ``[3, 3]``: the linear part of the
    object's matrix, where the colours are wanted in world space: ω in the world is seen from along
    ``to_world⁻¹ ω``. Raises ``BadValueError`` where a model has no response, or not as many lights.
    """
    log_exposure, curve = model.tone_curve_log_exposure, model.tone_curve
    if tone == "LEARNED" and (curve is None or log_exposure is None):
        raise BadValueError(
            "the model has no learned tone mapper", "Bake it with the sRGB curve (tone='SRGB')."
        )
    degree = model.sh_degree
    directions = fibonacci_sphere(FIT_DIRECTIONS)
    project = np.linalg.pinv(basis(directions, degree))
    if to_world is not None:
        directions = directions @ np.linalg.inv(to_world).T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # The level's gain and the exposure do not depend on the direction: they go into the constant term.
    sh = np.array(model.log_radiance_sh, np.float32)
    sh[:, 0] += (model.log_gain(level) + np.log(exposure)).astype(np.float32) / np.float32(C0)

    def learned(log_exposed: np.ndarray) -> np.ndarray:
        assert log_exposure is not None and curve is not None
        for c in range(3):
            log_exposed[..., c, :] = np.interp(log_exposed[..., c, :], log_exposure, curve[:, c]) - 0.5
        return log_exposed

    def through_srgb(log_exposed: np.ndarray) -> np.ndarray:
        return (srgb.to_srgb(exponential(log_exposed)) - 0.5).astype(np.float32)

    function = learned if tone == "LEARNED" else through_srgb
    return refit(sh, function, basis(directions, degree), project)


def turned_colour_sh(colour_sh: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """``[N, K, 3]``: the display colours ``colour_sh`` as they are seen under ``to_world`` ``[3, 3]``.

    ω in the world is seen from along ``to_world⁻¹ ω``. Exact for rotations and uniform scales, least squares
    over all directions else.
    """
    degree = degree_of(colour_sh.shape[1])
    directions = fibonacci_sphere(FIT_DIRECTIONS)
    local = directions @ np.linalg.inv(to_world).T
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    turn = np.linalg.pinv(basis(directions, degree)) @ basis(local, degree)
    return np.einsum("jk,nkc->njc", turn.astype(np.float32), colour_sh)


def look_comment(exposure_ev: float, level: Levels, tone: Tone, lights: Sequence[str] = (AMBIENT,)) -> str:
    """The header's line about the look that was baked; raises ``BadValueError`` as ``as_levels`` does."""
    look = look_words(exposure_ev, level, lights)
    return f"display-referred colour through {TONE_WORDS[tone]}, baked at {look}"


def look_words(exposure_ev: float, level: Levels, lights: Sequence[str] = (AMBIENT,)) -> str:
    """``EV 1, lighting level 0.5``, or with several lights ``EV 1, lighting levels ambient 1 + lamp 0.5``."""
    levels = as_levels(level, lights)
    if len(levels) == 1:
        return f"EV {exposure_ev:g}, lighting level {levels[0]:g}"
    return f"EV {exposure_ev:g}, lighting levels {in_words(dict(zip(lights, levels, strict=True)))}"
