# SPDX-License-Identifier: GPL-3.0-or-later
"""A training under way, and what takes part in it beside the method and its optimiser.

A part (growth, gains of photos, poses) is one file and one row of ``begin.PARTS``. It does nothing where
it overrides nothing.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Self, TypeVar

import torch

from ...bridge.errors import PhysHDRError
from ..methods.base import Batch, Method, Outcome
from ..scene.scene import View
from .config import TrainConfig
from .data import Data, Shot
from .optimisers import Optimiser
from .plan import Plan


class TrainingDivergedError(PhysHDRError):
    """The loss is no longer a number."""


class Part:
    """Whether it takes part, the hooks of an iteration in their order, and those of a checkpoint."""

    #: What the names of its tensors in a checkpoint begin with, before a dot.
    name: ClassVar[str]

    @classmethod
    @abstractmethod
    def is_wanted(cls, plan: Plan) -> bool:
        """Whether a training of ``plan`` has it; raises ``BadValueError`` where it is set, but cannot be."""

    @classmethod
    @abstractmethod
    def new(cls, state: "State") -> Self:
        """The part of ``state``, once its primitives are there (``Nuisances`` help to place them)."""

    def before(self, batch: Batch, shot: Shot) -> Batch:
        """Change what is compared."""
        return batch

    def term(self, outcome: Outcome) -> torch.Tensor | None:
        """Its weighted term of the loss, if it has one. Gradients that ``after`` reads are retained here."""
        return None

    def after(self, outcome: Outcome, batch: Batch) -> None:
        """Read the gradients, which are there now."""

    def step(self, batch: Batch) -> None:
        """Learn, once the optimiser has stepped."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """Everything that resuming needs, by name."""
        return {}

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Take back what ``tensors`` gave."""

    @property
    def summary(self) -> str:
        """What it has found, for people, at the end of a training."""
        return ""


P = TypeVar("P", bound=Part)


@dataclass(eq=False)
class State:
    """All that training changes, and what it works on. ``begin`` and ``resume`` make it."""

    plan: Plan
    data: Data
    method: Method
    device: torch.device
    #: The fingerprint of the run's ``config.json``.
    configuration: str
    #: Made once the primitives are there.
    optimiser: Optimiser = field(init=False)
    parts: tuple[Part, ...] = ()
    #: Before these depths of the views (metres, ``[V]``) nothing was photographed; None: nobody asks.
    clearance: torch.Tensor | None = None
    #: Where it has started from, in words.
    start_message: str = "random networks"
    #: SHA-256 of the run's views.json, which its checkpoints belong to; empty: there is none.
    views_digest: str = ""
    iteration: int = 0
    #: What training took so far, the search for the first points included, in all its parts.
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    #: Whether this is a state that a checkpoint may hold.
    is_sound: bool = True

    @property
    def config(self) -> TrainConfig:
        """What decides the training's result."""
        return self.plan.config

    @property
    def views(self) -> list[View]:
        """Those that it learns from."""
        return self.data.views

    def draw(self, iteration: int) -> Shot:
        """What an iteration (from 0) looks at."""
        return self.data.draw(iteration)

    def batch(self, iteration: int) -> Batch:
        """What an iteration (from 0) sees, as the parts have it."""
        batch, shot = self.data.batch(iteration), self.draw(iteration)
        for part in self.parts:
            batch = part.before(batch, shot)
        return batch

    def part(self, kind: type[P]) -> P | None:
        """The part of this kind, where it takes part."""
        return next((part for part in self.parts if isinstance(part, kind)), None)

    def follow_schedule(self) -> None:
        """Have the method set what depends on the iteration alone."""
        self.method.follow_schedule(self.iteration, self.plan.iterations, self.plan.sh_degree_every)

    def diverged(self, what: str) -> TrainingDivergedError:
        """The error to raise; no checkpoint holds this state any more."""
        self.is_sound = False
        return TrainingDivergedError(
            f"training diverged at iteration {self.iteration}: {what}",
            "Lower the learning rates, or report this with the run's config.json. "
            "The last good checkpoint is untouched.",
        )
