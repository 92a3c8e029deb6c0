# SPDX-License-Identifier: GPL-3.0-or-later
"""A running training: its status, and requests handled between its iterations."""

import time
from contextlib import closing
from typing import Any, Protocol

from ..runs.log import LOG_FILE, EventLog
from ..runs.monitor import view_monitor
from ..runs.run import Run, as_learned
from ..runs.tidy import Tidying
from ..train import events
from ..train.forecast.duration import Duration
from ..train.state import State
from ..train.trainer import run as train
from .curves import Curves, Speed
from .status import Status, device_words, finite

#: Seconds between two statuses while a training runs; changes of state are sent at once.
STATUS_SECONDS = 0.25
#: Iterations between two measurements of how bright radiance is on a display.
SCALE_ITERATIONS = 50


class Desk(Protocol):
    """The engine, as a training sees it."""

    @property
    def stopping(self) -> bool:
        """Whether the training should end."""
        ...

    def look(self) -> None:
        """Handle all waiting requests."""
        ...

    def wait(self) -> None:
        """Handle the next request; returns after a while if there is none."""
        ...


class Training:
    """``run_to_the_end`` trains; the other methods are called from within it, through ``desk``.

    ``expected``: how long it will take, if known.
    """

    def __init__(
        self,
        state: State,
        run: Run,
        desk: Desk,
        status: Status,
        curves: Curves,
        expected: Duration | None = None,
    ) -> None:
        self._state, self._run, self._expected = state, run, expected
        self._desk, self._status, self._curves = desk, status, curves
        self._speed, self._tidying = Speed(), Tidying(state)
        self._paused = False
        self._found = ""  # of the cameras, known at the end
        self._scale, self._scale_from = 1.0, -SCALE_ITERATIONS  # and its iteration
        self._next_status = 0.0

    @property
    def iteration(self) -> int:
        """The iteration reached."""
        return self._state.iteration

    @property
    def run(self) -> Run:
        """The run as it is now."""
        return as_learned(self._run, self._state)

    @property
    def radiance_scale(self) -> float:
        """``Run.radiance_scale`` of some iterations ago: it changes slowly, and costs rendering an image."""
        if self.iteration >= self._scale_from + SCALE_ITERATIONS:
            self._scale, self._scale_from = self.run.radiance_scale, self.iteration
        return self._scale

    def pause(self, paused: bool) -> None:
        """Pause after this iteration, or continue."""
        self._paused = paused
        self._speed.clear()
        self._status.change(
            state="paused" if paused else "training",
            iteration=self.iteration,
            gaussians=self._state.method.size,
            iterations_per_second=0.0,
        )

    def run_to_the_end(self, paused: bool = False) -> Run:
        """Train until the last iteration or a stop; returns the run as it is then.

        ``paused``: pause after the first iteration.
        """
        state, run = self._state, self._run
        self._curves.read(run.folder / LOG_FILE, run.iteration)
        message = state.start_message
        if self._expected is not None:
            message = f"{message}; {self._expected} {'to go' if state.iteration else 'in all'}"
        self._status.change(
            state="training",
            message=message,
            seconds_left=0.0 if self._expected is None else self._expected.seconds,
            data=str(run.scene.root),
            preset=run.preset,
            device=device_words(state.device),
            iteration=state.iteration,
            iterations=run.config.iterations,
            gaussians=run.method.size,
            saved_iteration=run.iteration,
            has_model=True,
            can_relight=run.method.can_relight,
            lights=run.method.lights,
            standard_levels=run.method.standard_levels,
            photographed_ev=run.photographed_ev,
        )
        if paused:
            self.pause(True)
        emitted = train(
            state,
            run.folder,
            should_stop=lambda: self._desk.stopping,
            monitor=view_monitor(run.scene),
            between=self._between_iterations,
        )
        # Closing saves, and must be able to log failures.
        with EventLog(run.folder) as event_log, closing(emitted):
            for event in emitted:
                event_log.show(event)
                self._note(event)
        stopped = state.iteration < run.config.iterations
        ended = f"{'stopped' if stopped else 'finished'} at iteration {state.iteration}"
        self._status.change(
            state="stopped" if stopped else "finished",
            message="; ".join(part for part in (ended, self._found) if part),
            iteration=state.iteration,
            gaussians=run.method.size,
            iterations_per_second=0.0,
            seconds_left=0.0,
        )
        return self.run

    def _between_iterations(self) -> float:
        """Handle requests; returns the seconds of a pause."""
        self._tidying()
        self._desk.look()
        held = 0.0
        if self._paused and not self._desk.stopping:
            begun = time.perf_counter()
            while self._paused and not self._desk.stopping:
                self._desk.wait()
            held = time.perf_counter() - begun
        now = time.monotonic()
        if now >= self._next_status and self._status.now.state == "training":
            self._next_status = now + STATUS_SECONDS
            self._status.change(**self._pace(now))
        return held

    def _pace(self, now: float) -> dict[str, Any]:
        iteration = self.iteration
        rate = self._speed.note(now, iteration)
        return {
            "iteration": iteration,
            "gaussians": self._state.method.size,
            "iterations_per_second": rate,
            "seconds_left": self._left(iteration, rate),
        }

    def _left(self, iteration: int, rate: float) -> float:
        """Seconds; the last value until there is a rate."""
        if not rate:
            return self._status.now.seconds_left
        if self._expected is not None:
            return self._expected.left(iteration, rate)
        return (self._run.config.iterations - iteration) / rate

    def _note(self, event: events.Event) -> None:
        if isinstance(event, events.Progress):
            losses, monitor = finite(event.losses), finite(event.monitor)
            self._curves.add(event.iteration, losses, monitor)
            self._status.note(losses=losses, monitor=self._status.now.monitor | monitor)
        elif isinstance(event, events.Saved):
            self._status.change(saved_iteration=event.iteration)
        elif isinstance(event, events.Finished):
            self._found = event.message
