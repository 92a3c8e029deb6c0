# SPDX-License-Identifier: GPL-3.0-or-later
"""How primitives are added and removed while a method trains: one contract, one strategy a backbone."""

from abc import abstractmethod

from ...bridge.errors import PhysHDRError
from ..methods.base import Batch, Drawn, Outcome
from ..scene.camera import Camera
from .parts import Part


class NoGaussiansLeftError(PhysHDRError):
    """Pruning would remove all there are."""


class Growth(Part):
    """A strategy with its statistics, bound to a method and its optimiser."""

    name = "statistics"

    @abstractmethod
    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        """Take in a view after the backward pass of ``iteration`` (counted from 0)."""

    @abstractmethod
    def control(self, iteration: int) -> None:
        """Grow and prune if it is due after ``iteration`` iterations (counted from 1)."""

    def after(self, outcome: Outcome, batch: Batch) -> None:
        if outcome.drawn is not None:
            self.observe(outcome.drawn, batch.camera, batch.iteration)

    def step(self, batch: Batch) -> None:
        self.control(batch.iteration + 1)
