# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a training, and which of them an iteration sees."""

import math
from typing import NamedTuple

import numpy as np
import torch

from ...bridge.errors import DataMismatchError
from ..methods.base import Batch, Recording
from ..model.tone_mapper import Response
from ..scene.resident import Pictures
from ..scene.scene import View
from ..start.initialise import seen_points
from ..start.merged_brackets import MergedBrackets
from .half_size import halved
from .plan import Plan
from .targets import SsimTargets
from .views import STREAM_BATCH, STREAM_EXPOSURES, STREAM_VIEWS


class Shot(NamedTuple):
    """What an iteration looks at: ``indices`` are positions in the view's bracket."""

    view: View
    indices: tuple[int, ...]


class Data:
    """All that training may see, on ``device``: the ``Pool`` of every batch."""

    def __init__(self, plan: Plan, device: torch.device) -> None:
        self.plan = plan
        self.views, self.exposures = plan.seen.views, plan.seen.exposures
        self.targets = SsimTargets()
        #: Pictures with the light of their whole brackets; None where they stay as they were taken.
        self.merged = _merged(plan)
        self.pictures = Pictures(device)
        self.pictures.instead = None if self.merged is None else self.merged.codes

    def require_something_seen(self) -> None:
        """Raises ``DataMismatchError`` where masks or alpha hide all of all pictures: nothing is compared."""
        for view, indices in zip(self.views, self.exposures, strict=True):
            for k in indices:
                mask = self.pictures.mask(view, k)
                if mask is None or bool(mask.any()):
                    return
        raise DataMismatchError(
            f"{self.plan.seen.scene.root}: masks or alpha hide all pixels of all training pictures",
            "Masks are white where a picture is to be looked at, alpha is not 0 there; or remove them.",
        )

    def draw(self, iteration: int) -> Shot:
        """The view of an iteration (from 0), a shuffle of all views each epoch, and its pictures.

        One position in its bracket, drawn anew; with ``supervision`` "bracket" all that training may see.
        """
        config = self.plan.config
        epoch, position = divmod(iteration, len(self.views))
        order = np.random.default_rng([config.seed, STREAM_VIEWS, epoch]).permutation(len(self.views))
        index = int(order[position])
        if config.supervision == "bracket":
            return Shot(self.views[index], self.exposures[index])
        rng = np.random.default_rng([config.seed, STREAM_EXPOSURES, 1 << 32, iteration])
        return Shot(self.views[index], (int(rng.choice(self.exposures[index])),))

    def picture(self, view: View, k: int) -> torch.Tensor:
        """``[3, H, W]`` in [0, 1], on the device: what methods that sample all pictures ask for."""
        return self.pictures.get(view, k)

    def first_points(self, response: Response) -> np.ndarray:
        """``[P, 3]`` metres: what methods ask for that start elsewhere, but must know where the scene is."""
        points = self.plan.seen.scene.points
        if points is not None:
            return points.positions.astype(np.float64)
        return seen_points(self.views, self.exposures, response)

    def recording(self, view: View, k: int) -> Recording:
        """The picture at position ``k`` of the view's bracket, and how it was taken."""
        return Recording(
            exposure=view.exposures[k],
            encoding=view.encodings[k],
            picture=self.pictures.get(view, k),
            mask=self.pictures.mask(view, k),
        )

    def _levels(self, view: View) -> tuple[float, ...]:
        """Those of the view; NaN where they are learned, until the part that learns them has put them in."""
        if view.is_standard:
            return self.plan.seen.standard_levels
        return tuple(math.nan if level is None else level for level in view.lighting_levels)

    def batch(self, iteration: int) -> Batch:
        """What an iteration (from 0) sees."""
        config = self.plan.config
        view, indices = self.draw(iteration)
        camera, recordings = view.camera, [self.recording(view, k) for k in indices]
        is_half = iteration < config.half_size_until * config.iterations
        if is_half:
            camera, recordings = halved(camera, recordings)
        recordings = [
            self.targets.noted(view, k, recording, is_half)
            for k, recording in zip(indices, recordings, strict=True)
        ]
        return Batch(
            camera=camera,
            recordings=tuple(recordings),
            levels=self._levels(view),
            iteration=iteration,
            pool=self,
            seed=(config.seed, STREAM_BATCH, iteration),
            index=view.index,
            progress=iteration / config.iterations,
        )


def _merged(plan: Plan) -> MergedBrackets | None:
    """As the plan says; None where there is nothing to merge."""
    if plan.merges == "off":
        return None
    merged = MergedBrackets(plan.seen.views, plan.seen.exposures)
    is_wanted = plan.merges == "on" and merged.worst > 0.0  # 0: none has a bracket
    return merged if is_wanted or merged.worth_it else None
