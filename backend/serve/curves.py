# SPDX-License-Identifier: GPL-3.0-or-later
"""The curves of a job, and how fast it goes at the moment."""

import json
import threading
from collections import deque
from pathlib import Path
from typing import Any

from ...bridge.messages import History

#: Every second point is dropped beyond so many: a plot has no more pixels.
POINTS_MAX = 4000
#: The rate is that of the last so many seconds.
RATE_SECONDS = 5.0


class Curves:
    """Loss and PSNR over the iterations; written by the engine, read by the server's thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.clear()

    def clear(self) -> None:
        with self._lock:
            self._losses: list[tuple[int, float]] = []
            self._psnr: list[tuple[int, float]] = []

    def add(self, iteration: int, losses: dict[str, float], monitor: dict[str, float]) -> None:
        """Take what a progress event tells."""
        with self._lock:
            self._losses.append((iteration, sum(losses.values())))
            if "PSNR" in monitor:
                self._psnr.append((iteration, monitor["PSNR"]))
            for points in (self._losses, self._psnr):
                if len(points) > POINTS_MAX:
                    del points[:-1:2]  # the newest stays

    def read(self, log: Path, until: int) -> None:
        """The curves of an earlier part of the run, from its ``log.jsonl``, up to iteration ``until``.

        A run that was killed has logged steps that its checkpoint does not have; a line may be cut short.
        """
        self.clear()
        try:
            lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return  # no log, no curves: nothing else depends on it
        last = 0
        for line in lines:
            event = _progress(line)
            # What was done twice is taken from the first time: it was the same, on the CPU to the bit.
            if event and last < event["iteration"] <= until:
                last = event["iteration"]
                self.add(last, event["losses"], event.get("monitor", {}))

    def history(self) -> History:
        with self._lock:
            losses, psnr = tuple(self._losses), tuple(self._psnr)
        return History(
            iterations=tuple(i for i, _ in losses),
            losses=tuple(value for _, value in losses),
            psnr_iterations=tuple(i for i, _ in psnr),
            psnr=tuple(value for _, value in psnr),
        )


def _progress(line: str) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
        if event["event"] == "progress":
            float(sum(event["losses"].values()))
            return event if type(event["iteration"]) is int else None
    except (ValueError, KeyError, TypeError, AttributeError):
        pass  # a damaged line is no reason not to open a run
    return None


class Speed:
    """Iterations per second over the last few seconds, pauses left out."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int]] = deque()

    def clear(self) -> None:
        self._points.clear()

    def note(self, now: float, iteration: int) -> float:
        """Take the time (seconds) and the iteration reached; returns the rate, 0 where not yet known."""
        self._points.append((now, iteration))
        while len(self._points) > 2 and self._points[0][0] < now - RATE_SECONDS:
            self._points.popleft()
        (first, start), (last, end) = self._points[0], self._points[-1]
        return (end - start) / (last - first) if last > first else 0.0
