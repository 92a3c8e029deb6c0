# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames outside the protocol (invalid ones and those of strangers), and how a connection is ended."""

import asyncio
import dataclasses
import json
import logging
import time
from typing import Any

from websockets.asyncio.server import ServerConnection

from ...bridge.messages import Failure
from ...bridge.regular import unique_names

log = logging.getLogger(__name__)

#: Time for both sides to close, after which the connection is dropped.
CLOSE_SECONDS = 1.0
#: A peer that has read none of the data waiting for it for this long is dropped: the library's heartbeat
#: cannot detect it, because its own pings wait behind the rest.
STALLED_SECONDS = 4.0
#: Close codes of RFC 6455, section 7.4.1.
GOING_AWAY, PROTOCOL, UNSUPPORTED, INVALID_DATA, POLICY, INTERNAL = 1001, 1002, 1003, 1007, 1008, 1011


class RefusedError(Exception):
    """Ends a connection: the close code, and the reason for people (at most 123 bytes)."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


async def drop_if_stalled(socket: ServerConnection) -> None:
    """Drop the connection when the peer does not read what is sent."""
    waiting, since = 0, time.monotonic()
    while True:
        await asyncio.sleep(0.25)
        before, waiting = waiting, socket.transport.get_write_buffer_size()
        now = time.monotonic()
        if waiting == 0 or waiting < before:
            since = now
        elif now - since > STALLED_SECONDS:
            log.warning("dropped a connection that read nothing for %g seconds", STALLED_SECONDS)
            socket.transport.abort()
            return


async def close(socket: ServerConnection, code: int, reason: str) -> None:
    """Close with a reason; does not wait for a peer that does not read."""
    # The maximum of a close frame.
    cut = reason.encode("utf-8", "replace")[:123].decode("utf-8", "ignore")
    try:
        async with asyncio.timeout(2 * CLOSE_SECONDS):
            await socket.close(code, cut)
    except TimeoutError:
        socket.transport.abort()


def text_of(frame: str | bytes) -> str:
    """A frame's text; raises ``RefusedError`` for a binary frame."""
    if isinstance(frame, bytes):
        raise RefusedError(UNSUPPORTED, "clients send text frames only")
    return frame


def object_in(frame: str | bytes) -> dict[str, Any]:
    """The JSON object in a frame, whatever its content; raises ``RefusedError``."""
    try:
        content = json.loads(text_of(frame), object_pairs_hook=unique_names)
    except (ValueError, RecursionError):
        raise RefusedError(INVALID_DATA, "a frame is not JSON") from None
    if not isinstance(content, dict):
        raise RefusedError(POLICY, "a frame is not a JSON object")
    return content


def error_text(request: dict[str, Any], failure: Failure) -> str:
    """The error reply to a request that could not be decoded, in a form that every version reads."""
    number = request.get("id")
    number = number if type(number) is int and number >= 0 else 0
    return json.dumps({"kind": "error", "id": number, **dataclasses.asdict(failure)})
