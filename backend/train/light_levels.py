# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of photographs that were taken in groups: levels that nobody measured, and words that are wrong.

Of each light and group whose level is unknown, ln l is learned beside the shares s of the Gaussians. The
levels of the standard light are the gauge. With x = ln radiance and 1 + Δ its modulation
(``kernels.activations``)

    ∂L/∂ln l = l Σ ∂L/∂x · s / (1 + Δ)

where ∂L/∂x is the gradient of ln H_r, which is there anyway. Where the same light has a known other level in
another group, that determines the shares, and they determine l. Without, photos show s (l − 1) alone, and
s ≤ 1 bounds l: it is the one nearest to 1 that explains them, which is exact where any surface is lit by this
light alone. It begins there (``start.light_ratio``), and a weak pull towards 1 keeps it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch

from ...bridge.photographed_light import Found
from ..kernels.activations import DARKEST
from ..methods.base import Batch, Outcome
from ..scene.scene import View
from ..start.light_ratio import LightRatio, Taken, light_ratio
from .data import Shot
from .plan import Plan
from .state import Part, State

#: Adam's, as of other values that are seen a few dozen times; steps of ln l, which fall to 0 by a cosine.
BETAS, EPSILON, RATE = (0.8, 0.95), 1e-12, 0.02
#: Share of the training before anything moves: an unfinished scene misleads.
START = 0.1
#: Weight of ln² l / 2 in the loss, where nothing else tells how far light is from 1. With less, l goes beyond
#: what shares, of which no sigmoid reaches 1, can follow; ten times as much holds it back. (Daylight at 0.15,
#: rendered room, 1500 iterations: found at 0.152; with 1e-4 at 0.100; with 3e-2, after 700, at 0.286.)
PULL = 3e-3
#: Bounds of ln l: less than a thousandth is off.
LARGEST = math.log(1000.0)
#: Where points say nothing.
UNKNOWN = 0.5
#: ln ratio that a lamp makes somewhere at least, and by how much its side must exceed the other.
SEEN, LOPSIDED = 0.1, 1.5


@dataclass(frozen=True)
class Unknown:
    """A level that is learned: of the light ``index`` in the pictures of ``group``."""

    group: str
    light: str
    index: int


def unknown_levels(views: Sequence[View], lights: Sequence[str]) -> list[Unknown]:
    """What is unknown of the light of ``views``, in their order."""
    found = (
        Unknown(view.group, lights[index], index)
        for view in views
        for index, level in enumerate(view.lighting_levels)
        if level is None
    )
    return list(dict.fromkeys(found))


def is_measured(views: Sequence[View], light: int) -> bool:
    """Whether a known other level of the light in ``views`` tells its shares."""
    there = {(view.lighting_levels[light], view.standard_levels[light]) for view in views}
    return any(level not in (None, usual) for level, usual in there)


def how_found(views: Sequence[View], lights: Sequence[str]) -> dict[str, dict[str, Found]]:
    """Of each group of ``views`` the lights whose levels training finds, and how."""
    found: dict[str, dict[str, Found]] = {}
    for each in unknown_levels(views, lights):
        how: Found = "measured" if is_measured(views, each.index) else "estimated"
        found.setdefault(each.group, {})[each.light] = how
    return found


def with_levels(views: Sequence[View], found: Mapping[tuple[str, int], float]) -> list[View]:
    """``views`` whose unknown levels are ``found``, by group and light; others stay unknown."""

    def of(view: View) -> tuple[float | None, ...]:
        each = enumerate(view.lighting_levels)
        return tuple(found.get((view.group, k)) if level is None else level for k, level in each)

    return [view if view.is_standard else replace(view, lighting_levels=of(view)) for view in views]


