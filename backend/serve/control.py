# SPDX-License-Identifier: GPL-3.0-or-later
"""Who steers: one client at a time, and what becomes of a training when nobody is left who does."""

import asyncio
from collections.abc import Iterable

from .inbox import Abandoned, Inbox

#: How long a training waits for somebody in control, where the last one wished it stopped.
ABANDONED_SECONDS = 5.0


class Control:
    """``controller``: the number of the client in control, 0 for none. Only on the server's thread."""

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self.controller = 0
        self.stop_when_closed = False  # as the client in control wishes
        self._abandoned: asyncio.TimerHandle | None = None

    def give_to(self, number: int) -> None:
        """That client is in control from now on, and has wished nothing yet."""
        self.controller, self.stop_when_closed = number, False
        if self._abandoned:
            self._abandoned.cancel()

    def pass_on(self, others: Iterable[int]) -> None:
        """The client in control has left: whoever of ``others`` is first takes over."""
        if self.stop_when_closed:
            loop = asyncio.get_running_loop()
            self._abandoned = loop.call_later(ABANDONED_SECONDS, self._inbox.put, Abandoned())
        self.controller = 0
        for number in others:
            self.give_to(number)
            return
