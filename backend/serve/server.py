# SPDX-License-Identifier: GPL-3.0-or-later
"""The server: an asyncio loop in its own thread that admits clients and passes messages.

It never waits for the engine, nor the engine for it: the engine's messages go into each client's slots
(``client``), clients' requests into the ``inbox``.
"""

import asyncio
import dataclasses
import itertools
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

from ...bridge.connection import HOST
from ...bridge.errors import OutputError
from ...bridge.messages import (
    HEARTBEAT_SECONDS,
    HEARTBEAT_TIMEOUT_SECONDS,
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
from .admission import HELLO_SECONDS, Admission, Connection, listening_socket
from .client import OUTSTANDING_MAX, WRONG_FRAMES_MAX, Client
from .control import Control
from .failures import failure_of
from .frames import (
    CLOSE_SECONDS,
    GOING_AWAY,
    INTERNAL,
    POLICY,
    RefusedError,
    close,
    drop_if_stalled,
    object_in,
    text_of,
)
from .inbox import Command, Ending, Inbox, WantedPreview

log = logging.getLogger(__name__)
#: The library's messages (such as a traceback for a stranger's half-open connection) stay out of our log.
_library_log = logging.getLogger("websockets.physhdr")
_library_log.setLevel(logging.CRITICAL)

NAME_LENGTH_MAX = 80


class Server:
    """Serves until ``close``. The methods below ``start`` may be called from any thread.

    ``welcome``: the first message to every client. ``history``: the present job's curves.
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
        self._admission = Admission(token, welcome.version)
        self._control = Control(inbox)
        self._idle_timeout = idle_timeout
        self._status = JobStatus(state="preparing", message="starting: loading torch")
        self._clients: dict[int, Client] = {}  # the longest connected first
        self._numbers = itertools.count(1)
        self._closing = (GOING_AWAY, "")  # close code and reason of connections
        self._port: Future[int] = Future()
        self._thread = threading.Thread(target=self._run, name="physhdr server", daemon=True)

    def start(self) -> int:
        """Listen; returns the port. Raises ``OutputError`` if that is not possible."""
        self._thread.start()
        try:
            return self._port.result()
        except OSError as error:
            raise OutputError(
                f"cannot listen on {HOST}: {error.strerror or error}",
                "Check that the loopback interface is up and not blocked by a firewall.",
            ) from error

    # -- messages of the engine --------------------------------------------------------------------------

    def publish(self, status: JobStatus) -> None:
        """Send the newest status to every client."""
        self._post(self._publish, status)

    def answer(self, command: Command, message: Reply | Failure) -> None:
        """Send the reply to a request from the inbox."""
        self._post(self._answer, command, message)

    def show(self, wanted: WantedPreview, frame: PreviewFrame | Failure) -> None:
        """Send the preview for a request from the inbox, or why there is none."""
        self._post(self._show, wanted, frame)

    def close(self, reason: str, *, failed: bool = False) -> None:
        """Send what is left, tell every client the reason, and end the thread.

        ``failed``: the backend failed, so clients must not assume that the training was saved.
        """
        self._closing = INTERNAL if failed else GOING_AWAY, reason or "the backend ends"
        self._post(self._ended.set)
        self._thread.join(timeout=4 * CLOSE_SECONDS + 1.0)

    def _post(self, function: Callable[..., None], *arguments: Any) -> None:
        with suppress(RuntimeError):  # the loop has ended
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
            process_request=lambda connection, request: self._admission.refusal(
                connection, request, len(self._clients)
            ),
            compression=None,  # half-float images hardly shrink, and compressing takes longer than sending
            max_size=TEXT_BYTES_MAX,
            open_timeout=HELLO_SECONDS,
            ping_interval=HEARTBEAT_SECONDS,
            ping_timeout=HEARTBEAT_TIMEOUT_SECONDS,
            close_timeout=CLOSE_SECONDS,
            server_header=None,
            logger=_library_log,
            create_connection=cast(type[ServerConnection], self._admission.connection),
            sock=listening_socket(),
        )
        watch = asyncio.create_task(self._watch_idleness())
        self._port.set_result(next(iter(server.sockets)).getsockname()[1])
        await self._ended.wait()
        watch.cancel()
        await self._close_all(server)

    async def _close_all(self, server: WebSocketServer) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_SECONDS):
                while not all(client.idle for client in self._clients.values()):
                    await asyncio.sleep(0.01)
        closing = [close(client.socket, *self._closing) for client in self._clients.values()]
        await asyncio.gather(*closing, return_exceptions=True)
        server.close()
        self._admission.turn_away()
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

    async def _handle(self, socket: ServerConnection) -> None:
        client = None
        try:
            hello, number = await self._admission.hello_of(socket)
            cast(Connection, socket).admitted()
            client = self._enter(socket, hello, number)
            tasks = [asyncio.create_task(self._write(client)), asyncio.create_task(drop_if_stalled(socket))]
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
            await close(socket, refused.code, refused.reason)
        except ConnectionClosed as closed:
            log.warning("lost %s: %s", client.name if client else "a connection", closed)
        except Exception:
            log.exception("a connection failed")
            await close(socket, INTERNAL, "the backend failed; see its log")
        finally:
            if client:
                self._leave(client)

    async def _write(self, client: Client) -> None:
        try:
            await client.write()
        except ConnectionClosed:
            pass  # the reading side logs it
        except Exception:
            log.exception("writing to %s failed", client.name)
            await close(client.socket, INTERNAL, "the backend failed; see its log")

    def _enter(self, socket: ServerConnection, hello: Hello, number: int) -> Client:
        name = "".join(c for c in hello.client if c.isprintable())[:NAME_LENGTH_MAX] or "a client"
        client = Client(socket, next(self._numbers), name, self._inbox.sent)
        self._clients[client.number] = client
        log.info("%s connected", name)
        if not self._control.controller:
            self._control.give_to(client.number)
        in_control = self._control.controller == client.number
        client.reply(
            number,
            dataclasses.replace(self._welcome, in_control=in_control, device=self._status.device),
        )
        self._tell_all()
        return client

    def _leave(self, client: Client) -> None:
        self._clients.pop(client.number, None)
        self._inbox.forget(client.number)
        if self._control.controller == client.number:
            self._control.pass_on(self._clients)  # to the longest connected
            self._tell_all()

    # -- frames ------------------------------------------------------------------------------------------

    def _take(self, client: Client, frame: str | bytes) -> None:
        """Handle one frame of a client; raises ``RefusedError`` if the connection must end."""
        try:
            envelope = decode(text_of(frame))
            if envelope.kind != "request":
                raise ProtocolError(f"clients send requests, not frames of kind {envelope.kind!r}")
            if isinstance(envelope.message, Hello):
                raise ProtocolError("hello was sent already")
        except ProtocolError as error:
            content = object_in(frame)
            client.wrong_frames += 1
            number = content.get("id")
            if type(number) is not int or number < 0:
                raise RefusedError(POLICY, f"a frame without a usable id: {error.message}") from error
            if client.wrong_frames > WRONG_FRAMES_MAX:
                raise RefusedError(POLICY, f"too many invalid frames, the last: {error.message}") from error
            client.fail(number, failure_of(error))
            return
        self._obey(client, envelope.id, envelope.message)

    def _obey(self, client: Client, number: int, message: Any) -> None:
        if isinstance(message, STEERING) and client.number != self._control.controller:
            name = self._controller_name
            client.fail(
                number,
                Failure(
                    code="not_in_control",
                    message=f"{name} controls this backend: others may not send {type_name(type(message))}",
                    hint=f"{name} is in control: watch, or take control.",
                ),
            )
        elif isinstance(message, StatusGet):
            client.reply(number, self._personal(client))
        elif isinstance(message, HistoryGet):
            client.reply(number, self._history())
        elif isinstance(message, ControlTake):
            self._control.give_to(client.number)
            log.info("%s takes control", client.name)
            self._tell_all()
            client.reply(number, Done())
        elif isinstance(message, WhenClosed):
            self._control.stop_when_closed = message.training == "stop"
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
            failure = Failure(code="superseded", message="a newer preview was requested")
            client.fail(replaced.id, failure)

    # -- sending -----------------------------------------------------------------------------------------

    @property
    def _controller_name(self) -> str:
        controller = self._clients.get(self._control.controller)
        return controller.name if controller else ""

    def _personal(self, client: Client) -> JobStatus:
        return dataclasses.replace(
            self._status,
            controller=self._controller_name,
            in_control=client.number == self._control.controller,
        )

    def _publish(self, status: JobStatus) -> None:
        self._status = status
        self._tell_all()

    def _tell_all(self) -> None:
        for client in self._clients.values():
            client.send_status(self._personal(client))

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
