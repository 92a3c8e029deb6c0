# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop, top to bottom: it yields events and knows nothing of who listens."""

import dataclasses
import math
import time
from collections.abc import Callable, Generator
from pathlib import Path

import torch

from ...bridge.run_folder import CHECKPOINT_FILE
from ..methods.base import Method
from ..rasterize.contract import CannotBeDrawnError
from .events import Event, Finished, Progress, Saved, Started
from .saver import CHECKPOINT_SECONDS, Saver
from .state import State

#: Measures a fixed held-out view; given the method, returns named numbers.
Monitor = Callable[[Method], dict[str, float]]


def step(state: State) -> dict[str, torch.Tensor]:
    """One iteration; returns the weighted loss terms (detached)."""
    batch = state.batch(state.iteration)
    state.follow_schedule()
    outcome = state.method.training_outcome(batch)
    added = {part.name: term for part in state.parts if (term := part.term(outcome)) is not None}
    terms = outcome.terms | added
    torch.stack(list(terms.values())).sum().backward()
    for part in state.parts:
        part.after(outcome, batch)
    state.is_sound = False
    state.optimiser.step(state.iteration)
    state.iteration += 1
    for part in state.parts:
        part.step(batch)
    state.is_sound = True
    return {name: term.detach() for name, term in terms.items()}


def run(
    state: State,
    folder: Path,
    *,
    should_stop: Callable[[], bool] = lambda: False,
    monitor: Monitor | None = None,
    progress_every: int = 20,
    monitor_every: int = 200,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    between: Callable[[], float] = lambda: 0.0,
) -> Generator[Event, None, None]:
    """Train until done or told to stop, yielding events; a checkpoint is written on every way out.

    And every ``checkpoint_seconds`` (``Saver``). ``between`` is called after every iteration, when the method
    is whole and may be looked at. It returns for how many seconds it held the training up (a pause), which
    then count in no rate. Raises ``OutputError`` where the run's folder is not there any more.
    """
    saver, total = Saver(folder, checkpoint_seconds), state.plan.iterations
    begun, begun_cpu = time.perf_counter() - state.seconds, time.process_time() - state.cpu_seconds
    message = ". ".join([f"started from {state.start_message}", *state.plan.seen.scene.messages])
    yield Started(state.iteration, total, state.method.size, message)
    recent = _Recent(state)
    try:
        while state.iteration < total and not should_stop():
            recent.add(_step(state))
            is_last = state.iteration == total
            if state.iteration % progress_every == 0 or is_last:
                progress, watching = recent.progress(), time.process_time()
                if monitor is not None and (state.iteration % monitor_every == 0 or is_last):
                    progress = dataclasses.replace(progress, monitor=monitor(state.method))
                begun_cpu += time.process_time() - watching  # training does not need it
                yield progress
                recent = _Recent(state)
            state.seconds, state.cpu_seconds = time.perf_counter() - begun, time.process_time() - begun_cpu
            if saver.is_due and not is_last:
                recent.refuse_nan()  # which would be noticed at the next event only
                yield saver.save(state)
            held = between()
            for clock in (recent, saver):
                clock.put_off(held)
            begun += held
    finally:
        # A diverged state, or one caught in the middle of an update, is worth less than the last file.
        if state.is_sound:
            saver.save(state)
    yield Saved(state.iteration, str(folder / CHECKPOINT_FILE))
    found = ". ".join(filter(None, (part.summary for part in state.parts)))
    yield Finished(state.iteration, state.seconds, state.cpu_seconds, state.iteration < total, found)


def _step(state: State) -> dict[str, torch.Tensor]:
    try:
        return step(state)
    except CannotBeDrawnError as error:  # which says where they are NaN
        raise state.diverged(str(error)) from error


class _Recent:
    """What the iterations since the last event came to."""

    def __init__(self, state: State) -> None:
        self._state, self._first, self._begun = state, state.iteration, time.perf_counter()
        self._sums: dict[str, torch.Tensor] = {}

    def add(self, terms: dict[str, torch.Tensor]) -> None:
        for name, value in terms.items():
            self._sums[name] = self._sums.get(name, 0.0) + value

    def put_off(self, seconds: float) -> None:
        """Count these seconds in no rate."""
        self._begun += seconds

    def refuse_nan(self) -> None:
        """Raises ``TrainingDivergedError`` where a term of the loss is no number."""
        for name, value in self._sums.items():
            if not math.isfinite(float(value)):
                raise self._state.diverged(f"the loss term '{name}' is not a number")

    def progress(self) -> Progress:
        """The event, without measurements; raises as ``refuse_nan``."""
        self.refuse_nan()
        done, total = self._state.iteration, self._state.plan.iterations
        count = done - self._first
        losses = {name: float(value) / count for name, value in self._sums.items()}
        rate = count / (time.perf_counter() - self._begun)
        return Progress(done, total, self._state.method.size, losses, rate, (total - done) / rate)
