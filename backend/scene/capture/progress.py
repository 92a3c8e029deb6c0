# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a long work is, and how long it still takes: stages, each measured while it runs."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

#: Seconds between two reports of one stage.
SECONDS_BETWEEN = 0.5
#: A stage says how fast it is once it has done this share, or this long (seconds).
TRUSTED_SHARE, TRUSTED_SECONDS = 0.05, 3.0


@dataclass(frozen=True)
class Report:
    """``fraction``: 0…1, never falling. ``message``: what is done now. ``seconds_left``: None: not known."""

    fraction: float
    message: str
    seconds_left: float | None = None


class Stages:
    """Tells ``listener`` how far the work is.

    ``seconds``: what each stage is expected to take, in order. What a finished stage took beside what was
    expected corrects the stages to come; the one that runs is measured by its own share.
    """

    def __init__(
        self,
        seconds: Mapping[str, float],
        listener: Callable[[Report], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._expected = {name: max(each, 1e-3) for name, each in seconds.items()}
        self._listener, self._clock = listener, clock
        self._taken: dict[str, float] = {}
        self._stage, self._began, self._told = "", clock(), -1.0
        self._fraction = 0.0

    def begin(self, stage: str, message: str) -> None:
        """The stage before this one is done."""
        self._finish()
        self._stage, self._began, self._told = stage, self._clock(), -1.0
        self.at(0.0, message)

    def at(self, share: float, message: str) -> None:
        """``share``: 0…1 of the stage that was begun."""
        now = self._clock()
        if 0.0 < share < 1.0 and now - self._told < SECONDS_BETWEEN:
            return
        self._told = now
        left = self._left_of_stage(share, now - self._began) + self._left_of_others()
        gone = sum(self._taken.values()) + now - self._began
        self._fraction = max(self._fraction, min(gone / max(gone + left, 1e-9), 0.999))
        known = bool(self._taken) or share > 0.0
        self._listener(Report(round(self._fraction, 4), message, round(left, 1) if known else None))

    def _finish(self) -> None:
        if self._stage:
            self._taken[self._stage] = self._clock() - self._began

    def _left_of_stage(self, share: float, gone: float) -> float:
        expected = self._expected[self._stage] * self._slowness()
        if share >= TRUSTED_SHARE or (share > 0.0 and gone > TRUSTED_SECONDS):
            return gone * (1.0 - share) / share
        return max(expected - gone, 0.1 * expected)

    def _left_of_others(self) -> float:
        done = {*self._taken, self._stage}
        return self._slowness() * sum(each for name, each in self._expected.items() if name not in done)

    def _slowness(self) -> float:
        """How much longer than expected the stages took that are done."""
        expected = sum(self._expected[name] for name in self._taken)
        return sum(self._taken.values()) / expected if expected > 0.0 and self._taken else 1.0
