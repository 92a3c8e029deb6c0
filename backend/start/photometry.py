# SPDX-License-Identifier: GPL-3.0-or-later
"""What of the photos' brightness is the camera's: gains, white balances and vignetting, from points alone.

A point that many photos see has one radiance (nearly, where surfaces are matt), so that what they disagree
about is the cameras'. With z a code value, t the stated exposure, R a point's ln radiance,

    ln f⁻¹(z) − gain of the photo − balance of the place − ln v(ρ) − R = ln t

which is linear in everything unknown, the inverse response among it (a polynomial of logit z; Debevec and
Malik's equation, "Recovering high dynamic range radiance maps from photographs", 1997, with the lens and the
shutter in it). All points' R are eliminated exactly; the rest is a few hundred numbers, solved with weights
that forget what disagrees for other reasons: points that something hides, and highlights.

Gradient descent beside the scene does not find a lens: where cameras look inward, a scene that is darker at
its borders explains nearly the same, and it is what gradients find first (docs/notebook.md).
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
from ..scene.camera import Camera
from ..scene.scene import View

#: At most this many points, and points times photos.
POINTS, OBSERVATIONS = 3000, 300_000
#: Points in a cell of the picture, by which others are hidden that are so much farther.
POINTS_A_CELL, HIDDEN_FROM = 4.0, 1.1
#: Codes between these tell how much light there was.
TELLING = (0.03, 0.97)
#: What is white in 8 bits. So many must be known to be white, and not to be, to tell from where on it is.
WHITE, FEWEST_WHITE = 254.5 / 255.0, 100
#: Degree of ln f⁻¹ as a polynomial of logit z, and the ridge that keeps it one.
DEGREE, RIDGE = 6, 1e-6
#: The response is found where stated exposures differ by so much (standard deviation, stops); else it is
#: taken as it is when training starts.
LEAST_STOPS = 0.5
#: What g″, g = ln f⁻¹, is expected to be over logit z, per square root of a unit: exposures that are powers
#: of one ratio tie codes to each other only that far apart, and leave open what lies between.
BENDING = 0.1
#: Where ln exposure differs by less (standard deviation), photos count as of one exposure.
ONE_EXPOSURE = 0.1 * math.log(2.0)
#: A deviation that is none (stops).
NO_STOPS = 0.002
#: Rounds of reweighting; a residual of so many standard deviations loses half its weight.
ROUNDS, TOLERANCE = 12, 1.0
#: Residuals are never taken to spread less (natural logarithm): nothing is put aside for so little.
LEAST_SPREAD = 0.02
#: What residuals are expected to be (natural logarithm): how deviations that are expected weigh against them.
EXPECTED = 0.1
#: So heavy that the gauge holds.
GAUGE = 1e6
#: Where photos disagree about points by more than this share of what points differ by, the points are none:
#: random ones, say. (Median deviations.)
LARGEST_SHARE = 0.3
#: With fewer equations than this for each unknown there is nothing to be found.
LEAST_EQUATIONS = 20

LN2 = math.log(2.0)


@dataclass(frozen=True)
class Photometry:
    """Natural logarithms: ``gain`` ``[P]`` of the photos, ``balance`` ``[V, 2]`` of the places' red and blue.

    ``vignetting`` ``[L, 3]`` of the lenses (``model.camera_effects``), all ≥ 0. ``inverse_response``
    ``[3, D]``: ln f⁻¹ of each channel, a polynomial of logit z (``inverse_at``); None where nobody looked.
    ``white`` ``[3]``: its value from which a channel is white; NaN where photos do not tell.
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
class _Equations:
    """One a channel of a point in a photo, all ``[N]`` but ``rho``: which ones, and what was seen there."""

    point: np.ndarray
    photo: np.ndarray
    place: np.ndarray
    channel: np.ndarray
    lens: np.ndarray
    rho: np.ndarray
    code: np.ndarray
    #: ln(exposure × radiance), where the encoding is known, else NaN.
    known: np.ndarray
    log_time: np.ndarray


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
) -> Photometry | None:
    """What the points ``[P, 3]`` (metres) tell; None where they are too few, or the photos see nothing alike.

    ``exposures[i]``: positions in the bracket of ``views[i]``, whose photos are counted in this order;
    ``lens[i]``: its lens, and ``reach`` where ρ is 1 for each. ``deviations``: expected of gain and balance,
    stops. ``finds_response``: else it is ``response``. ``vignetting`` ``[L, 3]``: where it is known.
    In the gauge: neither gains nor balances have a mean, or a slope over ln t; with one, the response of red
    and blue could be as steep as it likes.
    """
    photos = sum(len(indices) for indices in exposures)
    count = max(min(POINTS, OBSERVATIONS // photos), 1)
    chosen = np.ones(len(points), dtype=bool)
    if len(points) > count:
        along = morton_order(torch.as_tensor(points)).numpy()
        chosen[:] = False
        chosen[along[np.linspace(0, len(along) - 1, count).astype(int)]] = True
    seen, bright = _equations(points, chosen, views, exposures, lens, reach)
    unknowns = 3 * DEGREE + photos + 2 * len(views) + COEFFICIENTS * len(reach)
    if len(seen.code) < LEAST_EQUATIONS * unknowns:
        return None
    counts = photos, len(views), len(reach)
    found = _solved(seen, bright, counts, response, deviations, finds_response, vignetting)
    if found is None and finds_response:
        # Gains that follow the exposure of most photos, and forget the others, leave nothing to a response.
        held = NO_STOPS, NO_STOPS
        found = _solved(seen, bright, counts, response, held, finds_response, vignetting)
    return found


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
        which, _, rho = _projected(points, view, reach[lens[place]])
        red, blue = found.balance[place]
        effect = np.array([red, 0.0, blue]) + found.gain[photo : photo + len(indices)].mean()
        falling = falloff_terms(rho) @ found.vignetting[lens[place]]
        total[which] += len(indices) * (effect - falling[:, None])
        times[which] += len(indices)
        photo += len(indices)
    return total / np.maximum(times, 1.0)[:, None]


def _projected(points: np.ndarray, view: View, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points ``[P, 3]`` are in the frame ``[M]``, where ``[M, 2]`` (x, y in pixels' centres), their ρ.

    What lies beyond the outermost centres of pixels is not in it: it could not be interpolated.
    """
    camera = view.camera
    inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    before = inside[:, 2] > 1e-6
    tangent = inside[:, :2] / np.where(before, inside[:, 2], 1.0)[:, None]
    at = tangent * [camera.fx, camera.fy] + [camera.cx - 0.5, camera.cy - 0.5]
    which = np.flatnonzero(
        before & (at >= 0).all(axis=1) & (at < [camera.width - 1, camera.height - 1]).all(1)
    )
    return which, at[which], np.square(tangent[which]).sum(axis=1) / reach


def _unhidden(at: np.ndarray, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Which of the points at ``at`` ``[M, 2]`` (pixels) have none much nearer beside them, ``[M]`` bool.

    A surface is only known by its points: the picture is divided into cells that have a few each.
    """
    cell = math.sqrt(camera.width * camera.height * POINTS_A_CELL / max(len(at), 1))
    column, row = (at // cell).astype(int).T
    width, height = int(camera.width // cell) + 3, int(camera.height // cell) + 3
    nearest = np.full((height, width), np.inf)  # with a border
    np.minimum.at(nearest, (row + 1, column + 1), depth)
    around = [nearest[1 + j : height - 1 + j, 1 + i : width - 1 + i] for j in (-1, 0, 1) for i in (-1, 0, 1)]
    return depth < HIDDEN_FROM * np.min(around, axis=0)[row, column]


def _equations(
    points: np.ndarray,
    chosen: np.ndarray,
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    lens: Sequence[int],
    reach: Sequence[float],
) -> tuple[_Equations, _Equations]:
    """What tells how much light there was, and what is brighter, up to white."""
    columns: tuple[list[tuple[np.ndarray, ...]], ...] = ([], [])
    photo = 0
    for place, (view, indices) in enumerate(zip(views, exposures, strict=True)):
        which, at, rho = _projected(points, view, reach[lens[place]])
        depth = points[which] @ view.camera.world_to_camera[2, :3] + view.camera.world_to_camera[2, 3]
        used = chosen[which] & _unhidden(at, depth, view.camera)
        which, at, rho = which[used], at[used], rho[used]
        x, y = at.T
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        right_share, bottom_share = (x - left)[:, None], (y - top)[:, None]
        for k in indices:
            picture, encoding, mask = view.image(k), view.encodings[k], view.mask(k)
            corners = [picture[top + j, left + i] for j in (0, 1) for i in (0, 1)]
            unit = encoding.unit(picture.dtype)
            upper, lower = (a + (b * 1.0 - a) * right_share for a, b in (corners[:2], corners[2:]))
            code = (upper + (lower - upper) * bottom_share) / unit
            tells = code > TELLING[0]
            if encoding.clips:
                tells &= code < TELLING[1]
            if mask is not None:
                tells &= mask[top, left][:, None]
            bright = (code >= TELLING[1]) & encoding.clips
            if mask is not None:
                bright &= mask[top, left][:, None]
            for chosen_codes, column in zip((tells, bright), columns, strict=True):
                row, channel = np.nonzero(chosen_codes)
                values = code[row, channel]
                known = encoding.decode(values) if encoding.is_known else np.full(len(values), math.nan)
                same = np.ones(len(values), dtype=int)
                column.append(
                    (
                        *(which[row], same * photo, same * place, channel, same * lens[place]),
                        *(rho[row], values, np.log(known), same * math.log(view.exposures[k])),
                    )
                )
            photo += 1
    telling, bright = (
        _Equations(*(np.concatenate(each) for each in zip(*column, strict=True))) for column in columns
    )
    return telling, bright


def _solved(
    seen: _Equations,
    bright: _Equations,
    counts: tuple[int, int, int],
    response: Response,
    deviations: tuple[float, float],
    finds_response: bool,
    vignetting: np.ndarray | None,
) -> Photometry | None:
    from scipy import sparse  # here, because only this needs it
    from scipy.optimize import nnls

    photos, places, lens_count = counts
    count = len(seen.code)
    target = seen.log_time.copy()
    is_known = ~np.isnan(seen.known)
    target[is_known] -= seen.known[is_known]
    terms = falloff_terms(seen.rho)
    if vignetting is not None:
        target -= (terms * vignetting[seen.lens]).sum(axis=1)
    logit = np.where(is_known, 0.0, np.log(seen.code / np.maximum(1.0 - seen.code, 1e-9)))
    times = _first_of(seen.photo, seen.log_time, photos)
    finds_response &= bool((~is_known).any() and np.std(times) > LEAST_STOPS * LN2)
    if not finds_response:
        codes = torch.from_numpy(np.broadcast_to(seen.code, (3, count)).copy())
        inverse = response.inverse(codes).numpy()[seen.channel, np.arange(count)]
        target[~is_known] -= inverse[~is_known]

    # Columns: the response, gains, balances; those of the lenses last.
    polynomial = 3 * DEGREE if finds_response else 0
    others = polynomial + photos + 2 * places
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    rows = np.arange(count)
    if finds_response:
        asked = rows[~is_known]
        for power, value in enumerate(_powers(logit[asked]).T):
            parts.append((asked, seen.channel[asked] * DEGREE + power, value))
    parts.append((rows, polynomial + seen.photo, -np.ones(count)))
    coloured = rows[seen.channel != 1]
    side = (seen.channel[coloured] == 2).astype(int)
    parts.append((coloured, polynomial + photos + 2 * seen.place[coloured] + side, -np.ones(len(coloured))))
    for term, value in enumerate(terms.T):
        parts.append((rows, others + COEFFICIENTS * seen.lens + term, value))
    row, column, value = (np.concatenate(each) for each in zip(*parts, strict=True))
    size = others + COEFFICIENTS * lens_count
    design: Any = sparse.csr_matrix((value, (row, column)), shape=(count, size))
    group = np.unique(seen.point * 3 + seen.channel, return_inverse=True)[1]
    groups: Any = sparse.csr_matrix((np.ones(count), (rows, group)), shape=(count, int(group.max()) + 1))

    pull = np.full(size, RIDGE)
    pull[polynomial : polynomial + photos] = (EXPECTED / (LN2 * deviations[0])) ** 2
    pull[polynomial + photos : others] = (EXPECTED / (LN2 * deviations[1])) ** 2
    if vignetting is not None:
        pull[others:] = GAUGE * count  # there is nothing left to be found
    smooth = np.zeros((size, size))
    for channel in range(3 if finds_response else 0):
        block = slice(channel * DEGREE, (channel + 1) * DEGREE)
        smooth[block, block] = (EXPECTED / BENDING) ** 2 * _bending()
    gauge = np.zeros((6, size))
    gauge[0, polynomial : polynomial + photos] = 1.0
    gauge[1, polynomial : polynomial + photos] = times - times.mean()
    tells = np.bincount(seen.place, minlength=places)
    place_times = np.bincount(seen.place, seen.log_time, places) / tells.clip(1)
    place_times = np.where(tells > 0, place_times - place_times[tells > 0].mean(), 0.0)
    for side in (0, 1):
        balances = slice(polynomial + photos + side, others, 2)
        gauge[2 + side, balances] = 1.0
        if np.std(place_times) > ONE_EXPOSURE:
            gauge[4 + side, balances] = place_times

    hat = np.where(is_known, 1.0, 2.0 * np.minimum(seen.code, 1.0 - seen.code).clip(0.0))
    weight = hat
    solution, spread, contrast = np.zeros(size), 0.0, 0.0
    mean_radiance = np.zeros(groups.shape[1])
    for _ in range(ROUNDS):
        weighted = design.multiply(weight[:, None]).tocsr()
        total = np.asarray(groups.T @ weight).ravel()
        between = (groups.T @ weighted).tocsr()  # [G, size]
        mean = np.asarray(groups.T @ (weight * target)).ravel() / total
        shares = sparse.diags(1.0 / total) @ between
        normal = np.asarray((design.T @ weighted - between.T @ shares).todense())
        right = np.asarray(weighted.T @ target - between.T @ mean).ravel()
        normal += np.diag(pull) + smooth + GAUGE * gauge.T @ gauge
        solution = _with_falling_lens(normal, right, others, nnls)
        radiance = target - design @ solution
        contrast = 1.4826 * float(np.median(np.abs(radiance - np.median(radiance))))
        mean_radiance = np.asarray(groups.T @ (weight * radiance)).ravel() / total
        residual = radiance - mean_radiance[group]
        spread = max(1.4826 * float(np.median(np.abs(residual))), LEAST_SPREAD)
        weight = hat / (1.0 + (residual / (TOLERANCE * spread)) ** 2)
    if spread > LARGEST_SHARE * contrast:
        return None
    gain, balance, lens = np.split(solution[polynomial:], [photos, photos + 2 * places])
    found = lens.reshape(-1, COEFFICIENTS) if vignetting is None else vignetting
    if not finds_response:
        return Photometry(gain, balance.reshape(-1, 2), found)
    inverse = solution[:polynomial].reshape(3, DEGREE)
    solved = Photometry(gain, balance.reshape(-1, 2), found, inverse)
    radiance_of = dict(
        zip((seen.point * 3 + seen.channel).tolist(), (-mean_radiance[group]).tolist(), strict=True)
    )
    return replace(solved, white=_white_from(seen, bright, solved, radiance_of))


def _white_from(
    seen: _Equations, bright: _Equations, solved: Photometry, radiance_of: dict[int, float]
) -> np.ndarray:
    """ln(exposure × radiance) from which each channel is white, ``[3]``: where most are on the right side.

    A point's radiance is what photos tell in which it is not white. NaN where few are known to be either.
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


def _light(seen: _Equations, solved: Photometry, radiance_of: dict[int, float]) -> np.ndarray:
    """ln(exposure × radiance) ``[N]`` as each photo had it; NaN of a point whose radiance nobody told."""
    radiance = np.array([radiance_of.get(key, math.nan) for key in (seen.point * 3 + seen.channel).tolist()])
    red, blue = solved.balance[seen.place].T
    balance = np.select([seen.channel == 0, seen.channel == 2], [red, blue], 0.0)
    falling = (falloff_terms(seen.rho) * solved.vignetting[seen.lens]).sum(axis=1)
    return radiance + seen.log_time + solved.gain[seen.photo] + balance - falling


def _powers(logit: np.ndarray) -> np.ndarray:
    """``[N, D]`` of logits ``[N]``: what ln f⁻¹ is made of."""
    return 3.0 * (logit[:, None] / 3.0) ** np.arange(1, DEGREE + 1)


def _bending() -> np.ndarray:
    """``[D, D]``: makes of a polynomial's coefficients ∫ g″² d logit z over the codes that tell."""
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


def _with_falling_lens(normal: np.ndarray, right: np.ndarray, others: int, nnls: Any) -> np.ndarray:
    """The solution of the normal equations whose last unknowns, from ``others`` on, are ≥ 0."""
    first, last = slice(0, others), slice(others, None)
    inverse = np.linalg.solve(normal[first, first], np.column_stack([normal[first, last], right[first]]))
    reduced = normal[last, last] - normal[last, first] @ inverse[:, :-1]
    reduced_right = right[last] - normal[last, first] @ inverse[:, -1]
    factor = np.linalg.cholesky(0.5 * (reduced + reduced.T))
    lens, _ = nnls(factor.T, np.linalg.solve(factor, reduced_right))
    return np.concatenate([inverse[:, -1] - inverse[:, :-1] @ lens, lens])
