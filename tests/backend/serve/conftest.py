# SPDX-License-Identifier: GPL-3.0-or-later
"""A real backend process and real connections to it."""

import itertools
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from websockets.sync.client import connect

from physhdr.bridge.connection import CONNECTION_FILE, read_connection
from physhdr.bridge.errors import FileDamagedError, FileMissingError
from physhdr.bridge.messages import (
    BINARY_BYTES_MAX,
    PROTOCOL_VERSION,
    Envelope,
    Hello,
    JobStatus,
    PreviewFrame,
    decode,
    decode_frame,
    encode,
)

PATIENCE = 60.0


class RefusalError(Exception):
    """A request was answered by an error."""

    def __init__(self, failure):
        super().__init__(f"{failure.code}: {failure.message} {failure.hint}")
        self.failure, self.code = failure, failure.code


class Backend:
    """A process ``physhdr serve`` with its home; its output goes to ``home/backend.log``."""

    def __init__(self, home: Path, *options: str) -> None:
        home.mkdir(parents=True, exist_ok=True)
        self.home, self.log = home, home / "backend.log"
        physhdr = Path(sys.executable).with_name("physhdr")
        command = [str(physhdr), "serve", "--home", str(home), "--threads", "1", "--log", str(self.log)]
        with open(self.log, "a") as log:
            self.process = subprocess.Popen([*command, *options], stdout=log, stderr=subprocess.STDOUT)
        self.connection = self._found()

    def _found(self):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline and self.process.poll() is None:
            with suppress(FileMissingError, FileDamagedError):  # not yet there, or another one's
                connection = read_connection(self.home)
                if connection.pid == self.process.pid:
                    return connection
            time.sleep(0.02)
        raise AssertionError(f"the backend did not come up:\n{self.log.read_text()}")

    def memory_mb(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024

    def end(self, number: int = signal.SIGTERM) -> int:
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(PATIENCE)


class Peer:
    """A client as a script would write it: asks, waits, keeps the newest status."""

    def __init__(self, backend: Backend, name: str = "test", **options) -> None:
        self._ids = itertools.count(1)
        token = options.pop("token", backend.connection.token)
        say_hello = options.pop("say_hello", True)
        headers = {"Authorization": f"Bearer {token}"} | options.pop("headers", {})
        address = backend.connection.address + options.pop("path", "")
        self._open = connect(
            address,
            additional_headers=headers,
            max_size=BINARY_BYTES_MAX,
            compression=None,
            proxy=None,
            open_timeout=PATIENCE,
            close_timeout=0.5,
        )
        self.socket = self._open.__enter__()
        self.status = JobStatus()
        self.answers: dict[int, object] = {}
        self.frames: list[PreviewFrame] = []
        if say_hello:
            self.welcome = self.ask(Hello(protocol=PROTOCOL_VERSION, client=name))

    def send(self, message) -> int:
        number = next(self._ids)
        self.socket.send(encode(Envelope("request", number, message)))
        return number

    def ask(self, message, timeout: float = PATIENCE):
        """The reply; raises ``RefusalError``."""
        number = self.send(message)
        self.until(lambda: number in self.answers, timeout)
        answer = self.answers.pop(number)
        if isinstance(answer, RefusalError):
            raise answer
        return answer

    def preview(self, request) -> PreviewFrame:
        """The frame that answers; raises ``RefusalError``."""
        number = self.send(request)
        seen = len(self.frames)
        self.until(lambda: number in self.answers or len(self.frames) > seen)
        if number in self.answers:
            raise self.answers.pop(number)
        assert self.frames[-1].header.request == request
        return self.frames[-1]

    def wait_for(self, *states: str, timeout: float = PATIENCE) -> JobStatus:
        self.until(lambda: self.status.state in states, timeout)
        return self.status

    def until(self, condition, timeout: float = PATIENCE) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            self.read(deadline - time.monotonic())

    def read(self, timeout: float) -> None:
        """Take one frame; raises ``TimeoutError``, ``ConnectionClosed``."""
        data = self.socket.recv(timeout=max(timeout, 0.0))
        if isinstance(data, bytes):
            self.frames.append(decode_frame(data))
            return
        envelope = decode(data)
        if envelope.kind == "event":
            self.status = envelope.message
        elif envelope.kind == "error":
            self.answers[envelope.id] = RefusalError(envelope.message)
        else:
            self.answers[envelope.id] = envelope.message


@pytest.fixture(scope="module")
def backend(tmp_path_factory):
    """A backend that the tests of a module share."""
    # On a busy machine the tests between two that use it may take longer than the usual idle minute.
    running = Backend(tmp_path_factory.mktemp("home"), "--idle-timeout", "1200")
    yield running
    assert running.end() == 0, running.log.read_text()
    assert not (running.home / CONNECTION_FILE).exists()
    assert "Traceback" not in running.log.read_text()


@pytest.fixture
def start(tmp_path):
    """Starts backends of a test's own; they are killed at its end."""
    running = []

    def begin(*options: str, home: Path = tmp_path / "home") -> Backend:
        running.append(Backend(home, *options))
        return running[-1]

    yield begin
    for each in running:
        each.process.kill()
        each.process.wait()


@pytest.fixture
def enter():
    """Connects peers; they are gone at the test's end."""
    peers = []

    def begin(backend: Backend, name: str = "test", **options) -> Peer:
        peers.append(Peer(backend, name, **options))
        return peers[-1]

    yield begin
    for peer in peers:
        peer.socket.close()


@pytest.fixture
def refusal():
    """``refusal(peer, message)``: the failure that answers a request which must be refused."""

    def ask(peer: Peer, message):
        with pytest.raises(RefusalError) as caught:
            peer.ask(message)
        return caught.value.failure

    return ask
