# SPDX-License-Identifier: GPL-3.0-or-later
"""Growth as a part of a training: the strategy of its backbone, called in every iteration."""

from collections.abc import Mapping
from typing import Self

import torch

from ..methods.base import Batch, Outcome
from .backbones import BACKBONES
from .growth import Growth
from .plan import Plan
from .state import Part, State
from .views import STREAM_GROWTH


class Growing(Part):
    """``growth``: what adds and removes primitives."""

    name = "statistics"

    def __init__(self, growth: Growth) -> None:
        self.growth = growth

    @classmethod
    def is_wanted(cls, plan: Plan) -> bool:
        return plan.splats

    @classmethod
    def new(cls, state: State) -> Self:
        plan = state.plan
        return cls(
            BACKBONES[plan.backbone.name].growth(
                state.method,
                state.optimiser,
                plan.backbone,
                plan.iterations,
                seed=(plan.config.seed, STREAM_GROWTH),
                cameras=[view.camera for view in state.views],
                clearance=state.clearance,
            )
        )

    def after(self, outcome: Outcome, batch: Batch) -> None:
        if outcome.drawn is not None:
            self.growth.observe(outcome.drawn, batch.camera, batch.iteration)

    def step(self, batch: Batch) -> None:
        self.growth.control(batch.iteration + 1)

    def tensors(self) -> dict[str, torch.Tensor]:
        return self.growth.tensors()

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        self.growth.restore(tensors)
