# SPDX-License-Identifier: GPL-3.0-or-later
"""Which client is in control, and what happens to a training when none is left."""

import asyncio
from collections.abc import Iterable

from .inbox import Abandoned, Inbox

#: How long a training waits for a new controller, if the last one wanted it stopped.
ABANDONED_SECONDS = 5.0


class Control:
    """``controller``: the number of the client in control, 0 for none. Used on the server's thread only."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self.controller = 0
        self.stop_when_closed = False  # as set by the client in control
        self._abandoned: asyncio.TimerHandle | None = None

    def give_to(self, number: int) -> None:
        """Put a client in control, with default wishes."""
        self.controller, self.stop_when_closed = number, False
        if self._abandoned:
            self._abandoned.cancel()

    def pass_on(self, others: Iterable[int]) -> None:
        """The client in control has left: the first of ``others`` takes over."""
        if self.stop_when_closed:
            loop = asyncio.get_running_loop()
            self._abandoned = loop.call_later(ABANDONED_SECONDS, self._inbox.put, Abandoned())
        self.controller = 0
        for number in others:
            self.give_to(number)
            return