class LightLevels(Part):
    """``log_level`` ``[U]`` of ``unknown``, on the host.

    ``notes``: what is wrong with groups' words, by the first points, and at the end by the trained ones and
    the learned response, in a resumed training, too.
    """

    name = "light_levels"

    @classmethod
    def is_wanted(cls, plan: Plan) -> bool:
        return any(view.group for view in plan.seen.views)

    @classmethod
    def new(cls, state: State) -> Self:
        part = cls(state)
        if state.iteration == 0:
            ratios = _ratios(state)
            part.begin(ratios)
            part.check_words(ratios)
            state.start_message += "".join(f". {note}" for note in part.notes)
        return part

    def __init__(self, state: State) -> None:
        self._state, self.views, self.lights = state, state.views, state.plan.seen.lights
        self.unknown = unknown_levels(self.views, self.lights)
        self._row = {(each.group, each.index): row for row, each in enumerate(self.unknown)}
        self.log_level = np.full(len(self.unknown), math.log(UNKNOWN))
        self.moments = np.zeros((2, len(self.unknown)))
        self.steps = np.zeros(len(self.unknown))
        self.notes: list[str] = []
        self._batch: Batch | None = None
        self._rows: list[tuple[int, int]] = []  # of the view that is seen: the row, and which light it is
        self._gradient = np.zeros(0)

    def begin(self, ratios: Mapping[str, LightRatio | None]) -> None:
        """Start from what points say of each group."""
        for row, each in enumerate(self.unknown):
            if (ratio := ratios[each.group]) is not None:
                level = ratio.darkest if ratio.median < 1.0 else ratio.brightest
                self.log_level[row] = np.clip(math.log(level), -LARGEST, LARGEST)

    def check_words(self, ratios: Mapping[str, LightRatio | None]) -> None:
        """Note what points say against the words of groups."""
        firsts = {view.group: view for view in self.views[::-1] if view.group}
        notes = (_wrong_words(firsts[group], ratio, self.lights) for group, ratio in ratios.items())
        self.notes = [note for note in notes if note]

    @property
    def levels(self) -> dict[tuple[str, int], float]:
        """The levels that are learned, by group and light."""
        return {key: math.exp(self.log_level[row]) for key, row in self._row.items()}

    # -- in an iteration -------------------------------------------------------------------------------

    def before(self, batch: Batch, shot: Shot) -> Batch:
        view = shot.view
        self._rows = [
            (self._row[view.group, k], k) for k, level in enumerate(view.lighting_levels) if level is None
        ]
        if not self._rows:
            return batch
        (seen,) = with_levels([view], self.levels)
        return replace(batch, levels=seen.known_levels)

    def term(self, outcome: Outcome) -> None:
        if self._rows and outcome.drawn is not None:
            outcome.drawn.splats.log_reflectance.retain_grad()

    def after(self, outcome: Outcome, batch: Batch) -> None:
        if not self._rows or outcome.drawn is None:
            return
        splats = outcome.drawn.splats
        share, passed = splats.light_share, splats.log_reflectance.grad
        assert share is not None and passed is not None
        self._gradient = level_gradient(passed, share.detach(), batch.levels).cpu().numpy()

    def step(self, batch: Batch) -> None:
        if self._state.iteration == self._state.plan.iterations:
            self.check_words(_ratios(self._state))
        if batch.progress < START:
            return
        for row, light in self._rows:
            gradient = math.exp(self.log_level[row]) * self._gradient[light]
            gradient += 0.0 if is_measured(self.views, light) else PULL * self.log_level[row]
            self.steps[row] += 1.0
            corrected = []
            for moment, beta, new in zip(self.moments, BETAS, (gradient, gradient**2), strict=True):
                moment[row] = beta * moment[row] + (1.0 - beta) * new
                corrected.append(moment[row] / (1.0 - beta ** self.steps[row]))
            rate = RATE * 0.5 * (1.0 + math.cos(math.pi * batch.progress))
            moved = self.log_level[row] - rate * corrected[0] / (math.sqrt(corrected[1]) + EPSILON)
            self.log_level[row] = np.clip(moved, -LARGEST, LARGEST)

    # -- what it has found -----------------------------------------------------------------------------

    @property
    def summary(self) -> str:
        return ". ".join([*map(self._in_words, self.unknown), *self.notes])

    def _in_words(self, each: Unknown) -> str:
        how = how_found(self.views, self.lights)[each.group][each.light]
        if how == "estimated":
            how += ": right if this light alone lights some surface"
        level = self.levels[each.group, each.index]
        return f"{each.light} in '{each.group}' is at {level:.3g} ({how})"

    # -- checkpoints -----------------------------------------------------------------------------------

    def tensors(self) -> dict[str, torch.Tensor]:
        return {
            "log_level": torch.from_numpy(self.log_level),
            "exp_avg": torch.from_numpy(self.moments[0]),
            "exp_avg_sq": torch.from_numpy(self.moments[1]),
            "step": torch.from_numpy(self.steps),
        }

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        arrays = {name: tensor.cpu().numpy() for name, tensor in tensors.items()}
        self.log_level[...], self.steps[...] = arrays["log_level"], arrays["step"]
        self.moments[0], self.moments[1] = arrays["exp_avg"], arrays["exp_avg_sq"]


@torch.no_grad()
def level_gradient(passed: torch.Tensor, share: torch.Tensor, levels: Sequence[float]) -> torch.Tensor:
    """∂L/∂l ``[C]`` of ∂L/∂ln radiance ``[N, 3]``, shares ``[N, C, 3]`` and C ``levels``."""
    offsets = torch.tensor([level - 1.0 for level in levels], dtype=share.dtype, device=share.device)
    change = torch.einsum("ncd,c->nd", share, offsets)
    through = torch.where(change >= DARKEST - 1.0, passed / (1.0 + change), 0.0)
    return torch.einsum("nd,ncd->c", through, share)


def _ratios(state: State) -> dict[str, LightRatio | None]:
    """Of each group, what the primitives' places say."""
    taken: list[Taken] = list(zip(state.views, state.data.exposures, strict=True))
    standard = [each for each in taken if each[0].is_standard]
    positions = state.method.backbone.positions.detach().double().cpu().numpy()
    groups: dict[str, list[Taken]] = {}
    for each in taken:
        if each[0].group:
            groups.setdefault(each[0].group, []).append(each)
    response = state.method.first_response
    return {name: light_ratio(positions, standard, group, response) for name, group in groups.items()}


def _wrong_words(view: View, ratio: LightRatio | None, lights: Sequence[str]) -> str:
    """What the photos of a view's group say against its levels; empty if nothing does."""
    each = zip(lights, view.lighting_levels, view.standard_levels, strict=True)
    changed = {light: (level, usual) for light, level, usual in each if level != usual}
    words = f"'{view.group}' ({', '.join(changed)})"
    if ratio is None:
        return f"{words}: its photos share too few points with the others to check its light"
    below, above = ratio.tails
    if max(below, above) < SEEN or (
        max(below, above) < LOPSIDED * min(below, above) and abs(math.log(ratio.median)) < SEEN
    ):
        return f"{words}: its photos are as bright as elsewhere: nobody saw this light change"
    known = [(level, usual) for level, usual in changed.values() if level is not None]
    if len(known) < len(changed):
        return ""
    factor = f"(a factor of {ratio.median:.2f} in the middle)"
    if all(level < usual for level, usual in known) and above > LOPSIDED * below:
        return f"{words}: its photos are brighter than elsewhere {factor}, although less light is stated"
    if all(level > usual for level, usual in known) and below > LOPSIDED * above:
        return f"{words}: its photos are darker than elsewhere {factor}, although more light is stated"
    return ""
