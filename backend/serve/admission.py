# SPDX-License-Identifier: GPL-3.0-or-later
"""Admits programs that have the token, send hello in time and use this version of the protocol."""

import asyncio
import functools
import hmac
import http
import json
import logging
import select
import socket
import sys
import time
from collections.abc import Callable
from typing import Any, cast

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response as HttpResponse

from ...bridge.connection import HOST
from ...bridge.messages import PROTOCOL_VERSION, Failure, Hello, ProtocolError, decode
from .failures import failure_of
from .frames import POLICY, PROTOCOL, RefusedError, error_text, object_in

log = logging.getLogger(__name__)

HELLO_SECONDS = 5.0
CLIENTS_MAX = 16
#: Maximum number of connections without a token; beyond it, the oldest of them is dropped. Every user of the
#: machine can open some, and each takes a file descriptor of this process, which needs others.
STRANGERS_MAX = 128
#: Connections that the system queues until they are accepted; further ones must retry after a second.
BACKLOG = 1024
#: Lines of a request's first bytes that are searched for the token.
LINES_MAX = 32
#: Seconds between log entries about refusals, each with their number, so that nobody can fill the disk.
REFUSALS_SECONDS = 10.0


#: Connections that have not sent the token yet, the oldest first.
Strangers = dict[asyncio.Transport, None]


class Connection(ServerConnection):
    """A connection that has sent something; a stranger until it is ``admitted``."""

    def __init__(self, strangers: Strangers, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._strangers = strangers

    def admitted(self) -> None:
        self._strangers.pop(self.transport, None)

    def connection_lost(self, exc: Exception | None) -> None:
        self.admitted()
        super().connection_lost(exc)


def listening_socket() -> socket.socket:
    """The socket that clients connect to; raises ``OSError``.

    Linux holds back connections that send nothing: a flood of them costs this process nothing.
    """
    listening = socket.create_server((HOST, 0), backlog=BACKLOG)
    if sys.platform == "linux":
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, int(HELLO_SECONDS))
    return listening


class SilentConnection(asyncio.Protocol):
    """A connection that has sent nothing yet. With its first bytes it becomes what ``connection`` makes.

    That costs several times as much, and a flood of strangers sends nothing. If ``has_token`` accepts the
    first bytes, it is no stranger; those that have not sent any are dropped for the next, the oldest first.
    """

    def __init__(
        self, strangers: Strangers, has_token: Callable[[bytes], bool], connection: Callable[[], Connection]
    ) -> None:
        self._strangers, self._has_token, self._connection = strangers, has_token, connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport = cast(asyncio.Transport, transport)
        self._strangers[transport] = None
        self._timeout = asyncio.get_running_loop().call_later(HELLO_SECONDS, transport.abort)
        self._make_room()

    def _make_room(self) -> None:
        """If there are too many strangers, drop the oldest of those with nothing left to read."""
        if len(self._strangers) > STRANGERS_MAX:
            silent = (each for each in self._strangers if not _is_readable(each))
            crowded = len(self._strangers) > 2 * STRANGERS_MAX
            oldest = next(iter(self._strangers)) if crowded else next(silent, None)
            if oldest is not None:
                del self._strangers[oldest]
                oldest.abort()

    def data_received(self, data: bytes) -> None:
        self._timeout.cancel()
        if self._has_token(data):
            self._strangers.pop(self._transport, None)
        else:
            self._make_room()
        connection = self._connection()
        connection.connection_made(self._transport)
        self._transport.set_protocol(connection)
        connection.data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._timeout.cancel()
        self._strangers.pop(self._transport, None)


def _is_readable(transport: asyncio.Transport) -> bool:
    descriptor = transport.get_extra_info("socket").fileno()
    if sys.platform == "win32":  # has no poll, and its select takes sockets of any number
        return bool(select.select([descriptor], [], [], 0)[0])
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(0))


