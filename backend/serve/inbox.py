# SPDX-License-Identifier: GPL-3.0-or-later
"""What clients ask of the engine: commands in order, and of each client the newest preview alone."""

import queue
import threading
from dataclasses import dataclass

from ...bridge.messages import PreviewRequest, Request


@dataclass(frozen=True)
class Command:
    """A request of the client ``client`` (its number), called ``name``; the reply carries ``id``."""

    client: int
    name: str
    id: int
    message: Request


@dataclass(frozen=True)
class Ending:
    """Save and end the process. ``reason`` is told to every client."""

    reason: str


@dataclass(frozen=True)
class Abandoned:
    """Whoever steered has gone, and had said that a training must then be saved and stopped."""


@dataclass(frozen=True)
class WantedPreview:
    """The newest preview that a client waits for."""

    client: int
    id: int
    request: PreviewRequest


Item = Command | Ending | Abandoned


class Inbox:
    """Filled by the server's thread and by signal handlers, emptied by the engine.

    A preview of a client is given out only when that client's last one is on its way: a client that does not
    read costs one picture of memory and no rendering.
    """

    def __init__(self) -> None:
        self._items: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._previews: dict[int, WantedPreview] = {}  # the client that has waited longest is first
        self._served: set[int] = set()  # clients whose last picture has not gone out
        self._woken = False

    def put(self, item: Item) -> None:
        """From any thread, and from a signal handler (a ``SimpleQueue`` takes no lock that could be held)."""
        self._items.put(item)

    def offer(self, wanted: WantedPreview) -> WantedPreview | None:
        """Ask for a preview; returns the request of the same client that it replaces."""
        with self._lock:
            replaced = self._previews.get(wanted.client)
            self._previews[wanted.client] = wanted
            self._wake()
        return replaced

    def take_preview(self) -> WantedPreview | None:
        """The next preview to render; its client gets no other one before ``sent``."""
        with self._lock:
            for client, wanted in self._previews.items():
                if client not in self._served:
                    del self._previews[client]
                    self._served.add(client)
                    if self._previews:
                        self._wake()  # others wait, too
                    return wanted
        return None

    def sent(self, client: int) -> None:
        """The client's picture (or an error in its place) is on its way."""
        with self._lock:
            self._served.discard(client)
            if client in self._previews:
                self._wake()

    def forget(self, client: int) -> None:
        """The client has left."""
        with self._lock:
            self._previews.pop(client, None)
            self._served.discard(client)

    def take(self) -> Item | None:
        """The next command, if one waits."""
        try:
            while True:
                item = self._items.get_nowait()
                if item is not None:
                    return item
                self._woken = False
        except queue.Empty:
            return None

    def wait(self, timeout: float) -> Item | None:
        """The next command; ``None`` after ``timeout`` seconds, or as soon as a preview is wanted."""
        try:
            item = self._items.get(timeout=timeout)
        except queue.Empty:
            return None
        if item is None:
            self._woken = False
        return item

    def _wake(self) -> None:
        if not self._woken:
            self._woken = True
            self._items.put(None)
