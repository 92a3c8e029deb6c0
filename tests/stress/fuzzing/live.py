# SPDX-License-Identifier: GPL-3.0-or-later
"""A real ``physhdr serve`` under attack, from this machine's own loopback: what no client of ours would send.

Before and after, the process's memory, threads and descriptors are counted; at the end a client that behaves
must be answered, and the log must hold no traceback.
"""

import itertools
import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from physhdr.bridge.connection import HOST, Connection, read_connection
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.messages import (
    PROTOCOL_VERSION,
    TEXT_BYTES_MAX,
    Envelope,
    Hello,
    JobStatus,
    ModelExport,
    RunOpen,
    Shutdown,
    StatusGet,
    TrainResume,
    TrainStart,
    Welcome,
    decode,
    encode,
)

from .cases import Case, Finding, Tally
from .frames import write_texts
from .mutate import damage, damaged

#: Seconds until a backend answers or has released what it held.
PATIENCE = 60.0
#: Megabytes that a backend may have grown after all of it.
GROWTH_MAX = 64.0
#: Messages that would do something: a mutation that is still one of them is not sent.
OBEYED = (Shutdown, TrainStart, TrainResume, RunOpen, ModelExport)
#: Close codes, as RFC 6455 allows a server to send.
CODES = (1000, 1001, 1002, 1003, 1007, 1008, 1009, 1011)


class Backend:
    """``physhdr serve`` with a home of its own."""

    def __init__(self, home: Path) -> None:
        home.mkdir()
        self.log = home / "backend.log"
        physhdr = Path(sys.executable).with_name("physhdr")
        command = [str(physhdr), "serve", "--home", str(home), "--threads", "1", "--log", str(self.log)]
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                [*command, "--idle-timeout", "900"], stdout=log, stderr=subprocess.STDOUT
            )
        deadline = time.monotonic() + PATIENCE
        while True:
            with suppress(PhysHDRError):
                self.connection: Connection = read_connection(home)
                break
            if self.process.poll() is not None or time.monotonic() > deadline:
                self.end()
                raise RuntimeError(f"the backend did not come up: {self.log.read_text()[-500:]}")
            time.sleep(0.05)

    def held(self) -> dict[str, float]:
        """Memory in MB, threads, open descriptors."""
        folder = Path(f"/proc/{self.process.pid}")
        facts = dict(
            line.split(":", 1) for line in (folder / "status").read_text().splitlines() if ":" in line
        )
        return {
            "MB": int(facts["VmRSS"].split()[0]) / 1024,
            "threads": int(facts["Threads"]),
            "descriptors": len(os.listdir(folder / "fd")),
        }

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


