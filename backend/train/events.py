# SPDX-License-Identifier: GPL-3.0-or-later
"""What training tells: typed events. The command line, the log files and Blender all consume these."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Started:
    """Training begins, or goes on, at ``iteration``."""

    iteration: int
    iterations: int
    gaussians: int
    message: str = ""


@dataclass(frozen=True)
class Progress:
    """The state after ``iteration``. ``losses``: weighted terms, mean since the last event.

    ``monitor``: measurements on a fixed held-out view (dB, ratios), when one was due.
    """

    iteration: int
    iterations: int
    gaussians: int
    losses: dict[str, float]
    iterations_per_second: float
    seconds_left: float
    monitor: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Saved:
    """A checkpoint is on disk."""

    iteration: int
    path: str


@dataclass(frozen=True)
class Finished:
    """Training ended: by itself, or because somebody asked (``stopped``).

    ``seconds`` on the clock; ``cpu_seconds`` of all cores together, without the monitor's pictures. Both
    count the search for the first points. ``message``: what was found of the cameras, in words.
    """

    iteration: int
    seconds: float
    cpu_seconds: float
    stopped: bool
    message: str = ""


Event = Started | Progress | Saved | Finished
