# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera's response at the start of a training: from brackets, or from points, or else sRGB's.

A pixel has one radiance in all pictures of its bracket, so that two codes of it, at exposures t₁ < t₂, say

    g(z₂) − g(z₁) = ln(t₂ / t₁),    g = ln f⁻¹

which is linear in g (Debevec and Malik, "Recovering high dynamic range radiance maps from photographs",
1997). No geometry is needed. Two things the equation leaves open. An offset: g passes the data set's anchor,
or is 0 at half of white. And, where all exposures are powers of one ratio, everything that is periodic over
ln E with that ratio: sixteenfold exposures tie only one code in each four stops to each other. So what is
known of cameras has to say the rest: their responses are smooth over logit z, where film, sRGB's curve and
Reinhard's all are nearly straight.

Of all pixels that have code z₂ in one picture, z₁ is their median code in the other: noise and rounding are
gone before a logarithm would make a bias of them, and a median is where a curve or black takes it (a mean is
not: at ISO 25,600 the response of what is dark was up to 7 codes too dark).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...bridge import srgb
from ..scene.scene import View
from .merged_brackets import SAMPLED_PIXELS
from .observations import TELLING
from .photometry import Photometry

CODES = 256
#: Exposures of a pair differ by so much at least: of nearly equal ones noise is all that differs.
LEAST_RATIO = 1.5
#: Brighter codes that are asked, and darker ones that say something: neither near black nor near white.
ASKED, DARKEST, BRIGHTEST = range(6, 250), 2.0, 249.0
#: So many pixels have a median.
FEWEST_PIXELS = 20
#: The standard deviation of what is rounded, and the standard error of a median in those of a mean.
ROUNDING, MEDIANS_ERROR = 1.0 / math.sqrt(12.0), math.sqrt(math.pi / 2.0)
#: What a median code may be wrong by, of 255. Rounding is wrong by a third of one, but by the same amount for
#: neighbouring codes, and a curve that follows it bends where the camera's does not.
CODE_ERROR = 1.0
#: What g″ over logit z is expected to be, per square root of a unit, and what a channel's differs from all's.
BENDING = 0.1
#: Where the others agree on a curve, what is so many deviations away weighs half.
TOLERANCE = 2.0
ROUNDS = 6
#: So heavy that the offset holds.
GAUGE = 1e8
#: With fewer equations nothing is found.
FEWEST_EQUATIONS = 60
#: Logit z over ln E: nothing that a camera does is flatter, and white is reached no faster.
FLATTEST, STEEPEST = 0.1, 25.0
#: ln E from a twentieth of white to nineteen of them is between these in all that is a camera's.
SPAN = (1.0, 14.0)

_CODE = np.arange(CODES, dtype=np.float64)
#: Logit z; half a code from the ends, where it has none.
_LOGIT = np.log(np.clip(_CODE, 0.5, 254.5) / np.clip(255.0 - _CODE, 0.5, 254.5))


@dataclass(frozen=True)
class _Equations:
    """One for each brighter code of a pair of exposures, all ``[E]``: ``bright`` int, the others float64.

    ``dark``: the median of the same pixels in the darker picture, and its standard ``error``; codes of 255.
    """

    bright: np.ndarray
    dark: np.ndarray
    error: np.ndarray
    log_ratio: np.ndarray