class Admission:
    """``token``: clients must send it. ``version``: of this backend, for clients with another protocol."""

    def __init__(self, token: str, version: str) -> None:
        self._authorization = f"Bearer {token}".encode()
        self._version = version
        self._strangers: Strangers = {}
        self._refusals, self._next_refusals = 0, 0.0  # not logged yet, and when they may be

    def connection(self, *arguments: Any, **options: Any) -> asyncio.Protocol:
        """The protocol of a new socket, from the library's arguments for a ``ServerConnection``."""
        connection = functools.partial(Connection, self._strangers, *arguments, **options)
        return SilentConnection(self._strangers, self._has_token, connection)

    def turn_away(self) -> None:
        """End the connections of strangers."""
        for transport in list(self._strangers):
            transport.abort()

    def _has_token(self, data: bytes) -> bool:
        """Whether the token is in one of the first lines of a request, in any header."""
        values = (line.partition(b":")[2].strip() for line in data.split(b"\r\n", LINES_MAX)[:LINES_MAX])
        return any(hmac.compare_digest(value, self._authorization) for value in values)

    def refusal(
        self, connection: ServerConnection, request: HttpRequest, clients: int
    ) -> HttpResponse | None:
        """The refusal of an HTTP request for a WebSocket; None if it has the token and no browser sent it.

        ``clients``: how many are connected already.
        """
        sent = request.headers.get_all("Authorization")
        right = len(sent) == 1 and hmac.compare_digest(
            sent[0].encode("utf-8", "replace"), self._authorization
        )
        if request.path != "/":
            status, why = http.HTTPStatus.NOT_FOUND, "there is only /"
        elif request.headers.get_all("Origin"):
            status, why = http.HTTPStatus.FORBIDDEN, "web pages may not connect"
        elif not right:
            status, why = http.HTTPStatus.UNAUTHORIZED, "the token is missing or wrong"
        elif clients >= CLIENTS_MAX:
            status, why = http.HTTPStatus.SERVICE_UNAVAILABLE, f"{CLIENTS_MAX} clients are connected already"
        else:
            return None
        self._log_refusal(why)
        return connection.respond(status, why + "\n")

    def _log_refusal(self, why: str) -> None:
        self._refusals += 1
        now = time.monotonic()
        if now >= self._next_refusals:
            count = "a connection" if self._refusals == 1 else f"{self._refusals} connections, the last one"
            log.warning("refused %s: %s", count, why)
            self._refusals, self._next_refusals = 0, now + REFUSALS_SECONDS

    async def hello_of(self, socket: ServerConnection) -> tuple[Hello, int]:
        """``Hello`` and its id, which must come first; raises ``RefusedError``."""
        try:
            async with asyncio.timeout(HELLO_SECONDS):
                frame = await socket.recv()
        except TimeoutError:
            raise RefusedError(POLICY, f"no hello within {HELLO_SECONDS:g} seconds") from None
        content = object_in(frame)
        # The version comes first, because another one's hello may have other fields.
        body = content.get("body")
        if content.get("type") == "hello" and isinstance(body, dict):
            spoken = body.get("protocol")
            if type(spoken) is not int or spoken != PROTOCOL_VERSION:  # True is 1 to Python
                failure = Failure(
                    code="wrong_protocol",
                    message=f"this backend uses version {PROTOCOL_VERSION} of the protocol, "
                    f"not {json.dumps(spoken)[:20]}",
                    hint=f"It is PhysHDR {self._version}: use the same version on both sides.",
                )
                await socket.send(error_text(content, failure))
                raise RefusedError(PROTOCOL, failure.message)
        try:
            envelope = decode(frame)
        except ProtocolError as error:
            await socket.send(error_text(content, failure_of(error)))
            raise RefusedError(POLICY, error.message) from error
        if envelope.kind != "request" or not isinstance(envelope.message, Hello):
            raise RefusedError(POLICY, "the first frame must be the request hello")
        return envelope.message, envelope.id
