# SPDX-License-Identifier: GPL-3.0-or-later
"""What of the photos' brightness is the camera's: gains, white balances and vignetting, from points alone.

A point that many photos see has one radiance (nearly, where surfaces are matt), so that what they disagree
about is the cameras'. With z a code value, t the stated exposure, R a point's ln radiance,

    ln f⁻¹(z) − gain of the photo − balance of the place − ln v(ρ) − R = ln t

which is linear in everything unknown, the inverse response among it (a polynomial of logit z; Debevec and
Malik's equation, "Recovering high dynamic range radiance maps from photographs", 1997, with the lens and the
shutter in it). All points' R are eliminated exactly; the rest is a few hundred numbers, solved with weights
that forget what disagrees for other reasons: points that something hides, and highlights.

It is z that errs, not t. Least squares with ln f⁻¹ at the codes that were seen would make it too flat, and
the flatter, the less exposures differ, until gains explain all of them (regression dilution). So ln f⁻¹ is
asked at the code ẑ that the rest of the solution expects, and how the observation differs from that is the
residual, round by round.

Gradient descent beside the scene does not find a lens: where cameras look inward, a scene that is darker at
its borders explains nearly the same, and it is what gradients find first (lab/notebook.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ..model.camera_effects import COEFFICIENTS, falloff_terms
from ..model.morton import morton_order
from ..model.tone_mapper import Response
from ..scene.scene import View
from .observations import TELLING, Observations, in_sight, observations, projected

#: Enough points, and at most so many pairs of a point and a photo that sees it, unless more are needed.
POINTS, OBSERVATIONS = 3000, 300_000
#: So many views are used to estimate in how many photos a point is seen.
SAMPLED_VIEWS = 100
#: White in 8 bits. So many must be known to be white, and not to be, to find where it begins.
WHITE, FEWEST_WHITE = 254.5 / 255.0, 100
#: Degree of ln f⁻¹ as a polynomial of logit z, and the ridge that keeps it one.
DEGREE, RIDGE = 6, 1e-6
#: The response is found where stated exposures differ by so much (standard deviation, stops); else it is
#: taken as it is when training starts.
LEAST_STOPS = 0.5
#: What g″, g = ln f⁻¹, is expected to be over logit z, per square root of a unit: exposures that are powers
#: of one ratio tie codes to each other only that far apart, and leave open what lies between. And what a
#: channel's is expected to differ from the others'.
BENDING, ALIKE = 0.1, 0.03
#: Where ln exposure differs by less (standard deviation), photos count as of one exposure.
ONE_EXPOSURE = 0.1 * math.log(2.0)
#: A deviation that is none (stops).
NO_STOPS = 0.002
#: Rounds, and how many of them with codes as they were seen. A residual of so many standard deviations loses
#: half its weight.
ROUNDS, SETTLING, TOLERANCE = 12, 3, 1.0
#: Residuals are never taken to spread less (natural logarithm): nothing is put aside for so little.
LEAST_SPREAD = 0.02
#: What residuals are expected to be (natural logarithm): how deviations that are expected weigh against them.
EXPECTED = 0.1
#: Logits of the codes that may be expected, and how finely they are distinguished.
EXPECTED_CODES, GRID = math.log(99.0), 401
#: What is left of the weight of what was seen only because it errs inward: no point may be without any.
UNEVEN = 1e-3
#: So heavy that the gauge holds.
GAUGE = 1e6
#: Where photos disagree about points by more than this share of what points differ by, the points are none:
#: random ones, say. (Median deviations.)
LARGEST_SHARE = 0.3
#: With fewer equations than this for each unknown there is nothing to be found.
LEAST_EQUATIONS = 20
#: So many are sought for each unknown: not all that is in sight shows how much light there was.
SOUGHT_EQUATIONS = 5 * LEAST_EQUATIONS
#: With more unknowns nothing is sought: their normal equations are dense.
MOST_UNKNOWNS = 12_000

LN2 = math.log(2.0)


@dataclass(frozen=True)
class Photometry:
    """Natural logarithms: ``gain`` ``[P]`` of the photos, ``balance`` ``[V, 2]`` of the places' red and blue.

    ``vignetting`` ``[L, 3]`` of the lenses (``model.camera_effects``), all ≥ 0. ``inverse_response``
    ``[3, D]``: ln f⁻¹ of each channel, a polynomial of logit z (``inverse_at``); None if not solved for.
    ``white`` ``[3]``: its value from which a channel is white; NaN where photos do not show it.
    """

    gain: np.ndarray
    balance: np.ndarray
    vignetting: np.ndarray
    inverse_response: np.ndarray | None = None
    white: np.ndarray | None = None

    def inverse_at(self, logits: np.ndarray) -> np.ndarray:
        """ln(exposure × radiance) ``[3, N]`` of codes whose logits are ``[N]``, 0 at half of white."""
        assert self.inverse_response is not None
        return self.inverse_response @ _powers(logits).T


@dataclass(frozen=True)
class NoPhotometry:
    """Points show nothing about the photos; ``reason``: why, as shown to the user."""

    reason: str


def photometry(
    points: np.ndarray,
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    lens: Sequence[int],
    reach: Sequence[float],
    response: Response,
    deviations: tuple[float, float],
    *,
    finds_response: bool = True,
    vignetting: np.ndarray | None = None,
) -> Photometry | NoPhotometry:
    """What the points ``[P, 3]`` (metres) show of the photos, or why they show nothing.

    ``exposures[i]``: positions in the bracket of ``views[i]``, whose photos are counted in this order;
    ``lens[i]``: its lens, and ``reach`` where ρ is 1 for each. ``deviations``: expected of gain and balance,
    stops. ``finds_response``: else it is ``response``. ``vignetting`` ``[L, 3]``: where it is known.
    In the gauge: neither gains nor balances have a mean, or a slope over ln t; with one, the response of red
    and blue could be as steep as it likes.

    Each photo is read once. Memory and time are bounded: there are about as many equations as three times
    ``OBSERVATIONS``, or ``SOUGHT_EQUATIONS`` for each of U unknowns, and U is at most ``MOST_UNKNOWNS``. One
    core solves 900,000 equations in 26 seconds and 1.3 GB at U = 3,000, in 89 seconds and 2 GB at 6,000; at
    ``MOST_UNKNOWNS`` it is 5 to 6 GB (32 U² bytes and what the equations take), and some ten minutes.
    """
    photos = sum(len(indices) for indices in exposures)
    unknowns = 3 * DEGREE + photos + 2 * len(views) + COEFFICIENTS * len(reach)
    if unknowns > MOST_UNKNOWNS:
        return NoPhotometry(f"{photos:,} photos in {len(views):,} views are too many to solve for at once")
    chosen = _chosen(points, views, photos, lens, reach, unknowns)
    seen, bright = observations(points, chosen, views, exposures, lens, reach)
    needed = LEAST_EQUATIONS * unknowns
    if len(seen.code) < needed:
        values = f"{len(seen.code):,} usable colour values"
        return NoPhotometry(f"{photos:,} photos show points with only {values}, {needed:,} are needed")
    counts = photos, len(views), len(reach)
    return _solved(seen, bright, counts, response, deviations, finds_response, vignetting)


def point_effects(
    points: np.ndarray,
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    lens: Sequence[int],
    reach: Sequence[float],
    found: Photometry,
) -> np.ndarray:
    """Of each point ``[P, 3]`` the mean of ln effect over the photos whose frame it is in, ``[P, 3]``."""
    total, times = np.zeros((len(points), 3)), np.zeros(len(points))
    photo = 0
    for place, (view, indices) in enumerate(zip(views, exposures, strict=True)):
        which, _, rho = projected(points, view, reach[lens[place]])
        red, blue = found.balance[place]
        effect = np.array([red, 0.0, blue]) + found.gain[photo : photo + len(indices)].mean()
        falling = falloff_terms(rho) @ found.vignetting[lens[place]]
        total[which] += len(indices) * (effect - falling[:, None])
        times[which] += len(indices)
        photo += len(indices)
    return total / np.maximum(times, 1.0)[:, None]


def _chosen(
    points: np.ndarray,
    views: Sequence[View],
    photos: int,
    lens: Sequence[int],
    reach: Sequence[float],
    unknowns: int,
) -> np.ndarray:
    """Which of the points are used, ``[P]`` bool: enough of them, all over the scene.

    In a walk of a thousand photos a point is seen in few of them, so that more points are used.
    """
    count, along = POINTS, morton_order(torch.as_tensor(points)).numpy()
    if photos * POINTS > OBSERVATIONS:
        some = _evenly(along, POINTS)
        sampled = np.unique(np.linspace(0, len(views) - 1, SAMPLED_VIEWS).astype(int))
        in_views = [len(in_sight(points, some, views[i], reach[lens[i]])[0]) for i in sampled]
        of_a_point = max(photos * float(np.mean(in_views)) / int(some.sum()), 1.0)
        needed = SOUGHT_EQUATIONS * unknowns / (3.0 * of_a_point)
        count = math.ceil(max(min(POINTS, OBSERVATIONS / of_a_point), needed))
    return _evenly(along, count)


def _evenly(along: np.ndarray, count: int) -> np.ndarray:
    """``count`` of the points whose indices are ``along`` a curve, or all: ``[P]`` bool."""
    chosen = np.ones(len(along), dtype=bool)
    if len(along) > count:
        chosen[:] = False
        chosen[along[np.linspace(0, len(along) - 1, count).astype(int)]] = True
    return chosen


def _solved(
    seen: Observations,
    bright: Observations,
    counts: tuple[int, int, int],
    response: Response,
    deviations: tuple[float, float],
    finds_response: bool,
    vignetting: np.ndarray | None,
) -> Photometry | NoPhotometry:
    from scipy import sparse  # here, because only this needs it

    photos, places, lenses = counts
    count = len(seen.code)
    is_known = ~np.isnan(seen.known)
    times = _first_of(seen.photo, seen.log_time, photos)
    finds_response &= bool((~is_known).any() and np.std(times) > LEAST_STOPS * LN2)
    time = np.where(is_known, seen.log_time - seen.known, seen.log_time)
    if vignetting is not None:
        time -= (falloff_terms(seen.rho) * vignetting[seen.lens]).sum(axis=1)
    if not finds_response:
        codes = torch.from_numpy(np.broadcast_to(seen.code, (3, count)).copy())
        inverse = response.inverse(codes).numpy()[seen.channel, np.arange(count)]
        time[~is_known] -= inverse[~is_known]

    columns = _Columns(3 * DEGREE if finds_response else 0, photos, places, lenses)
    prior = _prior(seen, times, columns, deviations, known_lens=vignetting is not None)
    effects = _effects(seen, columns)
    asked = np.flatnonzero(~is_known if finds_response else np.zeros(count, dtype=bool))
    channel = seen.channel[asked]
    observed = _inverse_responses(_logit(seen.code[asked]), channel, asked, effects.shape)
    group = np.unique(seen.point * 3 + seen.channel, return_inverse=True)[1]
    groups: Any = sparse.csr_matrix((np.ones(count), (np.arange(count), group)))

    # As they were observed, until it is known what is to be expected.
    expected, target, hat = observed, time, np.where(is_known, 1.0, _hat(seen.code))
    weight, mean, spread, contrast = hat, np.zeros(count), 0.0, 0.0
    solution = np.zeros(columns.lens.stop)
    for turn in range(ROUNDS):
        solution = _least_squares(expected + effects, target, weight, groups, prior, columns)
        light = time - effects @ solution
        radiance = light - observed @ solution  # −R, as each observation has it
        mean = (groups.T @ (weight * radiance) / (groups.T @ weight))[group]
        residual = radiance - mean
        contrast = _deviation(radiance - np.median(radiance))
        spread = max(_deviation(residual), LEAST_SPREAD)
        if finds_response and turn >= SETTLING:
            curves = solution[: columns.response].reshape(3, DEGREE)
            there = (light - mean)[asked]
            logit = _codes_of(there, channel, curves)
            expected = _inverse_responses(logit, channel, asked, effects.shape)
            target = time - (observed - expected) @ solution
            even = _is_even(there, residual[asked], channel, curves)
            hat[asked] = _hat(1.0 / (1.0 + np.exp(-logit))) * np.where(even, 1.0, UNEVEN)
        weight = hat / (1.0 + (residual / (TOLERANCE * spread)) ** 2)
    if spread > LARGEST_SHARE * contrast:
        return NoPhotometry("photos disagree too much about how bright points are")

    lens = solution[columns.lens].reshape(-1, COEFFICIENTS) if vignetting is None else vignetting
    found = Photometry(solution[columns.gain], solution[columns.balance].reshape(-1, 2), lens)
    if not finds_response:
        return found
    found = replace(found, inverse_response=solution[: columns.response].reshape(3, DEGREE))
    radiance_of = dict(zip((seen.point * 3 + seen.channel).tolist(), (-mean).tolist(), strict=True))
    return replace(found, white=_white_from(seen, bright, found, radiance_of))


@dataclass(frozen=True)
class _Columns:
    """Where each unknown is: ``response`` of them first, then gains, balances, and the lenses last."""

    response: int
    photos: int
    places: int
    lenses: int

    @property
    def gain(self) -> slice:
        return slice(self.response, self.response + self.photos)

    @property
    def balance(self) -> slice:
        return slice(self.gain.stop, self.gain.stop + 2 * self.places)

    @property
    def lens(self) -> slice:
        return slice(self.balance.stop, self.balance.stop + COEFFICIENTS * self.lenses)


def _prior(
    seen: Observations,
    times: np.ndarray,
    columns: _Columns,
    deviations: tuple[float, float],
    *,
    known_lens: bool,
) -> np.ndarray:
    """``[U, U]``: what is expected of the unknowns, and the gauge. ``times`` ``[P]``: ln exposure."""
    pull = np.full(columns.lens.stop, RIDGE)
    pull[columns.gain] = (EXPECTED / (LN2 * deviations[0])) ** 2
    pull[columns.balance] = (EXPECTED / (LN2 * deviations[1])) ** 2
    if known_lens:
        pull[columns.lens] = GAUGE * len(seen.code)  # there is nothing left to be found
    prior = np.diag(pull)
    if columns.response:
        of_channels = np.eye(3) / BENDING**2 + (np.eye(3) - 1.0 / 3.0) / ALIKE**2
        prior[: columns.response, : columns.response] += EXPECTED**2 * np.kron(of_channels, _bending())
    gauge = np.zeros((6, columns.lens.stop))
    gauge[0, columns.gain] = 1.0
    gauge[1, columns.gain] = times - times.mean()
    tells = np.bincount(seen.place, minlength=columns.places)
    place_times = np.bincount(seen.place, seen.log_time, columns.places) / tells.clip(1)
    place_times = np.where(tells > 0, place_times - place_times[tells > 0].mean(), 0.0)
    for side in (0, 1):
        balances = slice(columns.balance.start + side, columns.balance.stop, 2)
        gauge[2 + side, balances] = 1.0
        if np.std(place_times) > ONE_EXPOSURE:
            gauge[4 + side, balances] = place_times
    return prior + GAUGE * gauge.T @ gauge


def _effects(seen: Observations, columns: _Columns) -> Any:
    """``[N, U]``, sparse: makes of the unknowns −ln effect of each observation."""
    rows = np.arange(len(seen.code))
    coloured = rows[seen.channel != 1]
    side = (seen.channel[coloured] == 2).astype(int)
    parts = [
        (rows, columns.gain.start + seen.photo, -np.ones(len(rows))),
        (coloured, columns.balance.start + 2 * seen.place[coloured] + side, -np.ones(len(coloured))),
    ]
    for term, value in enumerate(falloff_terms(seen.rho).T):
        parts.append((rows, columns.lens.start + COEFFICIENTS * seen.lens + term, value))
    return _sparse(parts, (len(rows), columns.lens.stop))


def _inverse_responses(
    logit: np.ndarray, channel: np.ndarray, asked: np.ndarray, shape: tuple[int, int]
) -> Any:
    """``shape``, sparse: makes of the unknowns ln f⁻¹ of the ``asked`` observations, at codes ``logit``."""
    powers = enumerate(_powers(logit).T)
    return _sparse([(asked, channel * DEGREE + power, value) for power, value in powers], shape)


def _sparse(parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], shape: tuple[int, int]) -> Any:
    """Of rows, columns and values."""
    from scipy import sparse

    row, column, value = (np.concatenate(each) for each in zip(*parts, strict=True))
    return sparse.csr_matrix((value, (row, column)), shape=shape)


def _least_squares(
    design: Any, target: np.ndarray, weight: np.ndarray, groups: Any, prior: np.ndarray, columns: _Columns
) -> np.ndarray:
    """The unknowns ``[U]`` by which ``design @ unknowns`` differs least from ``target`` within each group."""
    from scipy import sparse

    weighted = design.multiply(weight[:, None]).tocsr()
    total = groups.T @ weight
    between = (groups.T @ weighted).tocsr()  # [G, U]
    mean = groups.T @ (weight * target) / total
    shares = sparse.diags(1.0 / total) @ between
    normal = (design.T @ weighted - between.T @ shares).toarray() + prior
    right = weighted.T @ target - between.T @ mean
    return _with_falling_lens(normal, right, columns.lens.start)


def _codes_of(light: np.ndarray, channel: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """The logits of the codes that ln(exposure × radiance) ``[N]`` makes by the curves ``[3, D]``."""
    grid = np.linspace(-EXPECTED_CODES, EXPECTED_CODES, GRID)
    found = np.empty(len(light))
    for k, curve in enumerate(curves @ _powers(grid).T):
        rising = np.maximum.accumulate(curve)
        which = channel == k
        found[which] = np.interp(light[which], rising, grid)
    return found


def _is_even(light: np.ndarray, residual: np.ndarray, channel: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """Whether a residual of the other sign would have been seen as well: ``[N]`` bool.

    Near the ends of the usable codes only those that lead inward are seen, and their mean is not 0 (Powell,
    "Symmetrically trimmed least squares estimation for Tobit models", 1986).
    """
    low, high = (_powers(_logit(np.array(TELLING))) @ curves.T)[:, channel]
    return (light - np.abs(residual) > low) & (light + np.abs(residual) < high)


def _deviation(values: np.ndarray) -> float:
    """The standard deviation of most, by the median."""
    return 1.4826 * float(np.median(np.abs(values)))


def _hat(code: np.ndarray) -> np.ndarray:
    """How much a code counts: least near black and white."""
    return 2.0 * np.minimum(code, 1.0 - code)


def _logit(code: np.ndarray) -> np.ndarray:
    return np.log(code / (1.0 - code))


def _white_from(
    seen: Observations, bright: Observations, solved: Photometry, radiance_of: dict[int, float]
) -> np.ndarray:
    """ln(exposure × radiance) from which each channel is white, ``[3]``: where most are on the right side.

    A point's radiance comes from photos in which it is not white. NaN where few are known to be either.
    """
    light, channels, codes = (
        np.concatenate(pair)
        for pair in (
            [_light(each, solved, radiance_of) for each in (seen, bright)],
            (seen.channel, bright.channel),
            (seen.code, bright.code),
        )
    )
    found = np.full(3, math.nan)
    for channel in range(3):
        asked = (channels == channel) & (codes > 0.5) & ~np.isnan(light)
        below, white = (np.sort(light[asked & side]) for side in (codes < WHITE, codes >= WHITE))
        if min(len(below), len(white)) >= FEWEST_WHITE:
            at = np.sort(np.concatenate([below, white]))
            wrong = len(below) - np.searchsorted(below, at, "right") + np.searchsorted(white, at, "right")
            found[channel] = np.median(at[wrong == wrong.min()])
    return found


def _light(seen: Observations, solved: Photometry, radiance_of: dict[int, float]) -> np.ndarray:
    """ln(exposure × radiance) ``[N]`` as each photo had it; NaN for a point of unknown radiance."""
    radiance = np.array([radiance_of.get(key, math.nan) for key in (seen.point * 3 + seen.channel).tolist()])
    red, blue = solved.balance[seen.place].T
    balance = np.select([seen.channel == 0, seen.channel == 2], [red, blue], 0.0)
    falling = (falloff_terms(seen.rho) * solved.vignetting[seen.lens]).sum(axis=1)
    return radiance + seen.log_time + solved.gain[seen.photo] + balance - falling


def _powers(logit: np.ndarray) -> np.ndarray:
    """``[N, D]`` of logits ``[N]``: what ln f⁻¹ is made of."""
    return 3.0 * (logit[:, None] / 3.0) ** np.arange(1, DEGREE + 1)


def _bending() -> np.ndarray:
    """``[D, D]``: makes of a polynomial's coefficients ∫ g″² d logit z over the usable codes."""
    end = math.log(TELLING[1] / (1.0 - TELLING[1]))
    at = np.linspace(-end, end, 1001)
    power = np.arange(1, DEGREE + 1)
    second = power * (power - 1) / 3.0 * (at[:, None] / 3.0) ** np.maximum(power - 2, 0)
    return second.T @ second * (at[1] - at[0])


def _first_of(index: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    """``[count]``: the value that goes with each index, their mean where an index does not occur."""
    found = np.full(count, value.mean())
    found[index] = value
    return found


def _with_falling_lens(normal: np.ndarray, right: np.ndarray, others: int) -> np.ndarray:
    """The solution of the normal equations whose last unknowns, from ``others`` on, are ≥ 0."""
    from scipy.optimize import nnls

    first, last = slice(0, others), slice(others, None)
    inverse = np.linalg.solve(normal[first, first], np.column_stack([normal[first, last], right[first]]))
    reduced = normal[last, last] - normal[last, first] @ inverse[:, :-1]
    reduced_right = right[last] - normal[last, first] @ inverse[:, -1]
    factor = np.linalg.cholesky(0.5 * (reduced + reduced.T))
    lens, _ = nnls(factor.T, np.linalg.solve(factor, reduced_right))
    return np.concatenate([inverse[:, -1] - inverse[:, :-1] @ lens, lens])