def bracket_response(
    views: Sequence[View], exposures: Sequence[tuple[int, ...]], anchor: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """ln(exposure × radiance) and the response's logits there, ``[3, N]`` each, both rising.

    ``exposures[i]``: positions in ``views[i]``'s bracket that may be seen; ``anchor``: (exposure × radiance,
    code value in 0…1) through which it passes. None where no brackets of one camera's codes are, or they say
    too little.
    """
    equations = [_equations(counts) for counts in _counts(views, exposures)]
    together = _joined(equations)
    if len(together.bright) < FEWEST_EQUATIONS:
        return None
    at, value = _gauge(anchor)
    common = _solved(together, at, value, 2.2 * _LOGIT, np.zeros(CODES))
    curves = [_solved(each, at, value, common, common) for each in equations]
    return _cameras(curves, at, value)


def point_response(
    found: Photometry | None, anchor: tuple[float, float] | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """The same from points, where views have one exposure each; None if they do not determine it."""
    if found is None or found.inverse_response is None:
        return None
    # Beyond the codes that were looked at a polynomial goes anywhere: straight on, or to where white begins.
    ends = np.log(np.divide(TELLING, np.subtract(1.0, TELLING)))
    inside = np.clip(_LOGIT, *ends)
    step = 0.5
    first, last = (
        np.diff(found.inverse_at(np.array(pair)))[:, 0] / step
        for pair in ((ends[0], ends[0] + step), (ends[1] - step, ends[1]))
    )
    below, above = np.minimum(_LOGIT - inside, 0.0), np.maximum(_LOGIT - inside, 0.0)
    curves = found.inverse_at(inside) + first[:, None] * below + last[:, None] * above
    if found.white is not None:
        curves = np.stack([_up_to_white(*each) for each in zip(curves, found.white, strict=True)])
    at, value = _gauge(anchor)
    return _cameras(list(curves), at, value)


def _up_to_white(curve: np.ndarray, white: float) -> np.ndarray:
    """g ``[256]`` that is ``white`` at the last code and below it at all others; as it is if that is NaN."""
    if math.isnan(white):
        return curve
    below = np.minimum(curve, white - (_LOGIT[-1] - _LOGIT) / STEEPEST)
    last = math.log(TELLING[1] / (1.0 - TELLING[1]))
    there = np.interp(last, _LOGIT, below)
    return np.where(last < _LOGIT, np.interp(_LOGIT, (last, _LOGIT[-1]), (there, white)), below)


def display_response(anchor: tuple[float, float] | None) -> tuple[np.ndarray, np.ndarray]:
    """The same if nothing determines it: sRGB's curve. Cameras develop pictures to be seen on a display."""
    codes = np.clip(_CODE, 0.5, 255.0) / 255.0
    at, value = _gauge(anchor)
    rising = _rising(np.log(srgb.to_linear(codes)), at, value)
    return _as_logits(np.stack([rising] * 3))


def _gauge(anchor: tuple[float, float] | None) -> tuple[float, float]:
    """A code and g there."""
    return (128.0, 0.0) if anchor is None else (255.0 * anchor[1], math.log(anchor[0]))


def _cameras(curves: Sequence[np.ndarray], at: float, value: float) -> tuple[np.ndarray, np.ndarray] | None:
    """g of the channels as ln(exposure × radiance) and logits; None where no camera is like that."""
    rising = np.stack([_rising(curve, at, value) for curve in curves])
    span = np.diff([np.interp((0.05 * 255.0, 0.95 * 255.0), _CODE, curve) for curve in rising])
    if not ((span > SPAN[0]) & (span < SPAN[1])).all():
        return None
    return _as_logits(rising)


def _as_logits(rising: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is returned of g ``[3, 256]``: g and the codes' logits, ``[3, 254]`` each."""
    inner = slice(1, CODES - 1)  # black and white have no logit
    return rising[:, inner], np.broadcast_to(_LOGIT[inner], (3, CODES - 2)).copy()


def _counts(views: Sequence[View], exposures: Sequence[tuple[int, ...]]) -> list[dict[float, np.ndarray]]:
    """For each channel and ln ratio of exposures: how often each ``[brighter code, darker code]`` is."""
    counts: list[dict[float, np.ndarray]] = [{}, {}, {}]
    pairs = []
    for view, seen in zip(views, exposures, strict=True):
        learned = sorted((k for k in seen if not view.encodings[k].is_known), key=lambda k: view.exposures[k])
        for place, dark in enumerate(learned):
            for bright in learned[place + 1 :]:
                ratio = view.exposures[bright] / view.exposures[dark]
                if ratio >= LEAST_RATIO:
                    pairs.append((view, dark, bright, round(math.log(ratio), 3)))
    pixels = sum(view.camera.width * view.camera.height for view, *_ in pairs)
    step = math.ceil(pixels / SAMPLED_PIXELS) if pairs else 1
    for view, dark, bright, log_ratio in pairs:
        darker, brighter = (_codes(view, k, step) for k in (dark, bright))
        compared = np.ones(len(darker), dtype=bool)
        for mask in (view.mask(dark), view.mask(bright)):
            if mask is not None:
                compared &= mask.reshape(-1)[::step]
        for channel in range(3):
            pair = brighter[compared, channel] * CODES + darker[compared, channel]
            count = np.bincount(pair, minlength=CODES * CODES).reshape(CODES, CODES)
            counts[channel][log_ratio] = counts[channel].get(log_ratio, 0) + count
    return counts


def _codes(view: View, k: int, step: int) -> np.ndarray:
    """``[P, 3]`` int64, 0 … 255, of every ``step``-th pixel."""
    picture = view.image(k)
    codes = picture.reshape(-1, 3)[::step] * (255.0 / view.encodings[k].unit(picture.dtype))
    return np.rint(codes).astype(np.int64)


def _equations(counts: dict[float, np.ndarray]) -> _Equations:
    """What one channel's pixels say."""
    found: list[tuple[float, float, float, float]] = []
    edges = np.arange(CODES + 1) - 0.5
    for log_ratio, count in counts.items():
        for bright in ASKED:
            row = count[bright]
            if row.sum() < FEWEST_PIXELS:
                continue
            below = row.cumsum() / row.sum()
            low, dark, high = np.interp((0.16, 0.5, 0.84), np.concatenate([[0.0], below]), edges)
            deviation = math.hypot(0.5 * (high - low), ROUNDING)
            # Where much is cut off at black nothing is known of how it spreads.
            if max(DARKEST, deviation) <= dark <= BRIGHTEST:
                error = MEDIANS_ERROR * deviation / math.sqrt(row.sum())
                found.append((bright, float(dark), error, log_ratio))
    bright, dark, error, log_ratio = np.array(found, dtype=np.float64).reshape(-1, 4).T
    return _Equations(bright.astype(np.int64), dark, error, log_ratio)


def _joined(equations: Sequence[_Equations]) -> _Equations:
    names = ("bright", "dark", "error", "log_ratio")
    return _Equations(*(np.concatenate([getattr(each, name) for each in equations]) for name in names))


def _solved(seen: _Equations, at: float, value: float, begin: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """g at all codes ``[256]``, ``value`` at code ``at``; where nothing is known it bends as ``expected``.

    ``begin``: what it is about, by whose slopes errors of codes become errors of g.
    """
    difference = np.zeros((len(seen.bright), CODES))
    rows = np.arange(len(seen.bright))
    difference[rows, seen.bright] = 1.0
    left = np.floor(seen.dark).astype(int)
    share = seen.dark - left
    difference[rows, left] -= 1.0 - share
    difference[rows, left + 1] -= share

    bends = _bends() / BENDING
    passes = np.interp(at, _CODE, np.arange(CODES))
    gauge = np.maximum(1.0 - np.abs(_CODE - passes), 0.0)
    normal_of_prior = bends.T @ bends + GAUGE * np.outer(gauge, gauge)
    right_of_prior = bends.T @ (bends @ expected) + GAUGE * gauge * value
    curve: np.ndarray = begin
    residual: np.ndarray = np.zeros(len(rows))
    for _ in range(ROUNDS):
        slope: np.ndarray = np.maximum(np.gradient(curve), 1e-3)  # per code
        variance = np.square(np.interp(seen.dark, _CODE, slope)) * (seen.error**2 + CODE_ERROR**2)
        variance += np.square(slope[seen.bright] * CODE_ERROR)
        weight = 1.0 / (variance * (1.0 + residual**2 / (TOLERANCE**2 * variance)))
        weighted = difference * weight[:, None]
        normal = weighted.T @ difference + normal_of_prior
        curve = np.linalg.solve(normal, weighted.T @ seen.log_ratio + right_of_prior)
        residual = difference @ curve - seen.log_ratio
    return curve


def _bends() -> np.ndarray:
    """``[254, 256]``: makes of g at all codes its g″ over logit z, whose squares' sum is ∫ g″² d logit z."""
    step = np.diff(_LOGIT)
    width = np.sqrt(0.5 * (step[:-1] + step[1:]))
    inner = np.arange(CODES - 2)
    bends = np.zeros((CODES - 2, CODES))
    bends[inner, inner] = 1.0 / step[:-1] / width
    bends[inner, inner + 1] = -(1.0 / step[:-1] + 1.0 / step[1:]) / width
    bends[inner, inner + 2] = 1.0 / step[1:] / width
    return bends


def _rising(curve: np.ndarray, at: float, value: float) -> np.ndarray:
    """The same, with slopes that a camera has; still ``value`` at code ``at``."""
    logit_steps = np.diff(_LOGIT)
    steps = np.clip(np.diff(curve), logit_steps / STEEPEST, logit_steps / FLATTEST)
    rising = np.concatenate([[0.0], np.cumsum(steps)])
    return rising - np.interp(at, _CODE, rising) + value
