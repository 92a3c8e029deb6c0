# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs from photo to photo and is no part of the scene: gain, white balance, vignetting.

A photo is exposed for nearly the time that it states, by a camera that decides on its white balance at each
place, through a lens whose corners are darker. Learned beside the scene and left out when it is drawn: the
light that a photo's response sees is radiance × stated exposure × ``effect``,

    ln effect = gain of the photo + balance of the place (red and blue) + ln v(ρ),   ρ = tan²θ / its largest

θ: the angle to the camera's axis. What is stated is right on the whole: that is the gauge. After every step
gains have a mean of zero over the training photos and do not follow the stated exposure (else a steeper
response with flatter radiance would look the same), and so it is with balances over the places. Photos
under other light (``lights.json``) are in the gauge group by group: else gains would be its level. So the
scale and the colour of the radiance stay where the data put them. v is 1 on the axis and never rises.

Each photo's rows are stepped when it is seen, by Adam with a count of its own, so that what is learned does
not depend on how many other photos there are.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import torch

from ...bridge.errors import BadValueError, DataMismatchError
from ..methods.base import Batch, Outcome, Recording
from ..model.camera_effects import COEFFICIENTS, falloff, lenses, squared_tangent, widest
from ..model.tone_mapper import Response
from ..scene.camera import Camera
from ..scene.scene import View
from ..start.photometry import ONE_EXPOSURE, NoPhotometry, Photometry, photometry, point_effects
from .data import Shot
from .plan import Plan
from .state import Part, State

#: Adam's, for values that are seen a few dozen times in a training.
BETAS = (0.8, 0.95)
ADAM_EPSILON = 1e-12
#: Codes between these (of 0…1) tell how much light there was; others tell only that it was little or much.
TELLING = (0.02, 0.98)
#: What a photo tells that was not seen yet; checkpoints hold it.
UNSEEN = -1.0
#: Stops to natural logarithms.
LN2 = math.log(2.0)


#: Steps of natural logarithms, each time that a photo is seen; they fall to zero by a cosine. Every iteration
#: steps the coefficients of v. These and the following were measured: lab/notebook.md.
RATES = {"log_gain": 0.005, "log_balance": 0.001, "vignetting": 0.001}
#: Expected standard deviations of a gain and of a white balance, stops.
STOPS = 0.2, 0.1
#: Weight of (value / deviation)² in the loss.
PRIOR = 1e-4
#: Share of the training before anything moves from where the points put it: an unfinished scene misleads.
START = 0.3


def telling_share(recording: Recording) -> torch.Tensor:
    """The share of a picture's values, where it is compared, that tell how much light there was."""
    low, high = TELLING
    tells = recording.picture > low
    if recording.encoding.clips:
        tells &= recording.picture < high
    share = tells.float().mean(dim=0)
    if recording.mask is None:
        return share.mean()
    return (share * recording.mask).sum() / recording.mask.sum().clamp_min(1)


