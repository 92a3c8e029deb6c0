# SPDX-License-Identifier: GPL-3.0-or-later
"""How a learning rate goes over a training: a function of progress alone, so that runs can be resumed."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ...bridge.errors import BadValueError
from ..shell import option

#: The power by which a rate falls (lab/notebook.md).
FALL = 3


def require_rates(part: str, rates: Mapping[str, float]) -> None:
    """Raises ``BadValueError`` for a rate below 0; its setting is called ``part.name``."""
    for name, value in rates.items():
        if not value >= 0.0:
            raise BadValueError(f"{option(f'{part}.{name}')} must be 0 or more, got {value}")


@dataclass(frozen=True, kw_only=True)
class Rate:
    """``start`` to ``final`` exponentially, or to zero by a cosine, or constant."""

    start: float
    final: float = 0.0
    shape: Literal["constant", "exponential", "cosine"] = "constant"
    #: Beyond this progress it falls, besides, by (falls_from / progress)³.
    falls_from: float = 1.0
    #: Multiplied by the scene's extent (3DGS: positions).
    of_extent: bool = False

    def times(self, factor: float) -> "Rate":
        """The same course, ``factor`` times as high."""
        return dataclasses.replace(self, start=factor * self.start, final=factor * self.final)

    def at(self, progress: float, extent: float) -> float:
        """The rate at ``progress`` (0 … 1)."""
        rate = self.start
        if self.shape == "exponential" and rate:
            rate *= (self.final / self.start) ** progress
        elif self.shape == "cosine":
            rate *= 0.5 * (1.0 + math.cos(math.pi * progress))
        if progress > self.falls_from:
            rate *= (self.falls_from / progress) ** FALL
        return rate * extent if self.of_extent else rate
