# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a training will take, from a few iterations that are timed before it starts.

They are done on a copy of everything that an iteration changes, at half and at full size, with as many
Gaussians as there are at first and as many as there will be in the end, and thrown away. An iteration costs
c + g · (Gaussians) at either size; growth is taken to be even. docs/performance.md says how far this is
right.
"""

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import accumulate

import torch

from ...simd import give_back_freed_memory
from ..growing import Growing
from ..state import State
from ..trainer import step
from .course import Course, course_of

#: Of each size and number of Gaussians so many iterations are timed, after one that is not.
TIMED = 3
#: The timing may take this share of the training; where iterations are too few for that, nothing is timed.
SHARE = 0.02
#: Checkpoints (2 % at most), the monitor's view, logs.
BESIDE = 1.03


@dataclass(frozen=True)
class Cost:
    """Seconds of an iteration: ``constant`` and ``each`` Gaussian."""

    constant: float
    each: float = 0.0

    def at(self, count: float) -> float:
        return self.constant + self.each * count


class Duration:
    """How long a training takes as a whole and from any iteration on. ``begun``: the iteration it starts at.

    ``decoding``: seconds until all pictures have been decoded once.
    """

    def __init__(self, course: Course, half: Cost, full: Cost, begun: int = 0, decoding: float = 0.0) -> None:
        sizes = [half] * course.half_until + [full] * (course.iterations - course.half_until)
        each = [BESIDE * cost.at(course.count_at(i)) for i, cost in enumerate(sizes)]
        self._left = [*accumulate(reversed(each), initial=0.0)][::-1]  # of all iterations from i on
        self._each = each
        self.seconds = self._left[min(begun, course.iterations)] + decoding

    def left(self, iteration: int, rate: float) -> float:
        """Seconds from ``iteration`` to the end, where iterations go by at ``rate`` a second just now."""
        if iteration >= len(self._each) or not rate > 0.0:
            return 0.0
        before = max(iteration - 1, 0)  # the rate is of what has been done
        return self._left[iteration] / (rate * self._each[before])

    def __str__(self) -> str:
        """``about 37 minutes``."""
        return about(self.seconds)


def about(seconds: float) -> str:
    """``about 40 seconds``, ``about 12 minutes``, ``about 2 h 10 min``: no more digits than can be known."""
    if seconds < 90.0:
        return f"about {max(5, 5 * round(seconds / 5))} seconds"
    minutes = round(seconds / 60.0)
    if minutes < 90:
        return f"about {minutes} minutes"
    minutes = 10 * round(seconds / 600.0)
    return f"about {minutes // 60} h {minutes % 60:02d} min"


def time_training(
    state: State,
    clock: Callable[[], float] = time.perf_counter,
    between: Callable[[], object] = lambda: None,
) -> Duration | None:
    """How long ``state`` will take from where it is; nothing of it changes, not even a random number.

    None where timing would take more than ``SHARE`` of it, because it is short. ``between``: called before
    each iteration that is timed; what it raises ends the timing.
    """
    begun = state.iteration
    course = course_from(state)
    sides = [False] if begun >= course.half_until else [True, False]
    counts = [len(state.method.backbone)]
    if course.most > counts[0]:
        counts.append(course.most)
    # All are told as if they cost the mean of what is to come, which they do.
    if len(sides) * len(counts) * (TIMED + 1) > SHARE * (course.iterations - begun):
        return None
    with torch.random.fork_rng(devices=[state.device] if state.device.type == "cuda" else []):
        decoding, half, full = _timed(_copy(state), course, sides, counts, clock, between)
    give_back_freed_memory()  # the copy, which was as large as the training will be
    return Duration(course, half, full, begun, decoding)


def course_from(state: State) -> Course:
    """The course from where ``state`` is, in primitives of its backbone."""
    course, now = course_of(state.plan), len(state.method.backbone)
    # Estimates of the first points are their most, and a search has found fewer by now.
    each = state.method.size // max(now, 1)  # Gaussians of a primitive
    most = now if course.most == course.first else max(now, course.most // each)
    return replace(course, first=now, most=most, grows_from=max(course.grows_from, state.iteration))


# -- timing --------------------------------------------------------------------------------------------------


def _copy(state: State) -> State:
    """A state of its own that shares what never changes: pictures, cameras, the plan."""
    shared = [state.plan, state.data, *state.views]
    result = copy.deepcopy(state, {id(each): each for each in shared})
    # How many Gaussians there are is set here.
    result.parts = tuple(part for part in result.parts if not isinstance(part, Growing))
    return result


def _timed(
    trial: State,
    course: Course,
    sides: list[bool],
    counts: list[int],
    clock: Callable[[], float],
    between: Callable[[], object],
) -> tuple[float, Cost, Cost]:
    """Seconds of decoding all pictures, and what an iteration costs at half and at full size."""
    decoding, decoded = 0.0, set()
    seconds: dict[tuple[bool, int], float] = {}
    for count in counts:
        if count != len(trial.method.backbone):
            _grow(trial, count)
        for half in sides:
            total = 0.0
            for turn in range(TIMED + 1):
                between()
                trial.iteration = _iteration(course, half, turn, late=count == counts[-1])
                begun = clock()
                trial.batch(trial.iteration)  # so that no step waits for a picture to be decoded
                view = trial.draw(trial.iteration)[0].name
                if view not in decoded:
                    decoded.add(view)
                    decoding += clock() - begun
                begun = clock()
                step(trial)
                if trial.device.type == "cuda":
                    torch.cuda.synchronize(trial.device)
                total += (clock() - begun) if turn else 0.0
            seconds[half, count] = total / TIMED
    costs = {half: _line([(count, seconds[half, count]) for count in counts]) for half in sides}
    each = decoding / max(len(decoded), 1)
    return each * len(trial.views), costs.get(True, costs[False]), costs[False]


def _line(points: list[tuple[int, float]]) -> Cost:
    """The straight line through one or two measurements (Gaussians, seconds), nowhere falling."""
    (first, low), (last, high) = points[0], points[-1]
    if last == first or high <= low:
        return Cost(max(low, high))
    each = (high - low) / (last - first)
    return Cost(low - each * first, each)


def _iteration(course: Course, half: bool, turn: int, *, late: bool) -> int:
    """An iteration of this size, near the end of those where the spherical harmonics are whole."""
    first, last = (0, course.half_until) if half else (course.half_until, course.iterations)
    if late:
        return max(last - (TIMED + 1) + turn, first)
    return min(first + turn, last - 1)


@torch.no_grad()
def _grow(trial: State, count: int) -> None:
    """Make it ``count`` primitives by splitting each into as many, as growth would."""
    method = trial.method
    backbone = method.backbone
    now = len(backbone)
    source = torch.div(torch.arange(count, device=method.device) * now, count, rounding_mode="floor")
    trial.optimiser.resample(backbone, source, torch.ones(count, dtype=torch.bool, device=method.device))
    backbone.scatter(count / now, torch.Generator().manual_seed(0))
