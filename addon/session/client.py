# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection to the backend, on threads of its own: the interface only puts in and takes out. No bpy."""

import itertools
import logging
import queue
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect

from ...bridge.connection import Connection
from ...bridge.messages import (
    BINARY_BYTES_MAX,
    HEARTBEAT_SECONDS,
    HEARTBEAT_TIMEOUT_SECONDS,
    PROTOCOL_VERSION,
    Envelope,
    Failure,
    Hello,
    PreviewFrame,
    PreviewRequest,
    ProtocolError,
    Request,
    Welcome,
    decode,
    decode_frame,
    encode,
)
from .state import Connected, LinkLost, Received, Refused

Item = TypeVar("Item")

#: A broken connection is reported to the user as an event; tracebacks in Blender's terminal help nobody.
_silent = logging.getLogger(f"{__name__}.connection")
_silent.addHandler(logging.NullHandler())
_silent.propagate = False

#: A backend on this machine answers at once, unless it is still loading its libraries.
OPEN_SECONDS = 5.0
#: Requests that may wait to be sent: a stalled backend must not fill the memory.
OUTBOX_MAX = 64


@dataclass(frozen=True)
class PreviewRefused:
    """A preview that will not come."""

    request: PreviewRequest
    failure: Failure


class HelloRefusedError(Exception):
    """The backend takes no connection from this client: ``failure`` says why."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


ClientEvent = Connected | LinkLost | Received | Refused


class Client:
    """One connection. ``take`` gives what has come since; nothing here ever waits for the network."""

    def __init__(self, connection: Connection, name: str, version: str) -> None:
        self._connection = connection
        self._hello = Hello(protocol=PROTOCOL_VERSION, client=name, version=version)
        self._events: queue.SimpleQueue[ClientEvent] = queue.SimpleQueue()
        self._previews: queue.SimpleQueue[PreviewFrame | PreviewRefused] = queue.SimpleQueue()
        self._outbox: queue.Queue[str | None] = queue.Queue(OUTBOX_MAX)
        self._ids = itertools.count(1)
        self._open: dict[int, Request] = {}  # asked and not yet answered
        self._socket: ClientConnection | None = None
        self._closing = threading.Event()
        threading.Thread(target=self._receive, name="physhdr receive", daemon=True).start()

    def send(self, request: Request) -> None:
        """Put a request out; its answer comes through ``take``."""
        try:
            self._outbox.put_nowait(self._envelope(request))
        except queue.Full:
            failure = Failure(code="stalled", message="the backend does not take requests", hint="Wait.")
            self._refuse(request, failure)

    def take(self) -> list[ClientEvent]:
        """What has happened since the last call, in order."""
        return list(_drained(self._events))

    def take_preview(self) -> PreviewFrame | PreviewRefused | None:
        """The newest preview, or its refusal, since the last call; older ones are dropped."""
        return next(reversed(_drained(self._previews)), None)

    def close(self) -> None:
        """Say good-bye, without waiting for the answer."""
        self._closing.set()
        with suppress(queue.Full):
            self._outbox.put_nowait(None)
        threading.Thread(target=self._close, name="physhdr close", daemon=True).start()

    def _envelope(self, request: Request) -> str:
        number = next(self._ids)
        self._open[number] = request
        return encode(Envelope("request", number, request))

    # -- threads -----------------------------------------------------------------------------------------

    def _close(self) -> None:
        if self._socket is not None:
            with suppress(WebSocketException, OSError):
                self._socket.close()

    def _receive(self) -> None:
        try:
            with connect(
                self._connection.address,
                additional_headers={"Authorization": f"Bearer {self._connection.token}"},
                compression=None,  # half-float pictures do not shrink, and the other side is this machine
                max_size=BINARY_BYTES_MAX,
                open_timeout=OPEN_SECONDS,
                close_timeout=0.5,
                ping_interval=HEARTBEAT_SECONDS,
                ping_timeout=HEARTBEAT_TIMEOUT_SECONDS,
                proxy=None,
                logger=_silent,
            ) as self._socket:
                if not self._closing.is_set():  # before this: nobody could be asked to close it
                    self._converse(self._socket)
        except InvalidStatus as error:
            self._lost(f"it refused the connection ({error.response.status_code})")
        except ConnectionClosed as error:
            received = error.rcvd
            clean = received is not None and received.code in (1000, 1001)
            reason = received.reason if received and received.reason else "the connection broke"
            self._lost(reason, clean)
        except HelloRefusedError as error:
            self._lost(error.failure.message, refusal=error.failure)
        except ProtocolError as error:
            self._lost(f"it does not keep to the protocol: {error.message}")
        except (OSError, WebSocketException) as error:
            self._lost(f"it cannot be reached: {error or type(error).__name__}")

    def _converse(self, socket: ClientConnection) -> None:
        threading.Thread(target=self._transmit, args=(socket,), name="physhdr send", daemon=True).start()
        socket.send(self._envelope(self._hello))
        for data in socket:
            self._sort(data)
        self._lost("it said good-bye", clean=True)

    def _lost(self, reason: str, clean: bool = False, refusal: Failure | None = None) -> None:
        with suppress(queue.Full):
            self._outbox.put_nowait(None)
        self._events.put(LinkLost(reason, clean or self._closing.is_set(), refusal))

    def _transmit(self, socket: ClientConnection) -> None:
        with suppress(ConnectionClosed, OSError):
            while (text := self._outbox.get()) is not None:
                socket.send(text)

    def _sort(self, data: str | bytes) -> None:
        """One frame of the backend's."""
        if isinstance(data, bytes):
            frame = decode_frame(data)
            for number, request in list(self._open.items()):  # a picture answers what was asked before, too
                if isinstance(request, PreviewRequest) and request.sequence <= frame.header.request.sequence:
                    del self._open[number]
            self._previews.put(frame)
            return
        envelope = decode(data)
        if envelope.kind == "event":
            self._events.put(Received(envelope.message))
            return
        request = self._open.pop(envelope.id, None)
        if request is None:
            return
        if envelope.kind == "error":
            if isinstance(request, Hello):
                raise HelloRefusedError(envelope.message)
            self._refuse(request, envelope.message)
        elif isinstance(envelope.message, Welcome):
            self._events.put(Connected(envelope.message))
        else:
            self._events.put(Received(envelope.message, request))

    def _refuse(self, request: Request, failure: Failure) -> None:
        if isinstance(request, PreviewRequest):
            self._previews.put(PreviewRefused(request, failure))
        else:
            self._events.put(Refused(request, failure))


def _drained(source: "queue.SimpleQueue[Item]") -> list[Item]:
    items: list[Item] = []
    with suppress(queue.Empty):
        while True:
            items.append(source.get_nowait())
    return items
