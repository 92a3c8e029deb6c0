# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds a method's iterations for a budget of CPU seconds, from the cost of runs, not their quality.

Schedules scale with ``--iterations`` (densification stops at half of them), so a truncated run would be a
different method, and cost is nearly but not exactly linear in iterations. Therefore whole runs are measured.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: Without a completed run, a pilot of this many iterations is trained first and used for nothing else.
PILOT_ITERATIONS = 20
#: A run that costs less than the first share of the budget predicts little (a pilot is mostly start-up, and
#: has not grown): the next training is a scout, which should cost the second share, less than a miss would.
FAR, SCOUT = 1 / 20, 1 / 10
#: A run that misses the budget by more is corrected.
TOLERANCE = 0.05
#: The first correction is a secant through the known costs; a second one follows an imprecise scout.
CORRECTIONS = 2
#: Bounds of the secant's cost per iteration, as multiples of the average cost: start-up costs the same for
#: all lengths, densification makes later iterations more expensive, and close measurements differ by noise.
SLOPES = (0.75, 1.6)

TOO_SLOW = "so slow that {iterations} iterations are all that fit"


@dataclass(frozen=True)
class Measurement:
    """The cost of a whole training: user and system time of its loop."""

    iterations: int
    cpu_seconds: float


def next_trial(seconds: float, known: Measurement | None, tried: Sequence[Measurement]) -> int | None:
    """The iterations to train next for a budget of ``seconds``; None if a previous trial is good enough.

    ``known``: a run of the same method on the same scene, of any length; None requests a pilot (then passed
    as ``known``).
    """
    if known is None:
        return PILOT_ITERATIONS
    measured = [known, *tried]
    last, before = measured[-1], measured[-2] if tried else None
    scouts = sum(each.cpu_seconds < FAR * seconds for each in measured)
    if tried:
        enough = abs(last.cpu_seconds / seconds - 1.0) <= TOLERANCE or len(tried) > CORRECTIONS + scouts
        if enough or last.iterations < PILOT_ITERATIONS:
            return None
    step = _step(SCOUT * seconds if last.cpu_seconds < FAR * seconds else seconds, last, before)
    return None if step in [each.iterations for each in tried] else step


def nearest(seconds: float, tried: Sequence[Measurement]) -> Measurement:
    """The trial nearest to the budget, by ratio."""
    return min(tried, key=lambda each: abs(math.log(max(each.cpu_seconds, 1e-9) / seconds)))


def _step(seconds: float, last: Measurement, before: Measurement | None) -> int:
    """As many as fit, at least one, at the cost per iteration between ``before`` and ``last``."""
    average = max(last.cpu_seconds, 1e-9) / last.iterations
    slope = average
    if before and before.iterations != last.iterations:
        slope = (last.cpu_seconds - before.cpu_seconds) / (last.iterations - before.iterations)
        slope = min(max(slope, SLOPES[0] * average), SLOPES[1] * average)
    return max(1, math.floor(last.iterations + (seconds - last.cpu_seconds) / slope))


def note_on(iterations: int) -> str:
    """A note on a search's result for the report, or empty."""
    return TOO_SLOW.format(iterations=iterations) if iterations < PILOT_ITERATIONS else ""
