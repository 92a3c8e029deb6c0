# SPDX-License-Identifier: GPL-3.0-or-later
"""The curves of a job, and its current speed."""

import json
import math
import threading
from collections import deque
from pathlib import Path
from typing import Any

from ...bridge.errors import PhysHDRError
from ...bridge.messages import History
from ...bridge.regular import regular_file

#: Plots have no more pixels than this.
POINTS_MAX = 4000
#: The rate is averaged over this many seconds.
RATE_SECONDS = 5.0


class Series:
    """A curve of any length in at most ``POINTS_MAX`` points, evenly thinned, and its newest point."""

    def __init__(self) -> None:
        self._kept: list[tuple[int, float]] = []
        self._newest: list[tuple[int, float]] = []
        self._seen, self._stride = 0, 1

    def add(self, iteration: int, value: float) -> None:
        if self._seen % self._stride == 0:
            self._kept.append((iteration, value))
            if len(self._kept) >= POINTS_MAX:
                self._kept = self._kept[::2]
                self._stride *= 2
        self._seen += 1
        self._newest = [(iteration, value)]

    @property
    def points(self) -> list[tuple[int, float]]:
        return self._kept if self._kept[-1:] == self._newest else self._kept + self._newest


class Curves:
    """Loss and PSNR over the iterations; written by the engine, read by the server's thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.clear()

    def clear(self) -> None:
        with self._lock:
            self._losses, self._psnr = Series(), Series()

    def add(self, iteration: int, losses: dict[str, float], monitor: dict[str, float]) -> None:
        """Add the values of a progress event."""
        with self._lock:
            loss = sum(losses.values(), 0.0)
            if math.isfinite(loss):
                self._losses.add(iteration, loss)
            if math.isfinite(monitor.get("PSNR", math.inf)):
                self._psnr.add(iteration, monitor["PSNR"])

    def read(self, log: Path, until: int) -> None:
        """The curves of an earlier part of the run, from its ``log.jsonl``, up to iteration ``until``.

        A run that was killed has logged steps that its checkpoint does not have; a line may be cut short.
        """
        self.clear()
        last = 0
        try:
            with open(regular_file(log), encoding="utf-8", errors="replace") as lines:
                for line in lines:
                    event = _progress(line)
                    # Repeated iterations are taken from the first time: on the CPU they are bit-identical.
                    if event and last < event[0] <= until:
                        last = event[0]
                        self.add(*event)
        except (OSError, PhysHDRError):
            pass  # no log, no curves

    def history(self) -> History:
        with self._lock:
            losses, psnr = self._losses.points, self._psnr.points
        return History(
            iterations=tuple(i for i, _ in losses),
            losses=tuple(value for _, value in losses),
            psnr_iterations=tuple(i for i, _ in psnr),
            psnr=tuple(value for _, value in psnr),
        )


def _progress(line: str) -> tuple[int, dict[str, float], dict[str, float]] | None:
    """Iteration, losses and monitor of a progress event; None for others and for unreadable lines."""
    if '"progress"' not in line:  # a log of empty lines would take 5 s per megabyte
        return None
    try:
        match json.loads(line):
            case {"event": "progress", "iteration": int(iteration), "losses": {**losses}, **rest}:
                return iteration, _floats(losses), _floats(dict(rest.get("monitor", {})))
    except (ValueError, TypeError, OverflowError, RecursionError):
        pass  # a damaged line must not prevent opening a run
    return None


def _floats(named: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in named.items()}


class Speed:
    """Iterations per second over the last few seconds, without pauses."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int]] = deque()

    def clear(self) -> None:
        self._points.clear()

    def note(self, now: float, iteration: int) -> float:
        """Record the time (seconds) and the iteration reached; returns the rate, 0 if not yet known."""
        self._points.append((now, iteration))
        while len(self._points) > 2 and self._points[0][0] < now - RATE_SECONDS:
            self._points.popleft()
        (first, start), (last, end) = self._points[0], self._points[-1]
        return (end - start) / (last - first) if last > first else 0.0
