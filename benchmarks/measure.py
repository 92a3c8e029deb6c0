# SPDX-License-Identifier: GPL-3.0-or-later
"""How times are taken, and what a row of the table is."""

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

Step = Callable[[], object]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table: what was measured, beside its alternative and its targets.

    ``value`` and ``plain`` (the plain-torch alternative, where there is one) are in ``unit``. Targets, where
    one was set (docs/performance.md): ``at_most`` and ``at_least`` bound the value, ``faster`` bounds
    plain/value from below.
    """

    work: str
    value: float
    unit: str = "ms"
    plain: float | None = None
    at_most: float | None = None
    at_least: float | None = None
    faster: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times faster than the alternative (rates: higher; the rest: lower)."""
        if self.plain is None:
            return None
        return self.value / self.plain if self.unit == "/s" else self.plain / self.value

    @property
    def targets(self) -> list[tuple[str, bool]]:
        """Each target in words and whether it is met."""
        found = []
        if self.at_most is not None:
            found.append((f"≤ {self.at_most:g} {self.unit}", self.value <= self.at_most))
        if self.at_least is not None:
            found.append((f"≥ {self.at_least:g} {self.unit}", self.value >= self.at_least))
        if self.faster is not None and self.ratio is not None:
            found.append((f"≥ {self.faster:g} ×", self.ratio >= self.faster))
        return found


def alternate(*steps: Step, rounds: int, repeats: Iterable[int] | None = None) -> list[float]:
    """Median milliseconds of each step, timed in turn, so that whatever else runs meanwhile hits all.

    One round that does not count comes first. ``repeats``: how often each step is timed within a round (a
    quick one needs more samples than a slow one, and its first may find the caches full of the other's).
    """
    counts = list(repeats) if repeats is not None else [1] * len(steps)
    times: list[list[float]] = [[] for _ in steps]
    for round_number in range(rounds + 1):
        for step, count, mine in zip(steps, counts, times, strict=True):
            for _ in range(count if round_number else 1):
                start = time.perf_counter()
                step()
                if round_number:
                    mine.append(1e3 * (time.perf_counter() - start))
    return [statistics.median(t) for t in times]
