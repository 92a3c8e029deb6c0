# SPDX-License-Identifier: GPL-3.0-or-later
"""Clients' requests to the engine: commands in order, and only the newest preview of each client."""

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
    """Save and end the process. ``reason`` is sent to every client."""

    reason: str


@dataclass(frozen=True)
class Abandoned:
    """The client in control has left, and wanted the training to be saved and stopped then."""


@dataclass(frozen=True)
class WantedPreview:
    """The newest preview that a client waits for."""

    client: int
    id: int
    request: PreviewRequest


Item = Command | Ending | Abandoned


class Inbox:
    """Filled by the server's thread and by signal handlers, emptied by the engine.

    A client's preview is handed out only when its last one is being sent: a client that does not read costs
    the memory of one image and no rendering.
    """

    def __init__(self) -> None:
        self._items: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._previews: dict[int, WantedPreview] = {}  # the client that has waited longest is first
        self._served: set[int] = set()  # clients whose last image has not been sent
        self._woken = False

    def put(self, item: Item) -> None:
        """Usable from any thread and from signal handlers (a ``SimpleQueue`` takes no lock)."""
        self._items.put(item)

    def offer(self, wanted: WantedPreview) -> WantedPreview | None:
        """Request a preview; returns the request of the same client that it replaces."""
        with self._lock:
            replaced = self._previews.get(wanted.client)
            self._previews[wanted.client] = wanted
            self._wake()
        return replaced

    def take_preview(self) -> WantedPreview | None:
        """The next preview to render; its client gets no other before ``sent``."""
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
        """The client's image (or an error instead) is being sent."""
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
        """The next command, if there is one."""
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
