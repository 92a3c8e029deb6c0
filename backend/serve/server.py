# SPDX-License-Identifier: GPL-3.0-or-later
"""The server: an asyncio loop in a thread of its own that lets clients in and carries messages to and fro.

It never waits for the engine, and the engine never waits for it: what the engine tells goes into each
client's slots (``client``), what clients ask goes into the ``inbox``.
"""

import asyncio
import dataclasses
import functools
import hmac
import http
import itertools
import json
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, cast

from websockets.asyncio.server import Server as WebSocketServer
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response as HttpResponse

from ...bridge.connection import HOST
from ...bridge.errors import OutputError
from ...bridge.messages import (
    HEARTBEAT_SECONDS,
    HEARTBEAT_TIMEOUT_SECONDS,
    PROTOCOL_VERSION,
    STEERING,
    TEXT_BYTES_MAX,
    ControlTake,
    Done,
    Failure,
    Hello,
    History,
    HistoryGet,
    JobStatus,
    PreviewFrame,
    PreviewRequest,
    ProtocolError,
    Reply,
    StatusGet,
    Welcome,
    WhenClosed,
    decode,
    type_name,
)
from .client import OUTSTANDING_MAX, WRONG_FRAMES_MAX, Client
from .failures import failure_of
from .inbox import Abandoned, Command, Ending, Inbox, WantedPreview

log = logging.getLogger(__name__)
#: The library's own words (a stranger's half-open connection is a traceback there) stay out of our log.
_library_log = logging.getLogger("websockets.physhdr")
_library_log.setLevel(logging.CRITICAL)

HELLO_SECONDS = 5.0
#: How long a close may take: both sides say good-bye, or the connection is dropped.
CLOSE_SECONDS = 1.0
#: A peer that has taken nothing of what waits for it for so long is dropped: the library's heartbeat cannot
#: tell, since its own pings wait behind the rest.
STALLED_SECONDS = 4.0
CLIENTS_MAX = 16
#: So many connections may be there that have not said hello; with the next one the oldest of them is dropped.
#: Every user of the machine can make some, and each is an open file of this process, which needs others.
STRANGERS_MAX = 64
#: Refusals are logged once in so many seconds, with their number: nobody shall fill the disk by knocking.
REFUSALS_SECONDS = 10.0
NAME_LENGTH_MAX = 80
#: How long a training waits for somebody in control, where the last one wished it stopped.
ABANDONED_SECONDS = 5.0
#: Close codes of RFC 6455, section 7.4.1.
GOING_AWAY, PROTOCOL, UNSUPPORTED, INVALID_DATA, POLICY, INTERNAL = 1001, 1002, 1003, 1007, 1008, 1011


