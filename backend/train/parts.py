# SPDX-License-Identifier: GPL-3.0-or-later
"""What takes part in a training beside the method and its optimiser: growth, gains of photos, poses.

A part is one file and one row of ``Trainer.parts``. It does nothing where it overrides nothing.
"""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import torch

from ..methods.base import Batch, Outcome
from ..scene.scene import View


class Shot(NamedTuple):
    """What an iteration looks at: ``indices`` are positions in the view's bracket."""

    view: View
    indices: tuple[int, ...]


class Part:
    """The hooks of an iteration, in their order, and those of a checkpoint."""

    #: What the names of its tensors in a checkpoint begin with, before a dot.
    name: ClassVar[str]

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
