# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection itself, to a server that is not ours."""

import json
import threading
import time

import pytest
from websockets.sync.server import serve

from physhdr.addon.session.client import Client
from physhdr.addon.session.state import LinkLost
from physhdr.bridge.connection import Connection, new_token
from physhdr.bridge.messages import PROTOCOL_VERSION, Failure


class SlowBackend:
    """One that answers the handshake when it is allowed to, as while it loads its libraries."""

    def __init__(self) -> None:
        self.knocked, self.may_answer, self.gone = threading.Event(), threading.Event(), threading.Event()
        self.heard: list[str | bytes] = []
        self._server = serve(self._talk, "127.0.0.1", 0, process_request=self._answer)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def connection(self) -> Connection:
        port = self._server.socket.getsockname()[1]
        return Connection(PROTOCOL_VERSION, port, new_token(), 1, "", "")

    def end(self) -> None:
        self.may_answer.set()
        self._server.shutdown()

    def _answer(self, *_: object) -> None:
        self.knocked.set()
        self.may_answer.wait(20)

    def _talk(self, socket) -> None:
        self.heard.extend(socket)
        self.gone.set()


@pytest.fixture
def slow():
    backend = SlowBackend()
    yield backend
    backend.end()


def test_a_refused_hello_is_told_with_its_remedy():
    """As a backend of an older version answers."""
    answer = {"code": "wrong_protocol", "message": "this backend speaks version 2", "hint": "It is 0.0.9."}

    def refuse(socket) -> None:
        socket.send(json.dumps({"kind": "error", "id": json.loads(socket.recv())["id"], **answer}))
        socket.close(1002, answer["message"])

    with serve(refuse, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        port = server.socket.getsockname()[1]
        client = Client(Connection(PROTOCOL_VERSION, port, new_token(), 1, "", ""), "Blender", "1")
        deadline = time.monotonic() + 10.0
        while not (events := client.take()):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        server.shutdown()
    assert events == [LinkLost(answer["message"], refusal=Failure(**answer))]


def test_a_client_that_is_closed_while_it_connects_does_not_live_on(slow):
    """It would be a connection that nobody knows of, and perhaps the one in control."""
    client = Client(slow.connection, "Blender", "1")
    assert slow.knocked.wait(10)
    client.close()
    time.sleep(0.2)  # what closes it has looked, and found no connection yet
    slow.may_answer.set()
    assert slow.gone.wait(10) and slow.heard == []
    for thread in threading.enumerate():
        if thread.name == "physhdr receive":
            thread.join(10)
            assert not thread.is_alive()
    assert client.take() == []