class RefusedError(Exception):
    """Ends a connection: the close code, and the reason for people (at most 123 bytes)."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


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


class Server:
    """Serves until ``close``. The methods below ``start`` may be called from any thread.

    ``welcome``: what every client is told first. ``history``: the present job's curves.
    ``idle_timeout``: seconds without client and work after which the process ends; 0: never.
    """

    def __init__(
        self,
        inbox: Inbox,
        token: str,
        welcome: Welcome,
        history: Callable[[], History],
        idle_timeout: float = 0.0,
    ) -> None:
        self._inbox, self._welcome, self._history = inbox, welcome, history
        self._authorization = f"Bearer {token}".encode()
        self._idle_timeout = idle_timeout
        self._status = JobStatus(state="preparing", message="starting: loading torch")
        self._clients: dict[int, Client] = {}  # the longest connected first
        self._numbers = itertools.count(1)
        self._strangers: dict[Door, None] = {}
        self._refusals, self._next_refusals = 0, 0.0  # not told yet, and when they may be
        self._controller = 0
        self._stop_when_closed = False  # as the client in control wishes
        self._abandoned: asyncio.TimerHandle | None = None
        self._closing = ""
        self._port: Future[int] = Future()
        self._thread = threading.Thread(target=self._run, name="physhdr server", daemon=True)

    def start(self) -> int:
        """Listen; returns the port. Raises ``OutputError`` where that is not possible."""
        self._thread.start()
        try:
            return self._port.result()
        except OSError as error:
            raise OutputError(
                f"cannot listen on {HOST}: {error.strerror or error}",
                "Is the loopback interface up, and does a firewall forbid it?",
            ) from error

    # -- what the engine tells ---------------------------------------------------------------------------

    def publish(self, status: JobStatus) -> None:
        """Tell every client the newest status."""
        self._post(self._publish, status)

    def answer(self, command: Command, message: Reply | Failure) -> None:
        """The reply to a request that was taken from the inbox."""
        self._post(self._answer, command, message)

    def show(self, wanted: WantedPreview, frame: PreviewFrame | Failure) -> None:
        """The preview that was taken from the inbox, or why there is none."""
        self._post(self._show, wanted, frame)

    def close(self, reason: str) -> None:
        """Send what is left, tell every client why, and end the thread."""
        self._closing = reason or "the backend ends"
        self._post(self._ended.set)
        self._thread.join(timeout=4 * CLOSE_SECONDS + 1.0)

    def _post(self, function: Callable[..., None], *arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended, and nobody is there to be told
            self._loop.call_soon_threadsafe(function, *arguments)

    # -- on the server's thread --------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            asyncio.run(self._main())
        except BaseException as error:  # a dead thread would be silent
            if not self._port.done():
                self._port.set_exception(error)
                return
            log.exception("the server's thread failed")
            self._inbox.put(Ending("the server's thread failed"))

    async def _main(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._ended = asyncio.Event()
        server = await serve(
            self._handle,
            HOST,
            0,
            process_request=self._admit_request,
            compression=None,  # half-float pictures hardly shrink, and it would take longer than the way
            max_size=TEXT_BYTES_MAX,
            open_timeout=HELLO_SECONDS,
            ping_interval=HEARTBEAT_SECONDS,
            ping_timeout=HEARTBEAT_TIMEOUT_SECONDS,
            close_timeout=CLOSE_SECONDS,
            server_header=None,
            logger=_library_log,
            create_connection=cast(type[ServerConnection], functools.partial(Door, self._strangers)),
        )
        watch = asyncio.create_task(self._watch_idleness())
        self._port.set_result(next(iter(server.sockets)).getsockname()[1])
        await self._ended.wait()
        watch.cancel()
        await self._say_good_bye(server)

    async def _say_good_bye(self, server: WebSocketServer) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_SECONDS):
                while not all(client.idle for client in self._clients.values()):
                    await asyncio.sleep(0.01)
        closing = [_close(client.socket, GOING_AWAY, self._closing) for client in self._clients.values()]
        await asyncio.gather(*closing, return_exceptions=True)
        server.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(2 * CLOSE_SECONDS):
                await server.wait_closed()

    async def _watch_idleness(self) -> None:
        if not self._idle_timeout > 0.0:
            return
        since = time.monotonic()
        while True:
            await asyncio.sleep(min(0.5, self._idle_timeout / 4))
            if self._clients or self._status.state in ("preparing", "training", "stopping"):
                since = time.monotonic()
            elif time.monotonic() - since > self._idle_timeout:
                self._inbox.put(Ending(f"nobody was connected for {self._idle_timeout:g} seconds"))
                return

    # -- a connection ------------------------------------------------------------------------------------

    def _admit_request(self, connection: ServerConnection, request: HttpRequest) -> HttpResponse | None:
        """The HTTP request for a WebSocket: refused unless it has the token and no browser sent it."""
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
        elif len(self._clients) >= CLIENTS_MAX:
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

    async def _handle(self, socket: ServerConnection) -> None:
        client = None
        try:
            hello, number = await self._first_request(socket)
            cast(Door, socket).admitted()
            client = self._enter(socket, hello, number)
            tasks = [asyncio.create_task(self._write(client)), asyncio.create_task(_drop_if_stalled(socket))]
            try:
                async for frame in socket:
                    self._take(client, frame)
                    await client.room()
            finally:
                for task in tasks:
                    task.cancel()
            log.info("%s left", client.name)
        except RefusedError as refused:
            log.warning("closed %s: %s", client.name if client else "a connection", refused.reason)
            await _close(socket, refused.code, refused.reason)
        except ConnectionClosed as closed:
            log.warning("lost %s: %s", client.name if client else "a connection", closed)
        except Exception:
            log.exception("a connection failed")
            await _close(socket, INTERNAL, "the backend failed; see its log")
        finally:
            if client:
                self._leave(client)

    async def _write(self, client: Client) -> None:
        try:
            await client.write()
        except ConnectionClosed:
            pass  # the reading side says so
        except Exception:
            log.exception("writing to %s failed", client.name)
            await _close(client.socket, INTERNAL, "the backend failed; see its log")

    async def _first_request(self, socket: ServerConnection) -> tuple[Hello, int]:
        """``Hello`` and its id; raises ``RefusedError``."""
        try:
            async with asyncio.timeout(HELLO_SECONDS):
                frame = await socket.recv()
        except TimeoutError:
            raise RefusedError(POLICY, f"no hello within {HELLO_SECONDS:g} seconds") from None
        content = _object(frame)
        # The version is looked at before anything else: another one's hello may have other fields.
        body = content.get("body")
        if content.get("type") == "hello" and isinstance(body, dict):
            spoken = body.get("protocol")
            if spoken != PROTOCOL_VERSION:
                failure = Failure(
                    code="wrong_protocol",
                    message=f"this backend speaks version {PROTOCOL_VERSION} of the protocol, "
                    f"not {json.dumps(spoken)[:20]}",
                    hint=f"It is PhysHDR {self._welcome.version}: use the same version on both sides.",
                )
                await socket.send(_error_text(content, failure))
                raise RefusedError(PROTOCOL, failure.message)
        try:
            envelope = decode(frame)
        except ProtocolError as error:
            await socket.send(_error_text(content, failure_of(error)))
            raise RefusedError(POLICY, error.message) from error
        if envelope.kind != "request" or not isinstance(envelope.message, Hello):
            raise RefusedError(POLICY, "the first frame must be the request hello")
        return envelope.message, envelope.id

    def _enter(self, socket: ServerConnection, hello: Hello, number: int) -> Client:
        name = "".join(c for c in hello.client if c.isprintable())[:NAME_LENGTH_MAX] or "a client"
        client = Client(socket, next(self._numbers), name, self._inbox.sent)
        self._clients[client.number] = client
        log.info("%s connected", name)
        if not self._controller:
            self._put_in_control(client.number)
        in_control = self._controller == client.number
        client.reply(
            number,
            dataclasses.replace(self._welcome, in_control=in_control, device=self._status.device),
        )
        self._tell_all()
        return client

    def _leave(self, client: Client) -> None:
        self._clients.pop(client.number, None)
        self._inbox.forget(client.number)
        if self._controller == client.number:
            if self._stop_when_closed:
                self._abandoned = self._loop.call_later(ABANDONED_SECONDS, self._inbox.put, Abandoned())
            self._controller = 0
            if self._clients:
                self._put_in_control(next(iter(self._clients)))  # whoever has been here longest
            self._tell_all()

    def _put_in_control(self, number: int) -> None:
        self._controller, self._stop_when_closed = number, False
        if self._abandoned:
            self._abandoned.cancel()

    # -- frames ------------------------------------------------------------------------------------------

    def _take(self, client: Client, frame: str | bytes) -> None:
        """One frame of a client; raises ``RefusedError`` where the connection must end."""
        try:
            envelope = decode(_text(frame))
            if envelope.kind != "request":
                raise ProtocolError(f"clients send requests, not frames of kind {envelope.kind!r}")
            if isinstance(envelope.message, Hello):
                raise ProtocolError("hello was said already")
        except ProtocolError as error:
            content = _object(frame)
            client.wrong_frames += 1
            number = content.get("id")
            if type(number) is not int or number < 0:
                raise RefusedError(POLICY, f"a frame without a usable id: {error.message}") from error
            if client.wrong_frames > WRONG_FRAMES_MAX:
                raise RefusedError(POLICY, f"too many wrong frames, the last: {error.message}") from error
            client.fail(number, failure_of(error))
            return
        self._obey(client, envelope.id, envelope.message)

    def _obey(self, client: Client, number: int, message: Any) -> None:
        if isinstance(message, STEERING) and client.number != self._controller:
            name = self._controller_name
            client.fail(
                number,
                Failure(
                    code="not_in_control",
                    message=f"{name} steers this backend; {type_name(type(message))} is for the one who does",
                    hint=f"{name} is in control: watch, or take control.",
                ),
            )
        elif isinstance(message, StatusGet):
            client.reply(number, self._personal(client))
        elif isinstance(message, HistoryGet):
            client.reply(number, self._history())
        elif isinstance(message, ControlTake):
            self._put_in_control(client.number)
            log.info("%s takes control", client.name)
            self._tell_all()
            client.reply(number, Done())
        elif isinstance(message, WhenClosed):
            self._stop_when_closed = message.training == "stop"
            client.reply(number, Done())
        elif isinstance(message, PreviewRequest):
            self._want_preview(client, number, message)
        elif client.outstanding >= OUTSTANDING_MAX:
            client.fail(
                number,
                Failure(
                    code="busy",
                    message=f"{OUTSTANDING_MAX} requests are waiting already",
                    hint="Wait for their replies.",
                ),
            )
        else:
            client.outstanding += 1
            self._inbox.put(Command(client.number, client.name, number, message))

    def _want_preview(self, client: Client, number: int, request: PreviewRequest) -> None:
        if not self._status.has_model:
            client.fail(
                number,
                Failure(
                    code="no_model",
                    message="there is no model to render yet",
                    hint="Start a training, or open a run.",
                ),
            )
            return
        replaced = self._inbox.offer(WantedPreview(client.number, number, request))
        if replaced:
            failure = Failure(code="superseded", message="a newer preview was asked for")
            client.fail(replaced.id, failure)

    # -- telling -----------------------------------------------------------------------------------------

    @property
    def _controller_name(self) -> str:
        controller = self._clients.get(self._controller)
        return controller.name if controller else ""

    def _personal(self, client: Client) -> JobStatus:
        return dataclasses.replace(
            self._status,
            controller=self._controller_name,
            in_control=client.number == self._controller,
        )

    def _publish(self, status: JobStatus) -> None:
        self._status = status
        self._tell_all()

    def _tell_all(self) -> None:
        for client in self._clients.values():
            client.tell(self._personal(client))

    def _answer(self, command: Command, message: Reply | Failure) -> None:
        client = self._clients.get(command.client)
        if client:
            client.outstanding -= 1
            if isinstance(message, Failure):
                client.fail(command.id, message)
            else:
                client.reply(command.id, message)

    def _show(self, wanted: WantedPreview, frame: PreviewFrame | Failure) -> None:
        client = self._clients.get(wanted.client)
        if client and isinstance(frame, PreviewFrame):
            client.show(frame)
            return
        self._inbox.sent(wanted.client)
        if client and isinstance(frame, Failure):
            client.fail(wanted.id, frame)


async def _drop_if_stalled(socket: ServerConnection) -> None:
    """Cut the connection when the peer does not take what is sent."""
    waiting, since = 0, time.monotonic()
    while True:
        await asyncio.sleep(0.25)
        before, waiting = waiting, socket.transport.get_write_buffer_size()
        now = time.monotonic()
        if waiting == 0 or waiting < before:
            since = now
        elif now - since > STALLED_SECONDS:
            log.warning("dropped a connection that took nothing for %g seconds", STALLED_SECONDS)
            socket.transport.abort()
            return


async def _close(socket: ServerConnection, code: int, reason: str) -> None:
    """Say why, and close; a peer that does not read is not waited for."""
    cut = reason.encode("utf-8", "replace")[:123].decode(
        "utf-8", "ignore"
    )  # as much as a close frame carries
    try:
        async with asyncio.timeout(2 * CLOSE_SECONDS):
            await socket.close(code, cut)
    except TimeoutError:
        socket.transport.abort()


def _text(frame: str | bytes) -> str:
    if isinstance(frame, bytes):
        raise RefusedError(UNSUPPORTED, "clients send text frames only")
    return frame


def _object(frame: str | bytes) -> dict[str, Any]:
    """The JSON object in a frame, whatever it says; raises ``RefusedError``."""
    try:
        content = json.loads(_text(frame))
    except (ValueError, RecursionError):
        raise RefusedError(INVALID_DATA, "a frame is not JSON") from None
    if not isinstance(content, dict):
        raise RefusedError(POLICY, "a frame is not a JSON object")
    return content


def _error_text(request: dict[str, Any], failure: Failure) -> str:
    """The error that answers a request which could not be decoded, in the words of every version."""
    number = request.get("id")
    number = number if type(number) is int and number >= 0 else 0
    return json.dumps({"kind": "error", "id": number, **dataclasses.asdict(failure)})
