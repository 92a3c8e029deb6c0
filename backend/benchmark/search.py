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
#: No step of the secant goes further than this: two measurements that are near each other say little.
FURTHEST = 4.0

TOO_SLOW = "so slow that {iterations} iterations are all that fit"


@dataclass(frozen=True)
class Measurement:
    """What a whole training cost: user and system time of its loop."""

    iterations: int
    cpu_seconds: float


def next_trial(seconds: float, known: Measurement | None, tried: Sequence[Measurement]) -> int | None:
    """The iterations to train next for a budget of ``seconds``; None if the last that was tried shall stand.

    ``known``: a run of the same method on the same scene, of any length; None asks for a pilot (it is what
    the next call gets as ``known``).
    """
    if not tried:
        return PILOT_ITERATIONS if known is None else _proportional(seconds, known)
    last = tried[-1]
    enough = abs(last.cpu_seconds / seconds - 1.0) <= TOLERANCE or len(tried) > CORRECTIONS
    if enough or last.iterations < PILOT_ITERATIONS:
        return None
    before = tried[-2] if len(tried) > 1 else known
    step = _secant(seconds, before, last) if before else _proportional(seconds, last)
    return step if step != last.iterations else None


def _proportional(seconds: float, known: Measurement) -> int:
    return max(1, math.floor(seconds * known.iterations / max(known.cpu_seconds, 1e-9)))


def _secant(seconds: float, before: Measurement, last: Measurement) -> int:
    """Where the line through two measurements meets ``seconds``, not further than ``FURTHEST`` times away."""
    proportional = _proportional(seconds, last)
    more = last.iterations - before.iterations
    slope = (last.cpu_seconds - before.cpu_seconds) / more if more else 0.0
    if slope <= 0.0:  # noise: the shorter run cost more
        return proportional
    wanted = last.iterations + (seconds - last.cpu_seconds) / slope
    return max(1, round(min(max(wanted, proportional / FURTHEST), proportional * FURTHEST)))


def note_on(iterations: int) -> str:
    """What the report has to say of a search's result; empty where there is nothing."""
    return TOO_SLOW.format(iterations=iterations) if iterations < PILOT_ITERATIONS else ""
