# SPDX-License-Identifier: GPL-3.0-or-later
"""A backend that is used for long: previews, connections, trainings; memory, threads and descriptors."""

import contextlib
import itertools
import shutil
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from .bench import PATIENCE, Bench, Result
from .oracle import grown, not_given_back, tracebacks
from .processes import Program

#: Seconds between lines; a short soak has a tenth.
SAMPLE_EVERY = 30.0
#: How long one request may take on a busy machine, and one step of a training.
REPLY = 120.0
#: Presets of the small trainings, and how many iterations they have.
PRESETS = ("default", "fast", "baseline", "default-scaffold")
ITERATIONS = (150, 900)
SIDES = (32, 640)


class UnaskedError(Exception):
    """The backend answered by an error, or not at all, where nothing was wrong."""


class Peer:
    """A client: asks, waits, keeps the newest status."""

    def __init__(self, home: Path, name: str) -> None:
        from websockets.sync.client import connect

        from physhdr.bridge import messages
        from physhdr.bridge.connection import read_connection

        self._messages, self._numbers = messages, itertools.count(1)
        found = read_connection(home)
        self.socket = connect(
            found.address,
            additional_headers={"Authorization": f"Bearer {found.token}"},
            max_size=messages.BINARY_BYTES_MAX,
            compression=None,
            proxy=None,
            close_timeout=1.0,
        )
        self.status = messages.JobStatus()
        self.frames = 0
        self._answers: dict[int, Any] = {}
        self.ask(messages.Hello(protocol=messages.PROTOCOL_VERSION, client=name))

    def send(self, message: Any) -> int:
        number = next(self._numbers)
        self.socket.send(self._messages.encode(self._messages.Envelope("request", number, message)))
        return number

    def ask(self, message: Any) -> Any:
        """The reply; raises ``UnaskedError``."""
        number = self.send(message)
        self.until(lambda: number in self._answers, f"an answer to {type(message).__name__}")
        answer = self._answers.pop(number)
        if isinstance(answer, self._messages.Failure):
            raise UnaskedError(f"{type(message).__name__}: {answer.code}: {answer.message}")
        return answer

    def preview(self, sequence: int, side: int) -> bool:
        """Ask for a picture and wait for it; False where there is no model yet."""
        camera = self._messages.PreviewCamera(
            pose=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, -4.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0),
            width=side,
            height=max(1, side * 2 // 3),
            fx=float(side),
            fy=float(side),
            cx=side / 2,
            cy=side / 3,
        )
        seen = self.frames
        number = self.send(self._messages.PreviewRequest(sequence=sequence, camera=camera))
        self.until(lambda: self.frames > seen or number in self._answers, "a preview")
        answer = self._answers.pop(number, None)
        if answer is not None and answer.code not in ("no_model", "superseded"):
            raise UnaskedError(f"a preview of {side}: {answer.code}: {answer.message}")
        return answer is None

    def until(self, condition: Callable[[], bool], what: str, timeout: float = REPLY) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            try:
                self._read(max(0.0, deadline - time.monotonic()))
            except TimeoutError as error:
                raise UnaskedError(f"no {what} within {timeout:.0f} s, state {self.status.state}") from error

    def drain(self) -> None:
        """Take what has come."""
        with contextlib.suppress(TimeoutError):
            while True:
                self._read(0.0)

    def _read(self, timeout: float) -> None:
        data = self.socket.recv(timeout=timeout)
        if isinstance(data, bytes):
            self._messages.decode_frame(data)
            self.frames += 1
            return
        envelope = self._messages.decode(data)
        if envelope.kind == "event":
            self.status = envelope.message
        else:
            self._answers[envelope.id] = envelope.message

    def close(self) -> None:
        self.socket.close()

    def vanish(self) -> None:
        """As a process that is killed: the connection is reset, no farewell."""
        raw = self.socket.socket
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        raw.close()


