# SPDX-License-Identifier: GPL-3.0-or-later
"""Training pictures in each of which is the light of a whole bracket: less noise, and no response is needed.

A pixel of a bracket sees one light at several exposures. Its longest exposure that does not clip counted most
photons; what a shorter one has beyond that is noise. Whatever the response is, one and the same camera makes
of a code at exposure j a certain code at exposure k: the median of what all pixels show, a monotone table
(the intensity mapping of Grossberg and Nayar, "Determining the camera response from images", 2003). How far
codes scatter about it is noise: of a pair of exposures, with s the table's slope,

    var(code k | code j) = σ²(code k) + s² σ²(code j),

and as a sensor's noise depends on the light that it counts, σ² is one function of the code for all exposures.
Solved by least squares with σ² ≥ 0 it is the pictures' own noise level; nobody has to state it. Each picture
then becomes the mean of what it and the others predict, each weighted by 1/variance, where they agree.

Medians, because codes are a curved function of the light: of noisy codes the mean is not the code of the mean
light, the median is (but for what is cut off at black and white).
"""

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..memory import picture_room
from ..scene.scene import View
from ..simd import kernel, run_ranges

#: Codes are distinguished in steps of 8 bits.
CODES = 256
#: Brackets of more exposures are not merged: tables are made of every pair.
LARGEST_BRACKET = 16
#: Pixels of which tables are made, at most.
SAMPLED_PIXELS = 1 << 20
#: A code of which fewer pixels are known has its neighbours' entry; more than the most weigh no more.
LEAST_COUNT, MOST_COUNT = 20, 5000
#: Where a table is steeper, codes at j are too coarse to show the noise at k.
STEEPEST = 3.0
#: Standard deviation, in codes, of the window in which tables are smoothed.
SMOOTH = 2
#: σ² has so many knots over the codes; how much it may bend, over what the data say.
KNOTS, STIFFNESS = 32, 0.3
#: Codes nearer to black or white than this say that there was little or much light, and no more.
CUT = 1.5
#: Scatter up to so many times what noise explains is noise: σ² is an estimate.
TOLERANCE = 1.5
#: Variance of a code that is rounded.
ROUNDING = 1.0 / 12.0
#: Another exposure's prediction counts if it lies within so many standard deviations: things move.
AGREEMENT = 6.0
#: σ, in codes, from which brackets are worth merging: below it noise is hardly more than the rounding.
WORTH_IT = 1.0


@dataclass(frozen=True, eq=False)
class Tables:
    """How a camera's K exposures predict each other. All in codes of 8 bits.

    ``mapping`` ``[K, K, 3, 256]``: the code at exposure k (second) that a code at j has, each channel;
    ``variance`` the same shape: of that, without k's own noise. ``noise`` ``[256]``: σ² of a code.
    """

    mapping: np.ndarray
    variance: np.ndarray
    noise: np.ndarray

    @property
    def worst(self) -> float:
        """The largest σ of a code that is neither black nor white."""
        inside = self.noise[math.ceil(CUT) : CODES - math.ceil(CUT)]
        return float(np.sqrt(inside.max()))

    def merged(self, codes: np.ndarray) -> np.ndarray:
        """``[K, P, 3]`` float32 codes → the same of the merged pictures."""
        exposures, pixels, _ = codes.shape
        result = np.empty_like(codes)
        arrays = (np.ascontiguousarray(codes), self.mapping, self.variance, self.noise, result)
        run_ranges(_merge, pixels, exposures, *arrays)
        return result


def tables_of(stacks: Sequence[np.ndarray]) -> Tables | None:
    """What brackets of one camera show; each ``[K, P, 3]`` codes 0 … 255 of any type, with the same K.

    None if they do not overlap enough.
    """
    count = stacks[0].shape[0]
    mapping = np.zeros((count, count, 3, CODES), np.float32)
    scatter = np.full((count, count, 3, CODES), np.inf)
    known = np.zeros((count, count, 3, CODES), np.int64)
    for j, k, channel in np.ndindex(count, count, 3):
        if j != k:
            joint = sum(_joint(stack[j, :, channel], stack[k, :, channel]) for stack in stacks)
            entry = _conditional(np.asarray(joint))
            if entry is not None:
                mapping[j, k, channel], scatter[j, k, channel] = entry
                known[j, k, channel] = np.asarray(joint).sum(axis=1)
    noise = _noise(mapping, scatter, known)
    if noise is None:
        return None
    brought = _brought(mapping, noise)
    explained = brought + np.interp(mapping.clip(0.0, CODES - 1.0), np.arange(CODES), noise)
    # What scatters much more than noise explains is not noise: a gain of its own, or movement.
    variance = np.maximum(brought + np.maximum(scatter - TOLERANCE * explained, 0.0), ROUNDING)
    variance[known < LEAST_COUNT] = np.inf
    return Tables(mapping, variance.astype(np.float32), noise.astype(np.float32))


