# SPDX-License-Identifier: GPL-3.0-or-later
"""The iterations of a method for a budget of CPU seconds: from what runs cost, not from how good they are.

Schedules scale with ``--iterations`` (densification stops at half of them), so a run that is cut short would
be another method, and cost is nearly but not exactly linear in their number. So whole runs are measured.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: Without a completed run a pilot of this many iterations is trained first; it counts for nothing else.
PILOT_ITERATIONS = 20
#: A run that misses the budget by more is corrected.
TOLERANCE = 0.05
#: The first correction is a secant through what is known; a second one is for what a pilot could not tell.
CORRECTIONS = 2
#: Cost is taken to grow with the iterations to the power of the secant, but within these: densification makes
#: later iterations dearer, and two measurements that are near each other differ by noise.
EXPONENTS = (0.8, 1.6)

TOO_SLOW = "so slow that {iterations} iterations are all that fit"


@dataclass(frozen=True)
class Measurement:
    """What a whole training cost: user and system time of its loop."""

    iterations: int
    cpu_seconds: float


def next_trial(seconds: float, known: Measurement | None, tried: Sequence[Measurement]) -> int | None:
    """The iterations to train next for a budget of ``seconds``; None if one that was tried shall stand.

    ``known``: a run of the same method on the same scene, of any length; None asks for a pilot (it is what
    the next call gets as ``known``).
    """
    if not tried:
        return PILOT_ITERATIONS if known is None else _step(seconds, known, 1.0)
    last = tried[-1]
    enough = abs(last.cpu_seconds / seconds - 1.0) <= TOLERANCE or len(tried) > CORRECTIONS
    if enough or last.iterations < PILOT_ITERATIONS:
        return None
    before = tried[-2] if len(tried) > 1 else known
    step = _step(seconds, last, _exponent(before, last) if before else 1.0)
    return None if step in [each.iterations for each in tried] else step


def nearest(seconds: float, tried: Sequence[Measurement]) -> Measurement:
    """The one that shall stand: nearest to the budget, by ratio."""
    return min(tried, key=lambda each: abs(math.log(max(each.cpu_seconds, 1e-9) / seconds)))


def _step(seconds: float, known: Measurement, exponent: float) -> int:
    """As many as fit, at least one, if cost goes with the iterations to the power of ``exponent``."""
    share = seconds / max(known.cpu_seconds, 1e-9)
    return max(1, math.floor(known.iterations * share ** (1.0 / exponent)))


def _exponent(before: Measurement, last: Measurement) -> float:
    """The slope of the secant through two measurements, both axes logarithmic, within ``EXPONENTS``."""
    more = math.log(last.iterations / before.iterations)
    if more == 0.0:
        return 1.0
    dearer = math.log(max(last.cpu_seconds, 1e-9) / max(before.cpu_seconds, 1e-9))
    return min(max(dearer / more, EXPONENTS[0]), EXPONENTS[1])


def note_on(iterations: int) -> str:
    """What the report has to say of a search's result; empty where there is nothing."""
    return TOO_SLOW.format(iterations=iterations) if iterations < PILOT_ITERATIONS else ""