class Raw:
    """A TCP connection that sends whatever a test wants."""

    def __init__(self, connection: Connection, timeout: float = 20.0) -> None:
        self.socket = socket.create_connection((HOST, connection.port), timeout=timeout)
        self._connection = connection
        self._left = b""

    def __enter__(self) -> "Raw":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def ask(self, *headers: str, token: str | None = "", path: str = "/") -> int:
        """The status of the answer to a request for a WebSocket; ``token``: "" is the right one."""
        lines = [f"GET {path} HTTP/1.1", f"Host: {HOST}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
        if token is not None:
            lines.append(f"Authorization: Bearer {token or self._connection.token}")
        self.socket.sendall("\r\n".join([*lines, *headers, "", ""]).encode("utf-8", "surrogateescape"))
        while b"\r\n\r\n" not in self._left:
            data = self.socket.recv(65536)
            if not data:
                return 0
            self._left += data
        head, self._left = self._left.split(b"\r\n\r\n", 1)
        return int(head.split()[1])

    def send(
        self, payload: bytes, opcode: int = 1, final: bool = True, masked: bool = True, bits: int = 0
    ) -> None:
        """One frame of RFC 6455; the mask is zeros, so that the payload stays readable."""
        first = bytes([(0x80 if final else 0) | bits | opcode])
        size, mask = len(payload), 0x80 if masked else 0
        if size < 126:
            length = bytes([mask | size])
        elif size < 1 << 16:
            length = bytes([mask | 126]) + struct.pack(">H", size)
        else:
            length = bytes([mask | 127]) + struct.pack(">Q", size)
        self.socket.sendall(first + length + (bytes(4) if masked else b"") + payload)

    def receive(self) -> tuple[int, bytes]:
        """Opcode and payload of a frame; 8 is a close, and so is a connection that ended."""
        with suppress(ConnectionError):
            first, second = self._exactly(2)
            size = second & 0x7F
            if size == 126:
                (size,) = struct.unpack(">H", self._exactly(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self._exactly(8))
            return first & 15, self._exactly(size)
        return 8, b""

    def _exactly(self, count: int) -> bytes:
        while len(self._left) < count:
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionResetError
            self._left += data
        data, self._left = self._left[:count], self._left[count:]
        return data

    def say(self, message: Any, number: int = 1) -> None:
        self.send(encode(Envelope("request", number, message)).encode())

    def answer(self, number: int) -> Any:
        """The answer to a request: a message, or the close code where there is none."""
        while True:
            opcode, payload = self.receive()
            if opcode == 8:
                return int.from_bytes(payload[:2], "big")
            if opcode == 1:
                envelope = decode(payload.decode())
                if envelope.id == number and envelope.kind != "event":
                    return envelope.message
            elif opcode == 9:
                with suppress(OSError):
                    self.send(payload, 10)

    def enter(self) -> Any:
        """Ask and say hello as a client of ours; the answer."""
        status = self.ask()
        if status != 101:
            return status
        self.say(Hello(protocol=PROTOCOL_VERSION, client="fuzz"))
        return self.answer(1)


class Attack:
    """What was tried, and the outcome: one ``Tally`` for each kind."""

    def __init__(self, backend: Backend, seed: int) -> None:
        self.backend, self.seed = backend, seed
        self.generator = random.Random(f"{seed}/live")
        self.tallies: list[Tally] = []
        self._tally = Tally("")

    def kind(self, name: str, attempts: int, attempt: Callable[[], str]) -> None:
        """Do it so many times; ``attempt`` returns the outcome, one that ends with ! is a finding."""
        self._tally = Tally(f"live server: {name}")
        self.tallies.append(self._tally)
        begun = time.monotonic()
        for number in range(attempts):
            try:
                outcome = attempt()
            except TimeoutError:
                outcome = "no answer!"
            except ConnectionError:
                outcome = "cut off"
            self._tally.count(outcome)
            if outcome.endswith("!"):
                self.found(outcome.rstrip("!"), number)
            if self.backend.process.poll() is not None:
                self.found("the server ended", number)
                break
        self._tally.seconds = time.monotonic() - begun

    def last(self, status: int, log: str) -> None:
        """The row of how it ended, and of what it logged."""
        self._tally = Tally("live server: its end and its log")
        self.tallies.append(self._tally)
        trouble = max(log.find("Traceback"), log.find(" ERROR "))
        self._tally.count(f"status {status}" + "!" * (status != 0))
        self._tally.count("a traceback!" if trouble >= 0 else "no traceback")
        if status:
            self.found(f"it ended with status {status}", 0, log[-2000:])
        if trouble >= 0:
            self.found("a traceback in its log", 0, log[max(trouble - 300, 0) :][:2000])

    def found(self, what: str, number: int = 0, detail: str = "") -> None:
        case = Case("", "", "live")
        detail = detail or self.backend.log.read_text(errors="replace")[-1500:]
        self._tally.found(Finding(self._tally.name, self.seed, number, "live", what, detail, case))


def attack(scratch: Path, seed: int, short: bool) -> list[Tally]:
    """All attacks on one backend; the last row is what it holds afterwards."""
    try:
        backend = Backend(scratch / "home")
    except (RuntimeError, OSError) as error:
        return [Tally("live server", skipped=str(error))]
    try:
        _ready(backend)
        before = backend.held()
        attacks = Attack(backend, seed)
        _attack(attacks, 0.1 if short else 1.0, scratch)
        _crowds(attacks, 0.1 if short else 1.0, before)
        _afterwards(attacks, before)
        return attacks.tallies
    finally:
        backend.end()


def _attack(attacks: Attack, share: float, scratch: Path) -> None:
    connection, generator = attacks.backend.connection, attacks.generator

    def times(count: int) -> int:
        return max(3, int(count * share))

    def refused_request(*headers: str, expected: int, **options: Any) -> str:
        with Raw(connection) as peer:
            status = peer.ask(*headers, **options)
            return f"HTTP {status}" if status == expected else f"HTTP {status} instead of {expected}!"

    tokens = (
        "0" * 64,
        connection.token[:-1],
        connection.token + "0",
        connection.token.upper(),
        "é",
        "x" * 4000,
    )
    attacks.kind(
        "wrong token", times(300), lambda: refused_request(token=generator.choice(tokens), expected=401)
    )
    attacks.kind("no token", times(100), lambda: refused_request(token=None, expected=401))
    attacks.kind(
        "two tokens",
        times(50),
        lambda: refused_request(f"Authorization: Bearer {connection.token}", expected=401),
    )
    origins = (
        "http://localhost",
        "null",
        "https://example.org",
        f"http://{HOST}:{connection.port}",
        "file://",
    )
    attacks.kind(
        "a web page's request",
        times(100),
        lambda: refused_request(f"Origin: {generator.choice(origins)}", expected=403),
    )
    attacks.kind("another path", times(50), lambda: refused_request(path="/../../etc/passwd", expected=404))

    def garbage() -> str:
        request = b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n"
        noise = next(damage.mutations(request, 1, generator.getrandbits(32)))
        data = generator.choice((noise, generator.randbytes(300), b"\x16\x03\x01" + noise, b"A" * 200_000))
        with Raw(connection) as peer:
            peer.socket.sendall(data)
            peer.socket.shutdown(socket.SHUT_WR)
            answer = peer.socket.recv(100)
            return "let in!" if b" 101 " in answer else "refused" if answer else "cut off"

    attacks.kind("HTTP garbage", times(500), garbage)

    def first_frame(make: Callable[[Raw], None], *codes: int) -> Callable[[], str]:
        """Let in, it says something else than hello; ``codes``: how it must end."""

        def attempt() -> str:
            with Raw(connection) as peer:
                if (status := peer.ask()) != 101:
                    return f"HTTP {status}!"
                make(peer)
                while True:
                    opcode, payload = peer.receive()
                    if opcode == 8:
                        break
                code = int.from_bytes(payload[:2], "big")
                return f"closed ({code})" if code in codes else f"closed with {code}!"

        return attempt

    def hello(**changes: Any) -> bytes:
        body = {"protocol": PROTOCOL_VERSION, "client": "fuzz", "version": ""} | changes
        return json.dumps({"kind": "request", "id": 1, "type": "hello", "body": body}).encode()

    versions = (0, PROTOCOL_VERSION + 1, 99, -1, 10**400, "2", None, [], {"a": 1}, 2.5, True, "x" * 1000)
    attacks.kind(
        "another version",
        times(100),
        first_frame(lambda peer: peer.send(hello(protocol=generator.choice(versions))), 1002),
    )
    not_hello = (b"", b"[]", b"null", b"{}", b"7" * 5000, b"[" * 100_000, b'{"id": -1}', hello(client=7))
    not_hello += (encode(Envelope("request", 1, StatusGet())).encode(), b'{"kind": "reply"}', b"\xff\xfe")
    attacks.kind(
        "no hello",
        times(200),
        first_frame(lambda peer: peer.send(generator.choice(not_hello)), 1007, 1008),
    )
    attacks.kind(
        "a binary frame",
        times(100),
        first_frame(
            lambda peer: peer.send(generator.randbytes(generator.choice((0, 5, 5000))), 2), 1003, 1007
        ),
    )

    def huge(peer: Raw) -> None:
        with suppress(ConnectionError):  # it may be cut off while it is still being sent
            peer.send(b" " * (TEXT_BYTES_MAX + 1 + generator.randrange(1 << 20)))

    attacks.kind("a huge frame", times(30), first_frame(huge, 1009, 0))

    def fragments(peer: Raw) -> None:
        size = generator.choice((1, 100, 40_000))
        with suppress(ConnectionError):
            for part in range(TEXT_BYTES_MAX // size + 2 if size > 1 else 5000):
                peer.send(b"[" * size, 1 if part == 0 else 0, final=False)
            peer.send(b"", 0)

    attacks.kind("fragments", times(20), first_frame(fragments, 1009, 1007, 0))

    def broken_frame(peer: Raw) -> None:
        options: list[dict[str, Any]] = [
            {"opcode": 3},
            {"opcode": 15},
            {"masked": False},
            {"bits": 0x40},
            {"bits": 0x70},
            {"opcode": 0},
            {"opcode": 9, "final": False},
            {"opcode": 8, "final": False},
        ]
        peer.send(b"x" * 20, **generator.choice(options))

    attacks.kind("broken frames", times(200), first_frame(broken_frame, 1002, 0))
    texts = scratch / "live"
    write_texts(texts)
    seeds = [path.read_bytes() for path in sorted((texts / "texts").glob("*.json"))]
    peers: list[Raw] = []
    numbers = itertools.count(10**6)  # which no damaged message has

    def bad_message() -> str:
        if not peers:
            peer = Raw(connection)
            if not isinstance(peer.enter(), Welcome):
                return "hello was refused!"
            peers.append(peer)
        content = damaged(generator.choice(seeds), ".json", generator)
        try:
            if isinstance(decode(content.decode("utf-8", "replace")).message, OBEYED):
                return "not sent: it would be obeyed"
        except PhysHDRError:
            pass
        number = next(numbers)
        with suppress(ConnectionError):
            peers[0].send(content)
            peers[0].say(StatusGet(), number)
        answer = peers[0].answer(number)
        if isinstance(answer, JobStatus):
            return "answered"
        peers.pop().socket.close()
        return f"closed ({answer})" if answer in (0, *CODES) else f"{answer}!"

    attacks.kind("mutated messages", times(3000), bad_message)
    for peer in peers:
        peer.socket.close()


def _crowds(attacks: Attack, share: float, quiet: dict[str, float]) -> None:
    """Many at once; ``quiet``: what the backend holds with nobody there."""
    connection = attacks.backend.connection
    many = max(40, int(200 * share))
    held: list[Raw] = []

    def half_open() -> str:
        peer = Raw(connection)
        held.append(peer)
        with suppress(ConnectionError):
            peer.socket.sendall(attacks.generator.choice((b"", b"GET", b"GET / HTTP/1.1\r\nHost: x\r\n")))
        return "left open"

    attacks.kind("half-open connections", many, half_open)
    attacks.kind("a client beside them", 3, lambda: _behaves(connection))
    for peer in held:
        peer.socket.close()
    held.clear()

    def crowd() -> str:
        peer = Raw(connection)
        held.append(peer)
        answer = peer.enter()
        return (
            "let in" if isinstance(answer, Welcome) else f"HTTP {answer}" if answer == 503 else f"{answer}!"
        )

    attacks.kind("a crowd of clients", many, crowd)
    for peer in held:
        peer.socket.close()

    def deaf() -> str:
        """Ask a lot, and take no answer: it must be cut off."""
        settled(attacks.backend, quiet)
        with Raw(connection) as peer:
            if not isinstance(peer.enter(), Welcome):
                return "hello was refused!"
            peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            peer.socket.settimeout(0.5)
            connected = attacks.backend.held()["descriptors"]
            text = encode(Envelope("request", 5, StatusGet())).encode()
            begun = time.monotonic()
            # Whether the backend lets go is seen there: what waits in the kernel keeps this end open.
            while time.monotonic() - begun < PATIENCE:
                try:
                    peer.send(text)
                except ConnectionError:
                    return "cut off"
                except TimeoutError:
                    if attacks.backend.held()["descriptors"] < connected:
                        return "cut off"
            return "is still served!"

    attacks.kind("asks and takes no answer", 1 if share < 1.0 else 3, deaf)

    def pings() -> str:
        with Raw(connection) as peer:
            if not isinstance(peer.enter(), Welcome):
                return "hello was refused!"
            with suppress(ConnectionError):
                for _ in range(2000):
                    peer.send(b"x" * 125, 9)
                peer.say(StatusGet(), 9)
            return "answered" if isinstance(peer.answer(9), JobStatus) else "cut off"

    attacks.kind("2000 pings", 1 if share < 1.0 else 5, pings)


def _behaves(connection: Connection) -> str:
    """A client of ours: it is let in and receives the status, within two seconds."""
    begun = time.monotonic()
    with Raw(connection) as peer:
        if not isinstance(peer.enter(), Welcome):
            return "it was not let in!"
        peer.say(StatusGet(), 2)
        status = peer.answer(2)
    if not isinstance(status, JobStatus) or status.state != "idle":
        return f"its status is {status}!"
    seconds = time.monotonic() - begun
    return "served" if seconds < 2.0 else f"waited {seconds:.1f} s!"


def settled(backend: Backend, quiet: dict[str, float]) -> None:
    """Wait until it holds no more connections and threads than when it was ``quiet`` (one may linger)."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline and backend.process.poll() is None:
        held = backend.held()
        if all(held[name] <= quiet[name] + 1 for name in ("descriptors", "threads")):
            break
        time.sleep(0.2)


def _ready(backend: Backend) -> None:
    """Wait until torch is loaded and nothing changes any more."""
    deadline = time.monotonic() + PATIENCE
    while _behaves(backend.connection) != "served" and time.monotonic() < deadline:
        time.sleep(0.5)
    time.sleep(1.0)


def _afterwards(attacks: Attack, before: dict[str, float]) -> None:
    """It holds no more than before, serves, ends with 0 when asked to, and has logged no traceback."""
    backend = attacks.backend
    settled(backend, before)
    attacks.kind("a client afterwards", 3, lambda: _behaves(backend.connection))
    if backend.process.poll() is not None:
        return
    after = backend.held()
    for name, unit in (("MB", " MB"), ("threads", " threads"), ("descriptors", " descriptors")):
        allowed = GROWTH_MAX if name == "MB" else 1
        worse = after[name] - before[name] > allowed
        attacks.kind(
            name if name != "MB" else "memory",
            1,
            lambda text=f"{before[name]:.0f} → {after[name]:.0f}{unit}" + "!" * worse: text,
        )
    attacks.last(backend.end(), backend.log.read_text(errors="replace"))