def _joint(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``[256, 256]``: how many pixels have each pair of codes."""
    pairs = np.rint(a).astype(np.int64) * CODES + np.rint(b).astype(np.int64)
    return np.bincount(pairs, minlength=CODES * CODES).reshape(CODES, CODES)


def _conditional(joint: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Median and variance ``[256]`` of b's code given a's; None where too few are known."""
    from scipy.optimize import isotonic_regression  # here, because only this needs it

    count = joint.sum(axis=1)
    known = np.flatnonzero(count >= LEAST_COUNT)
    if len(known) < 3:
        return None
    codes = np.arange(CODES)
    median, total = _quantile(joint[known], 0.5), count[known]
    spread = joint[known] @ codes**2 / total - (joint[known] @ codes / total) ** 2
    every = np.arange(CODES)
    weight = np.zeros(CODES)
    weight[known] = count[known]
    weight = np.maximum(weight, 1e-3)
    medians = np.interp(every, known, isotonic_regression(median, weights=total).x)
    medians = isotonic_regression(_smoothed(medians, weight), weights=weight).x
    variances = _smoothed(np.interp(every, known, spread), weight)
    return medians, np.maximum(variances, 0.0)


def _quantile(joint: np.ndarray, share: float) -> np.ndarray:
    """The code below which ``share`` of each row's pixels lie, spread evenly within a code."""
    cumulated = joint.cumsum(axis=1)
    wanted = share * cumulated[:, -1]
    at = (cumulated >= wanted[:, None]).argmax(axis=1)
    rows = np.arange(len(joint))
    before = cumulated[rows, at] - joint[rows, at]
    return at - 0.5 + (wanted - before) / np.maximum(joint[rows, at], 1)


def _smoothed(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted straight lines through each neighbourhood, at its middle: what is straight stays as it is."""
    places = np.arange(-3 * SMOOTH, 3 * SMOOTH + 1.0)
    window, reach = np.exp(-0.5 * (places / SMOOTH) ** 2), 3 * SMOOTH
    around = np.lib.stride_tricks.sliding_window_view
    w = around(np.pad(weights, reach), len(window)) * window
    y = around(np.pad(values, reach), len(window))
    total, first, second = w.sum(1), (w * places).sum(1), (w * places**2).sum(1)
    mean, moment = (w * y).sum(1), (w * places * y).sum(1)
    return (second * mean - first * moment) / (total * second - first**2)


def _noise(mapping: np.ndarray, scatter: np.ndarray, known: np.ndarray) -> np.ndarray | None:
    """σ² of every code ``[256]``, from all pairs; None if nothing determines it."""
    from scipy.optimize import nnls

    slope = np.gradient(mapping, axis=3)
    code = np.broadcast_to(np.arange(CODES, dtype=np.float64), mapping.shape)
    tells = (known >= LEAST_COUNT) & np.isfinite(scatter) & (slope < STEEPEST)
    for each in (code, mapping):
        tells &= (each > 2.0 * CUT) & (each < CODES - 1 - 2.0 * CUT)
    if tells.sum() < KNOTS:
        return None
    to, by, of = _hats(mapping[tells]), slope[tells] ** 2, _hats(code[tells])
    weight = np.sqrt(np.minimum(known[tells], MOST_COUNT)) / (scatter[tells] + ROUNDING)
    rows = weight[:, None] * (to + by[:, None] * of)
    bends = np.diff(np.eye(KNOTS), 2, axis=0) * (STIFFNESS * np.sqrt((rows**2).sum() / KNOTS))
    wanted = np.concatenate([weight * scatter[tells], np.zeros(len(bends))])
    knots, _ = nnls(np.concatenate([rows, bends]), wanted)
    places = np.arange(CODES) * ((KNOTS - 1) / (CODES - 1))
    return np.maximum(np.interp(places, np.arange(KNOTS), knots), ROUNDING)


def _brought(mapping: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Variance, as ``mapping``, of the prediction for k from a code of j that has j's noise.

    Over the whole reach of the noise: tables are flat near black, and bend.
    """
    result = np.zeros(mapping.shape)
    for normal, weight in zip(*np.polynomial.hermite_e.hermegauss(5), strict=True):
        moved = (np.arange(CODES) + normal * np.sqrt(noise)).clip(0.0, CODES - 1.0)
        below = np.minimum(moved.astype(np.int64), CODES - 2)
        share = moved - below
        told = mapping[..., below] * (1.0 - share) + mapping[..., below + 1] * share
        result += weight / math.sqrt(2.0 * math.pi) * (told - mapping) ** 2
    return result


def _hats(codes: np.ndarray) -> np.ndarray:
    """``[P]`` codes → ``[P, KNOTS]``: what a function that is linear between knots is made of there."""
    place = codes.clip(0.0, CODES - 1.0) * ((KNOTS - 1) / (CODES - 1))
    return np.maximum(1.0 - np.abs(place[:, None] - np.arange(KNOTS)), 0.0)


@kernel
def _merge(first, last, exposures, codes, mapping, variance, noise, result):
    """Pixels ``first … last − 1`` of ``result`` ``[K, P, 3]``."""
    for p in range(first, last):
        for c in range(3):
            for k in range(exposures):
                own = codes[k, p, c]
                value = own
                for _ in range(2):  # the second time its noise comes from better values
                    own_noise = noise[min(max(int(value + np.float32(0.5)), 0), CODES - 1)]
                    weight = np.float32(1.0) / own_noise
                    total = weight * own
                    for j in range(exposures):
                        other = codes[j, p, c]
                        if j == k or other < CUT or other > CODES - 1 - CUT:
                            continue
                        below = min(int(other), CODES - 2)
                        share = other - np.float32(below)
                        nearest = below if share < 0.5 else below + 1
                        spread = variance[j, k, c, nearest]
                        told = mapping[j, k, c, below] * (np.float32(1.0) - share)
                        told += mapping[j, k, c, below + 1] * share
                        if (told - own) ** 2 > AGREEMENT**2 * (spread + own_noise):
                            continue
                        total += told / spread
                        weight += np.float32(1.0) / spread
                    value = total / weight
                result[k, p, c] = min(max(value, np.float32(0.0)), np.float32(CODES - 1))


class MergedBrackets:
    """The merged pictures of a training. ``exposures[i]``: positions in ``views[i]``'s bracket that are seen.

    Views with the same exposures share their tables; a view with one, or with merged radiance (which has no
    code to compare), keeps its pictures. ``worst``: the largest σ, in codes of 8 bits, of any camera's.
    """

    def __init__(self, views: Sequence[View], exposures: Sequence[tuple[int, ...]]) -> None:
        groups: dict[tuple[float, ...], list[tuple[View, tuple[int, ...]]]] = {}
        for view, seen in zip(views, exposures, strict=True):
            can = 1 < len(seen) <= LARGEST_BRACKET and len({view.encodings[k] for k in seen}) == 1
            if can and view.encodings[seen[0]].clips:
                key = tuple(float(f"{view.exposures[k]:.3g}") for k in seen)
                groups.setdefault(key, []).append((view, seen))
        self._of: dict[View, tuple[tuple[int, ...], Tables]] = {}
        self.worst = 0.0
        for members in groups.values():
            pixels = sum(view.camera.width * view.camera.height for view, _ in members)
            step = math.ceil(pixels / SAMPLED_PIXELS)
            tables = tables_of([self._codes(view, seen, step) for view, seen in members])
            if tables is not None:
                self.worst = max(self.worst, tables.worst)
                self._of |= {view: (seen, tables) for view, seen in members}
        self._kept: OrderedDict[View, np.ndarray] = OrderedDict()
        self._bytes = 0

    @property
    def worth_it(self) -> bool:
        """Whether there is noise that merging would take away."""
        return self.worst >= WORTH_IT

    def codes(self, view: View, k: int) -> np.ndarray | None:
        """``[3, H, W]`` uint16, of which 65,535 is white, of picture ``k``; None: it stays as it is."""
        if view not in self._of or k not in self._of[view][0]:
            return None
        kept = self._kept.get(view)
        if kept is None:
            kept = self._kept[view] = self._merged(view)
            self._bytes += kept.nbytes
            while self._bytes > picture_room() and len(self._kept) > 1:
                self._bytes -= self._kept.popitem(last=False)[1].nbytes
        self._kept.move_to_end(view)
        return kept[self._of[view][0].index(k)]

    def _merged(self, view: View) -> np.ndarray:
        """``[K, 3, H, W]`` uint16; where a picture is masked all keep their own codes."""
        seen, tables = self._of[view]
        codes = self._codes(view, seen)
        merged = tables.merged(codes)
        if view.encodings[seen[0]].is_known:
            # What clips is brighter by nobody knows how much: a code just below would say how bright it is.
            merged = np.where(codes >= CODES - 1, codes, merged)
        masks = [view.mask(k) for k in seen]
        hidden = [~mask.reshape(-1) for mask in masks if mask is not None]
        if hidden:
            merged = np.where(np.logical_or.reduce(hidden)[:, None], codes, merged)
        shape = (len(seen), view.camera.height, view.camera.width, 3)
        pictures = np.rint(merged * (65535.0 / (CODES - 1))).astype(np.uint16).reshape(shape)
        return np.ascontiguousarray(pictures.transpose(0, 3, 1, 2))

    @staticmethod
    def _codes(view: View, seen: Sequence[int], step: int = 1) -> np.ndarray:
        """``[K, P, 3]`` float32, 0 … 255; of every ``step``-th pixel."""
        every = (view.image(k).reshape(-1, 3)[::step] for k in seen)
        scales = (255.0 / view.sources[k].encoding.unit(view.image(k).dtype) for k in seen)
        return np.stack([codes * np.float32(scale) for codes, scale in zip(every, scales, strict=True)])