class Tally:
    """What was done, counted by all who do it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.counts: dict[str, int] = {}

    def add(self, what: str, count: int = 1) -> None:
        with self._lock:
            self.counts[what] = self.counts.get(what, 0) + count

    def __str__(self) -> str:
        return ", ".join(f"{count} {what}" for what, count in sorted(self.counts.items()))


def soak(bench: Bench) -> Result:
    """One who steers, one who looks, one who comes and goes, for ``soak_seconds``."""
    home, seconds = bench.empty("home"), bench.options.soak_seconds
    home.mkdir()
    program = bench.cold(
        *("serve", "--home", home, "--threads", 1, "--idle-timeout", max(600.0, seconds)),
        *("--log", home / "backend.log"),
        log=bench.folder / "serve.log",
    )
    if not program.until((home / "connection.json").exists, PATIENCE):
        raise RuntimeError(f"the backend did not come up: {program.output()[-300:]}")
    result, tally = Result("samples"), Tally()
    process = psutil.Process(program.pid)
    steering = Steering(bench, home, tally)
    ended = threading.Event()
    try:
        steering.peer.until(lambda: steering.peer.status.message != "", "a backend that is ready", PATIENCE)
        steering.round()  # the warm-up: kernels are compiled, everything has been imported
        steering.rest()
        before = _at_rest(process)
        bench.say(f"at rest after the first round: {before[0]} threads, {before[1]} descriptors")
        others = [
            threading.Thread(target=_guarded, args=(work, bench, home, tally, ended, result), daemon=True)
            for work in (_look, _come_and_go)
        ]
        sampler = Sampler(bench, process, tally, seconds, result)
        for thread in (*others, sampler.thread):
            thread.start()
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and program.poll() is None and len(result.complaints) < 10:
            try:
                steering.round(deadline)
            except UnaskedError as error:
                result.complain([str(error)], "steering")
                steering.rest()
        ended.set()
        for thread in others:
            thread.join(REPLY)
        sampler.end()
        steering.rest()
        after = _settled(process, before)
        result.tries = len(sampler.memory)
        result.complain(grown(sampler.memory))
        result.complain(not_given_back("threads", before[0], after[0]))
        result.complain(not_given_back("descriptors", before[1], after[1]))
        result.complain(_complaints_of_log(home, program))
        quarter = max(1, len(sampler.memory) // 4)
        result.facts += [
            f"{seconds / 60:.0f} min: {tally}",
            f"memory {np.median(sampler.memory[quarter : 2 * quarter] or [0]):.0f} MB in the second quarter, "
            f"{np.median(sampler.memory[-quarter:]):.0f} MB in the last (at most {max(sampler.memory):.0f})",
            f"threads {before[0]} → {after[0]}, descriptors {before[1]} → {after[1]}",
        ]
        steering.peer.close()
    finally:
        ended.set()
        if program.poll() is None:
            program.interrupt()
            with contextlib.suppress(Exception):
                program.wait(60.0)
    if program.poll() != 0:
        result.complain([f"the backend ended with {program.poll()}"])
    return result


def _at_rest(process: psutil.Process) -> tuple[int, int]:
    """(threads, descriptors) once nothing has changed for a second."""
    before = (process.num_threads(), process.num_fds())
    for _ in range(30):
        time.sleep(1.0)
        now = (process.num_threads(), process.num_fds())
        if now == before:
            break
        before = now
    return before


def _settled(process: psutil.Process, wanted: tuple[int, int]) -> tuple[int, int]:
    """The same at the end; a reset connection is noticed within seconds."""
    counts = _at_rest(process)
    for _ in range(9):
        if counts[0] <= wanted[0] and counts[1] <= wanted[1]:
            break
        counts = _at_rest(process)
    return counts


def _complaints_of_log(home: Path, program: Program) -> list[str]:
    output = program.output()
    with contextlib.suppress(OSError):
        output += (home / "backend.log").read_text(encoding="utf-8", errors="replace")
    bad = [line for line in output.splitlines() if " ERROR" in line or line.startswith("ERROR")]
    return tracebacks(output) + [f"its log has: {line}" for line in bad[:3]]


class Sampler:
    """Memory (MB), threads and descriptors at even times, printed; a thread of its own."""

    def __init__(
        self, bench: Bench, process: psutil.Process, tally: Tally, seconds: float, result: Result
    ) -> None:
        self.memory: list[float] = []
        self._bench, self._process, self._tally, self._result = bench, process, tally, result
        self._every = min(SAMPLE_EVERY, seconds / 12.0)
        self._ended = threading.Event()
        self.thread = threading.Thread(target=self._run, name="sampler", daemon=True)

    def end(self) -> None:
        self._ended.set()
        self.thread.join(60.0)

    def _run(self) -> None:
        begun = time.monotonic()
        while not self._ended.wait(self._every):
            try:
                memory = self._process.memory_info().rss / 1e6
                threads, descriptors = self._process.num_threads(), self._process.num_fds()
            except psutil.Error as error:
                self._result.complain([f"the backend has vanished: {error}"])
                return
            self.memory.append(memory)
            self._bench.say(
                f"{time.monotonic() - begun:6.0f} s  {memory:7.1f} MB  {threads} threads  "
                f"{descriptors} descriptors  {self._tally}"
            )


# ---- who uses it -----------------------------------------------------------------------------------------


class Steering:
    """In control: starts, pauses, stops, resumes, exports and opens small trainings."""

    def __init__(self, bench: Bench, home: Path, tally: Tally) -> None:
        from physhdr.bridge import messages

        self.bench, self.messages, self.tally = bench, messages, tally
        self.folder = home.parent / "runs"
        shutil.rmtree(self.folder, ignore_errors=True)
        self.peer = Peer(home, "who steers")
        self.rng, self.rounds = bench.rng, 0

    def rest(self) -> None:
        """Nothing runs, and the same run as ever is open."""
        peer, messages = self.peer, self.messages
        if peer.status.state in ("preparing", "training", "paused"):
            with contextlib.suppress(UnaskedError):
                peer.ask(messages.TrainStop())
        self._wait("idle", "stopped", "finished", "failed", "open")
        peer.ask(messages.RunOpen(run=str(self.bench.material.run)))

    def round(self, deadline: float = float("inf")) -> None:
        """One training and all that can be done with it; ends early at the deadline."""
        peer, messages, rng = self.peer, self.messages, self.rng
        run = self.folder / f"run_{self.rounds % 3}"
        preset = PRESETS[0] if self.bench.short else PRESETS[self.rounds % len(PRESETS)]
        high = 200 if self.bench.short else ITERATIONS[1]
        count = int(rng.integers(ITERATIONS[0], high))
        self.rounds += 1
        peer.ask(
            messages.TrainStart(
                data=str(self.bench.material.data),
                out=str(run),
                preset=preset,
                iterations=count,
                seed=int(rng.integers(1000)),
                overwrite=True,
            )
        )
        self.tally.add("trainings")
        self._wait("training", "finished")
        self._reach(int(count * rng.uniform(0.05, 0.4)))
        if peer.status.state == "training" and self._ask_unless_over(messages.TrainPause()):
            peer.preview(self.rounds, int(rng.integers(*SIDES)))
            self._ask_unless_over(messages.TrainContinue())
            self.tally.add("pauses")
        self._reach(int(count * rng.uniform(0.4, 0.8)))
        exported = peer.ask(messages.ModelExport(path=str(self.folder / "model.safetensors")))
        assert exported.gaussians > 0
        self.tally.add("exports")
        if peer.status.state == "training" and self._ask_unless_over(messages.TrainStop()):
            self._wait("stopped", "finished")
            if peer.status.state == "stopped" and time.monotonic() < deadline:
                peer.ask(messages.TrainResume(run=str(run)))
                self.tally.add("resumes")
        self._wait("finished", "stopped")
        self.tally.add("iterations", peer.status.iteration)
        peer.ask(messages.RunOpen(run=str(run)))
        self.tally.add("opens")
        peer.ask(messages.HistoryGet())

    def _reach(self, iteration: int) -> None:
        peer = self.peer
        peer.until(
            lambda: peer.status.iteration >= iteration or peer.status.state != "training",
            f"iteration {iteration}",
            PATIENCE,
        )

    def _ask_unless_over(self, message: Any) -> bool:
        """A training may have ended just before it was to be paused."""
        try:
            self.peer.ask(message)
        except UnaskedError:
            self.peer.drain()
            if self.peer.status.state in ("finished", "stopped", "stopping"):
                return False
            raise
        return True

    def _wait(self, *states: str) -> None:
        peer = self.peer
        peer.until(lambda: peer.status.state in (*states, "failed"), f"state {' or '.join(states)}", PATIENCE)
        if peer.status.state == "failed" and "failed" not in states:
            raise UnaskedError(f"a training failed: {peer.status.message}")


Work = Callable[[Bench, Path, Tally, threading.Event], None]


def _guarded(
    work: Work, bench: Bench, home: Path, tally: Tally, ended: threading.Event, result: Result
) -> None:
    try:
        work(bench, home, tally, ended)
    except Exception as error:  # noqa: BLE001 (whatever ends a client that did nothing wrong is a complaint)
        result.complain([f"{type(error).__name__}: {error}"], work.__name__.strip("_"))


def _look(bench: Bench, home: Path, tally: Tally, ended: threading.Event) -> None:
    """Previews at changing sizes, and what is drawn while a viewport is dragged larger."""
    rng = np.random.default_rng(bench.options.seed + 1)
    peer = Peer(home, "who looks")
    for sequence in itertools.count():
        if ended.wait(float(rng.uniform(0.05, 0.5))):
            break
        if peer.preview(sequence, int(rng.integers(*SIDES))):
            tally.add("previews")
    peer.close()


def _come_and_go(bench: Bench, home: Path, tally: Tally, ended: threading.Event) -> None:
    """Connections that end well, that vanish, that never say what they want, and strangers."""
    from physhdr.bridge.connection import read_connection

    rng = np.random.default_rng(bench.options.seed + 2)
    address = ("127.0.0.1", read_connection(home).port)
    for number in itertools.count():
        if ended.wait(float(rng.uniform(0.2, 1.0))):
            return
        how = number % 4
        if how < 3:
            peer = Peer(home, f"visitor {number}")
            if how == 1:
                peer.send(peer._messages.StatusGet())
            if how == 2:
                peer.vanish()
                tally.add("vanished")
            else:
                peer.close()
                tally.add("connections")
            continue
        with socket.create_connection(address, timeout=10.0) as stranger:
            stranger.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + b"\r\n" * (number % 8 == 3))
            tally.add("strangers")
