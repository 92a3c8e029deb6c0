# SPDX-License-Identifier: GPL-3.0-or-later
"""One connected client, on the server's thread: what to send it, in slots of bounded size."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection

from ...bridge.messages import Envelope, Failure, PreviewFrame, encode, encode_frame

#: A client that does not read its replies is no longer read from; its heartbeat then ends it.
REPLIES_MAX = 64
#: Requests that may wait for the engine at once.
OUTSTANDING_MAX = 16
#: Invalid frames that are answered; the next one closes the connection.
WRONG_FRAMES_MAX = 8


class Client:
    """``number``: its id for the engine. ``name``: for people. Used on the server's thread only."""

    def __init__(
        self, socket: ServerConnection, number: int, name: str, on_frame_sent: Callable[[int], None]
    ) -> None:
        self.socket, self.number, self.name = socket, number, name
        self.outstanding = 0  # requests that the engine has not answered yet
        self.wrong_frames = 0
        self._on_frame_sent = on_frame_sent
        self._replies: deque[str] = deque()
        self._status: str | None = None
        self._frame: PreviewFrame | None = None
        self._something = asyncio.Event()
        self._room = asyncio.Event()
        self._room.set()
        self._sending = self._ended = False

    @property
    def idle(self) -> bool:
        """Whether everything has been sent."""
        return not (self._sending or self._replies or self._status or self._frame)

    def send_status(self, status: Any) -> None:
        """Send the newest ``JobStatus``; replaces one that was not sent yet."""
        self._status = encode(Envelope("event", 0, status))
        self._something.set()

    def reply(self, number: int, message: Any) -> None:
        self._put(encode(Envelope("reply", number, message)))

    def fail(self, number: int, failure: Failure) -> None:
        self._put(encode(Envelope("error", number, failure)))

    def show(self, frame: PreviewFrame) -> None:
        """Send a preview; the inbox ensures that there is never a second one."""
        self._frame = frame
        self._something.set()

    def _put(self, text: str) -> None:
        self._replies.append(text)
        if len(self._replies) >= REPLIES_MAX and not self._ended:
            self._room.clear()
        self._something.set()

    async def room(self) -> None:
        """Wait until the client has read enough of its replies."""
        await self._room.wait()

    async def write(self) -> None:
        """Send everything until the connection ends: a status before the reply that it belongs to."""
        try:
            while True:
                await self._something.wait()
                self._something.clear()
                self._sending = True
                while await self._send_one():
                    pass
                self._sending = False
        finally:
            self._ended = True
            self._room.set()  # release anyone waiting for what will never be sent

    async def _send_one(self) -> bool:
        if self._status is not None:
            text, self._status = self._status, None
            await self.socket.send(text)
        elif self._replies:
            text = self._replies.popleft()
            if len(self._replies) < REPLIES_MAX:
                self._room.set()
            await self.socket.send(text)
        elif self._frame is not None:
            frame, self._frame = self._frame, None
            self._on_frame_sent(self.number)  # the next may be rendered while this one is sent
            await self.socket.send(encode_frame(frame))
        else:
            return False
        return True