class Nuisances(Part):
    """What is learned of each photo of a training. ``exposures[i]``: positions in ``views[i]``'s bracket.

    ``log_gain`` ``[P]`` of each photo, ``log_balance`` ``[V, 2]`` of red and blue at each place,
    ``vignetting`` ``[L, 3]`` of each lens (``falloff``); all natural logarithms, all 0 at the start.
    """

    name = "nuisances"

    @classmethod
    def is_wanted(cls, plan: Plan) -> bool:
        config, effects = plan.config, plan.config.method.traits.effects
        if config.nuisances == "on" and not effects:
            raise BadValueError(
                f"{config.method.name} does not model a photo's gain, white balance or vignetting",
                "Leave out --nuisances on.",
            )
        # Merged radiance and renders in EXR have no exposure or white balance of their own any more.
        taken = any(encoding.clips for view in plan.seen.views for encoding in view.encodings)
        asked = (plan.seen.scene.photographs and taken) or config.calibration is not None
        return config.nuisances == "on" or (config.nuisances == "auto" and asked and effects)

    @classmethod
    def new(cls, state: State) -> Self:
        return cls(
            state.views,
            state.data.exposures,
            state.device,
            response_is_known=state.config.calibration is not None,
        )

    def __init__(
        self,
        views: Sequence[View],
        exposures: Sequence[tuple[int, ...]],
        device: torch.device,
        response_is_known: bool = False,
        stops: tuple[float, float] = STOPS,
    ) -> None:
        self._stops = stops
        photos = [(view, k) for view, indices in zip(views, exposures, strict=True) for k in indices]
        self._photo = {photo: row for row, photo in enumerate(photos)}
        #: Those under the standard light: only there is a point as bright in one as in another.
        self._standard = [(v, e) for v, e in zip(views, exposures, strict=True) if v.is_standard]
        self._place = {view: row for row, view in enumerate(views)}
        #: The photos and places of each light: each is in the gauge by itself, or gains would be its level.
        self._groups = _groups([view.group for view, _ in photos], [view.group for view in views], device)
        self._lens = dict(zip(views, lenses([view.camera for view in views]), strict=True))
        count = 1 + max(self._lens.values())
        #: tan²θ where ρ = 1, for each lens, ``[L]``.
        reach = [max(widest(v.camera) for v in views if self._lens[v] == i) for i in range(count)]
        self.reach = torch.tensor(reach, dtype=torch.float64, device=device)
        self.log_exposure = torch.tensor(
            [math.log(view.exposures[k]) for view, k in photos], dtype=torch.float64, device=device
        )
        #: The place of each photo ``[P]``, and the mean over the photos of each place ``[V]``.
        self._place_of = torch.tensor([self._place[view] for view, _ in photos], device=device)
        self._log_exposure_there = self._at_places(self.log_exposure) / self._at_places(
            torch.ones_like(self.log_exposure)
        )
        shapes = {
            "log_gain": (len(photos),),
            "log_balance": (len(views), 2),
            "vignetting": (count, COEFFICIENTS),
        }
        self.values = {
            name: torch.zeros(shape, device=device, requires_grad=True) for name, shape in shapes.items()
        }
        #: Of each value: Adam's two moments; of each row: how often it was stepped.
        self.moments = {
            name: (torch.zeros_like(value), torch.zeros_like(value)) for name, value in self.values.items()
        }
        self.steps = {name: torch.zeros(len(value), device=device) for name, value in self.values.items()}
        #: How much each photo tells of its gain, ``[P]``: the share of its values within ``TELLING``;
        #: ``UNSEEN`` until it is seen.
        self.telling = torch.full((len(photos),), UNSEEN, device=device)
        self._seen: dict[str, torch.Tensor] = {}
        self._rows: dict[tuple[int, ...], torch.Tensor] = {}
        #: What a calibration tells does not move.
        self._response_is_known = response_is_known
        self.lens_is_known = torch.zeros((), dtype=torch.bool, device=device)

    @property
    def device(self) -> torch.device:
        return self.telling.device

    def _at_places(self, of_photos: torch.Tensor) -> torch.Tensor:
        """The sum over the photos of each place, ``[P]`` → ``[V]``."""
        there = of_photos.new_zeros(len(self._place))
        return there.index_add_(0, self._place_of, of_photos)

    def know_lens(self, vignetting: Sequence[float], reach: float) -> None:
        """The lens is as a calibration tells; raises ``DataMismatchError`` where there are several."""
        if len(self.reach) != 1:
            raise DataMismatchError(
                f"the calibration is of one lens, these photographs have {len(self.reach)} or focal lengths",
                "Train on the photographs of one of them, or without --calibration.",
            )
        with torch.no_grad():
            self.values["vignetting"].copy_(torch.tensor([list(vignetting)]))
            self.reach.fill_(reach)
            self.lens_is_known.fill_(True)

    def told_by(self, points: np.ndarray, response: Response) -> Photometry | NoPhotometry:
        """What points ``[P, 3]`` (metres) tell of the photos under the standard light, or why nothing.

        ``response``: as it is when training starts, for where they do not tell of it.
        """
        views, exposures = [view for view, _ in self._standard], [indices for _, indices in self._standard]
        known = self.values["vignetting"].detach().cpu().double().numpy() if self.lens_is_known else None
        return photometry(
            points,
            views,
            exposures,
            [self._lens[view] for view in views],
            self.reach.tolist(),
            response,
            self._stops,
            finds_response=not self._response_is_known,
            vignetting=known,
        )

    def begin(self, points: np.ndarray, told: Photometry | None) -> np.ndarray:
        """Start from what points ``[P, 3]`` told (``told_by``); returns their mean ln effect ``[P, 3]``."""
        if told is None:
            return np.zeros((len(points), 3))
        views, exposures = [view for view, _ in self._standard], [indices for _, indices in self._standard]
        photos = [self._photo[view, k] for view, indices in self._standard for k in indices]
        places = [self._place[view] for view in views]
        with torch.no_grad():
            self.values["log_gain"][photos] = torch.from_numpy(told.gain).to(self.telling)
            self.values["log_balance"][places] = torch.from_numpy(told.balance).to(self.telling)
            self.values["vignetting"].copy_(torch.from_numpy(told.vignetting))
        lens = [self._lens[view] for view in views]
        return point_effects(points, views, exposures, lens, self.reach.tolist(), told)

    # -- in an iteration -------------------------------------------------------------------------------

    def before(self, batch: Batch, shot: Shot) -> Batch:
        return replace(batch, recordings=tuple(self.applied(*shot, batch.camera, batch.recordings)))

    def term(self, outcome: Outcome) -> torch.Tensor:
        return self.prior()

    def step(self, batch: Batch) -> None:
        self.learn(batch.progress)

    def applied(
        self, view: View, indices: Sequence[int], camera: Camera, recordings: Sequence[Recording]
    ) -> list[Recording]:
        """The recordings of the view's photos ``indices``, each with its effect ``[3, H, W]``.

        ``camera``: the view's at the recordings' size. From now on until ``learn`` these photos are those
        that were seen.
        """
        rows = [self._photo[view, k] for k in indices]
        place, lens = self._place[view], self._lens[view]
        seen = {"log_gain": rows, "log_balance": [place], "vignetting": [lens]}
        self._seen = {name: self._on_device(tuple(each)) for name, each in seen.items()}
        with torch.no_grad():
            for row, recording in zip(rows, recordings, strict=True):
                self.telling[row] = telling_share(recording)
        red, blue = self.values["log_balance"][place].unbind()
        balance = torch.stack([red, torch.zeros_like(red), blue])
        gains = self.values["log_gain"][self._seen["log_gain"]]
        rho = squared_tangent(camera, gains) / self.reach[lens].to(gains.dtype)
        v = falloff(rho, self.values["vignetting"][lens]).exp()
        return [
            replace(recording, effect=(balance + gain).exp()[:, None, None] * v)
            for recording, gain in zip(recordings, gains.unbind(), strict=True)
        ]

    def _on_device(self, rows: tuple[int, ...]) -> torch.Tensor:
        """Row numbers as an index, copied once: a copy makes the host wait for the card."""
        if rows not in self._rows:
            self._rows[rows] = torch.tensor(rows, device=self.device)
        return self._rows[rows]

    def prior(self) -> torch.Tensor:
        """The loss term of the photos that were seen last: a small pull towards what is stated."""
        of_gain, of_balance = self._stops
        gains = self.values["log_gain"][self._seen["log_gain"]] / (LN2 * of_gain)
        balance = self.values["log_balance"][self._seen["log_balance"]] / (LN2 * of_balance)
        return PRIOR * (gains.square().mean() + balance.square().mean())

    @torch.no_grad()
    def learn(self, progress: float) -> None:
        """Move what was seen by the gradients that are there, then back into the gauge.

        ``progress``: share of the training that is done.
        """
        begun = progress >= START
        for name, value in self.values.items():
            rate = RATES[name] * 0.5 * (1.0 + math.cos(math.pi * progress))
            if begun and rate and value.grad is not None:
                if name == "vignetting":
                    value.grad.masked_fill_(self.lens_is_known, 0.0)
                self._adam(name, self._seen[name], rate)
            value.grad = None
        self._seen = {}
        self.project()

    def _adam(self, name: str, rows: torch.Tensor, rate: float) -> None:
        value, (first, second), count = self.values[name], self.moments[name], self.steps[name]
        assert value.grad is not None
        gradient = value.grad[rows]
        count[rows] += 1.0
        each = count[rows].reshape(-1, *(1 for _ in value.shape[1:]))
        for moment, beta, new in zip((first, second), BETAS, (gradient, gradient.square()), strict=True):
            moment[rows] = torch.lerp(new, moment[rows], beta)
        mean = first[rows] / (1.0 - BETAS[0] ** each)
        spread = (second[rows] / (1.0 - BETAS[1] ** each)).sqrt()
        value[rows] -= rate * mean / (spread + ADAM_EPSILON)

    @torch.no_grad()
    def project(self) -> None:
        """Into the gauge (see the module's text), weighing each photo by what it tells.

        Those that were not seen yet count as the mean of those that were: a slope over the few that are seen
        first would be carried on to all exposures.
        """
        gain, balance = self.values["log_gain"], self.values["log_balance"]
        is_seen = self.telling != UNSEEN
        mean = (self.telling * is_seen).sum() / is_seen.sum().clamp_min(1)
        telling = torch.where(is_seen, self.telling, mean)
        for rows, places in self._groups:
            there = self._at_places(telling)[places]
            found = _in_gauge(gain[rows, None], self.log_exposure[rows], telling[rows])[:, 0]
            gain[rows] = found.to(gain.dtype)
            found = _in_gauge(balance[places], self._log_exposure_there[places], there)
            balance[places] = found.to(balance.dtype)
        self.values["vignetting"].clamp_(min=0.0)

    # -- checkpoints -----------------------------------------------------------------------------------

    def tensors(self) -> dict[str, torch.Tensor]:
        known = self.lens_is_known
        named = {**self.values, "telling": self.telling, "reach": self.reach, "lens_is_known": known}
        for name in self.values:
            keys = (f"{name}.{key}" for key in ("exp_avg", "exp_avg_sq", "step"))
            named |= dict(zip(keys, (*self.moments[name], self.steps[name]), strict=True))
        return {name: tensor.detach() for name, tensor in named.items()}

    @torch.no_grad()
    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        for name, mine in self.tensors().items():
            mine.copy_(tensors[name])


#: Rows of a table.
Rows = slice | torch.Tensor


def _groups(
    of_photos: Sequence[str], of_places: Sequence[str], device: torch.device
) -> list[tuple[Rows, Rows]]:
    """The rows of each group, in photos and in places; all of them at once where there is one."""
    names = dict.fromkeys(of_places)
    if len(names) == 1:
        return [(slice(None), slice(None))]

    def rows(groups: Sequence[str], name: str) -> torch.Tensor:
        return torch.tensor([row for row, group in enumerate(groups) if group == name], device=device)

    return [(rows(of_photos, name), rows(of_places, name)) for name in names]


def _in_gauge(values: torch.Tensor, log_exposure: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """``values`` ``[P, C]`` without mean and, where exposures differ, without slope over them; float64."""
    weight, values = weight.double(), values.double()
    weight = weight / weight.sum().clamp_min(1e-9)
    values = values - weight @ values
    centred = log_exposure - weight @ log_exposure
    variance = weight @ centred.square()
    slope = (weight * centred) @ values / variance.clamp_min(ONE_EXPOSURE**2)
    return values - torch.where(variance > ONE_EXPOSURE**2, slope, 0.0) * centred[:, None]
