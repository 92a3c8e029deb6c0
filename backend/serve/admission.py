# SPDX-License-Identifier: GPL-3.0-or-later
"""Who is let in: a program that has the token, says hello soon and speaks this version of the protocol."""

import asyncio
import functools
import hmac
import http
import json
import logging
import time
from typing import Any, cast

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response as HttpResponse

from ...bridge.messages import PROTOCOL_VERSION, Failure, Hello, ProtocolError, decode
from .failures import failure_of
from .frames import POLICY, PROTOCOL, RefusedError, error_text, object_in

log = logging.getLogger(__name__)

HELLO_SECONDS = 5.0
CLIENTS_MAX = 16
#: So many connections may be there that have not said hello; with the next one the oldest of them is dropped.
#: Every user of the machine can make some, and each is an open file of this process, which needs others.
STRANGERS_MAX = 64
#: Refusals are logged once in so many seconds, with their number: nobody shall fill the disk by knocking.
REFUSALS_SECONDS = 10.0


class Door(ServerConnection):
    """A connection that counts among ``strangers``, the oldest first, until it has said hello."""

    def __init__(self, strangers: "dict[Door, None]", *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._strangers = strangers

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._strangers[self] = None
        if len(self._strangers) > STRANGERS_MAX:
            oldest = next(iter(self._strangers))
            oldest.admitted()
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self.admitted()
        super().connection_lost(exc)

    def admitted(self) -> None:
        """It is no stranger any more."""
        self._strangers.pop(self, None)


class Admission:
    """``token``: what a client must know. ``version``: of this backend, told to those who speak otherwise."""

    def __init__(self, token: str, version: str) -> None:
        self._authorization = f"Bearer {token}".encode()
        self._version = version
        self._strangers: dict[Door, None] = {}
        self._refusals, self._next_refusals = 0, 0.0  # not told yet, and when they may be

    @property
    def door(self) -> type[ServerConnection]:
        """What makes a connection, for the library: one that is a stranger until ``admitted``."""
        return cast(type[ServerConnection], functools.partial(Door, self._strangers))

    def refusal(
        self, connection: ServerConnection, request: HttpRequest, clients: int
    ) -> HttpResponse | None:
        """The refusal of a HTTP request for a WebSocket; None where it has the token and no browser sent it.

        ``clients``: how many are connected already.
        """
        given = request.headers.get_all("Authorization")
        right = len(given) == 1 and hmac.compare_digest(
            given[0].encode("utf-8", "replace"), self._authorization
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
        # The version is looked at before anything else: another one's hello may have other fields.
        body = content.get("body")
        if content.get("type") == "hello" and isinstance(body, dict):
            spoken = body.get("protocol")
            if spoken != PROTOCOL_VERSION:
                failure = Failure(
                    code="wrong_protocol",
                    message=f"this backend speaks version {PROTOCOL_VERSION} of the protocol, "
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
