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
#: What costs less than the first share of the budget says little of it (a pilot is all start, and has not
#: grown): the training after it is a scout, which is to cost the second share: little beside one that misses.
FAR, SCOUT = 1 / 20, 1 / 10
#: A run that misses the budget by more is corrected.
TOLERANCE = 0.05
#: The first correction is a secant through what is known; a second one is for what a scout could not tell.
CORRECTIONS = 2
#: What another iteration costs is that of the secant, but within these multiples of what one cost on average:
#: the start costs alike for all lengths, densification makes later iterations dearer, and two measurements
#: that are near each other differ by noise.
SLOPES = (0.75, 1.6)

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
    """The one that shall stand: nearest to the budget, by ratio."""
    return min(tried, key=lambda each: abs(math.log(max(each.cpu_seconds, 1e-9) / seconds)))


def _step(seconds: float, last: Measurement, before: Measurement | None) -> int:
    """As many as fit, at least one, if each more or less costs what it did from ``before`` to ``last``."""
    average = max(last.cpu_seconds, 1e-9) / last.iterations
    slope = average
    if before and before.iterations != last.iterations:
        slope = (last.cpu_seconds - before.cpu_seconds) / (last.iterations - before.iterations)
        slope = min(max(slope, SLOPES[0] * average), SLOPES[1] * average)
    return max(1, math.floor(last.iterations + (seconds - last.cpu_seconds) / slope))


def note_on(iterations: int) -> str:
    """What the report has to say of a search's result; empty where there is nothing."""
    return TOO_SLOW.format(iterations=iterations) if iterations < PILOT_ITERATIONS else ""
