# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases are tried in a process of their own: one that hangs is ended, one that dies is a finding.

The parent watches which case is being tried and since when (shared memory), and so knows which one it was.
"""

import dataclasses
import faulthandler
import importlib.util
import multiprocessing
import os
import resource
import shutil
import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .cases import MESSAGE_MAX, Case, Finding, InsaneError, Tally, Target
from .mutate import make_case, once

#: A case may not make the process larger by more than this (a picture of MAX_PIXELS is below), nor ask for
#: more than that.
GROWTH_MAX = 640 << 20
ADDRESS_SPACE_MAX = 8 << 30
#: Seconds of computing that a file of this many bytes or more may take: a share of the target's patience, and
#: so much for each byte (JSON takes a tenth).
LONG_FROM, SHARE_OF_PATIENCE, SECONDS_A_BYTE = 1 << 20, 0.2, 0.5e-6
#: A target is given up after so many cases that hung or killed the process: each costs seconds.
DEATHS_MAX = 6
#: Seconds in which whole inputs are made and read once.
PREPARATION = 300.0
#: Seconds between reports of a process.
REPORT_EVERY = 0.2
_PACKAGE = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Order:
    """Cases ``start`` … ``stop`` of a target but ``skipped``, until ``seconds`` are over; or one ``case``."""

    target: str
    seed: int
    start: int
    stop: int
    seconds: float
    case: Case | None = None
    skipped: frozenset[int] = frozenset()


class Worker:
    """A process that tries cases, and is started again when one of them ended it."""

    def __init__(self, scratch: Path) -> None:
        self._scratch = scratch
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None

    def run(self, target: Target, order: Order, tally: Tally) -> None:
        """Try what is ordered and fill ``tally``."""
        if target.needs and importlib.util.find_spec(target.needs) is None:
            tally.skipped = f"this Python lacks {target.needs}"
            return
        begun = time.monotonic()
        start, deadly = order.start, set[int]()
        while start < order.stop:
            left = order.seconds - (time.monotonic() - begun)
            if left <= 0.0:
                break
            self._ensure()
            self._pipe.send(dataclasses.replace(order, start=start, seconds=left, skipped=frozenset(deadly)))
            start, ended = self._watch(target, tally, start)
            if ended is None:
                break
            number, kind, detail = ended
            if number < 0:  # before the first case: there is nothing to continue with
                tally.broken = f"{kind} while preparing: {detail}"
                break
            case = order.case or make_case(
                target, read_seeds(seeds_folder(self._scratch, target)), order.seed, number
            )
            tally.count(f"{kind}!")
            where = f"{case.form} {Path(case.file).suffix}" if kind == "hang" else detail.partition("\n")[0]
            tally.found(Finding(target.name, order.seed, number, kind, where, detail, case))
            deadly.add(number)  # what was tried since the last report is tried again
            if len(deadly) == DEATHS_MAX:
                tally.broken = f"given up after {len(deadly)} cases that hung or crashed"
                break
        tally.seconds += time.monotonic() - begun

    def _watch(self, target: Target, tally: Tally, start: int) -> tuple[int, tuple[int, str, str] | None]:
        """Count what the process reports: the next case, and the one at which it hung or died, and how."""
        while True:
            try:
                if self._pipe.poll(0.2):
                    message = self._pipe.recv()
                    if message == "end":
                        return start, None
                    for number, outcome in message:
                        start = max(start, number + 1)
                        if isinstance(outcome, Finding):
                            tally.count(f"{outcome.kind}!")
                            tally.found(outcome)
                        elif number < 0:
                            tally.broken = outcome
                        else:
                            tally.count(outcome)
                    continue
            except (EOFError, ConnectionResetError):
                self._process.join(10.0)
            number, since = self._number.value, self._since.value
            if self._process.exitcode is not None:
                status = self._process.exitcode
                name = signal.Signals(-status).name if status < 0 else f"status {status}"
                return start, (number, "crash", f"{name}\n{self._last_words()}")
            allowed = target.patience if number >= 0 else PREPARATION
            if since and time.monotonic() - since > allowed:
                os.kill(self._process.pid, signal.SIGABRT)  # faulthandler reports where it was
                self._process.join(10.0)
                self._process.kill()
                self._process.join()
                return start, (number, "hang", f"longer than {allowed:g} s\n{self._last_words()}")

    def _last_words(self) -> str:
        lines = self._log.read_text(errors="replace").splitlines()
        ours = [line.strip() for line in lines if "File" in line and str(_PACKAGE) in line]
        return "\n".join(line.replace(f"{_PACKAGE}/", "") for line in ours[:3])

    def _ensure(self) -> None:
        if self._process is not None and self._process.exitcode is None:
            return
        self._number, self._since = self._context.Value("q", -1), self._context.Value("d", 0.0)
        self._pipe, theirs = self._context.Pipe()
        self._log = self._scratch / f"worker-{time.monotonic_ns()}.log"
        self._log.touch()
        arguments = (theirs, self._number, self._since, self._scratch, self._log)
        self._process = self._context.Process(target=_work, args=arguments, daemon=True)
        self._process.start()
        theirs.close()

    def close(self) -> None:
        if self._process is not None and self._process.exitcode is None:
            self._pipe.send(None)
            self._process.join(5.0)
            self._process.kill()


def seeds_folder(scratch: Path, target: Target) -> Path:
    """Where the whole inputs are: rows that have the same ones share them."""
    from .targets import TARGETS

    first = next(each for each in TARGETS if each.prepare is target.prepare)
    return scratch / "".join(c if c.isalnum() else "-" for c in first.name)


def read_seeds(folder: Path) -> dict[str, dict[str, bytes]]:
    """Variant → file → bytes, of what ``prepare`` wrote."""
    return {
        variant.name: {
            str(path.relative_to(variant)): path.read_bytes()
            for path in sorted(variant.rglob("*"))
            if path.is_file()
        }
        for variant in sorted(folder.iterdir())
    }


# ---- in the process ----------------------------------------------------------------------------------------


def _work(pipe: Connection, number: Any, since: Any, scratch: Path, log: Path) -> None:
    from .targets import TARGETS

    with open(log, "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    faulthandler.enable()
    targets = {target.name: target for target in TARGETS}
    benches: dict[str, tuple[Path, dict[str, dict[str, bytes]]]] = {}
    while (order := pipe.recv()) is not None:
        target = targets[order.target]
        number.value, since.value = -1, time.monotonic()
        try:
            if target.name not in benches:
                benches[target.name] = _bench(target, scratch)
            bench, seeds = benches[target.name]
        except Exception:  # noqa: BLE001 (whatever it is, it is reported)
            pipe.send([(-1, f"cannot be prepared: {traceback.format_exc(limit=-3)}")])
        else:
            pipe.send([(-1, finding) for finding in _whole(target, order, bench, seeds)])
            _limit()
            _try(pipe, order, target, bench, seeds, number, since)
        since.value = 0.0
        pipe.send("end")


def _bench(target: Target, scratch: Path) -> tuple[Path, dict[str, dict[str, bytes]]]:
    """A folder to try things in, and the undamaged inputs, which the first process makes."""
    made = seeds_folder(scratch, target)
    if not made.exists():
        once(made, target.prepare)
    bench = scratch / f"{made.name}.{os.getpid()}.{time.monotonic_ns()}"
    if not target.in_memory:
        shutil.copytree(made, bench)
    return bench, read_seeds(made)


def _whole(
    target: Target, order: Order, bench: Path, seeds: dict[str, dict[str, bytes]]
) -> Iterator[Finding]:
    """Findings of undamaged inputs: where those are not accepted, nothing is learned from damaged ones."""
    for variant, files in seeds.items():
        file = next(file for file in files if target.may_change(file))
        case = Case(variant, file, "bytes", files[file])
        outcome = judged(target, bench, case)
        if isinstance(outcome, str) and outcome != "accepted" and not target.whole_refused:
            outcome = ("whole input refused", f"{variant}: {outcome}", "an undamaged input must be accepted")
        if isinstance(outcome, tuple):
            yield Finding(target.name, order.seed, -1, *outcome, case)


def _limit() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_SPACE_MAX, resource.RLIM_INFINITY))


def _try(
    pipe: Connection,
    order: Order,
    target: Target,
    bench: Path,
    seeds: dict[str, dict[str, bytes]],
    number: Any,
    since: Any,
) -> None:
    begun = reported = time.monotonic()
    outcomes: list[tuple[int, Any]] = []
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for current in range(order.start, order.stop):
        if current in order.skipped:
            continue
        case = order.case or make_case(target, seeds, order.seed, current)
        number.value, since.value, computed = current, time.monotonic(), time.process_time()
        with _laid_out(target, bench, seeds, case):
            outcome = judged(target, bench, case)
        now, computed = time.monotonic(), time.process_time() - computed
        allowed = SHARE_OF_PATIENCE * target.patience + SECONDS_A_BYTE * len(case.content)
        if len(case.content) >= LONG_FROM and computed > allowed:
            detail = f"{computed:.1f} s for {len(case.content)} bytes, where {allowed:.1f} are allowed"
            outcome = ("slow", f"{Path(case.file).suffix} {outcome}"[:80], detail)
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak
        if grown * 1024 > GROWTH_MAX:
            peak += grown
            outcome = ("memory", f"{case.variant} {case.file}", f"it grew by {grown >> 10} MB")
        if isinstance(outcome, tuple):
            outcome = Finding(target.name, order.seed, current, *outcome, case)
        outcomes.append((current, outcome))
        if now - reported > REPORT_EVERY:
            pipe.send(outcomes)
            outcomes, reported = [], now
        if now - begun > order.seconds:
            break
    pipe.send(outcomes)


@contextmanager
def _laid_out(target: Target, bench: Path, seeds: dict[str, dict[str, bytes]], case: Case) -> Iterator[None]:
    """The case's file in place; afterwards the undamaged one is restored."""
    if target.in_memory:
        yield
        return
    path = bench / case.variant / case.file
    path.unlink()  # and not overwritten: a map of the old one stays what it was
    match case.form:
        case "bytes":
            path.write_bytes(case.content)
        case "folder":
            path.mkdir()
        case "fifo":
            os.mkfifo(path)
        case "loop":
            path.symlink_to(path)
    try:
        yield
    finally:
        if case.form == "folder":
            path.rmdir()
        elif case.form != "gone":
            path.unlink()
        path.write_bytes(seeds[case.variant][case.file])


def judged(target: Target, bench: Path, case: Case) -> str | tuple[str, str, str]:
    """What became of the case in a word, or a finding's kind, place and detail."""
    folder = bench / case.variant
    try:
        target.attempt(folder, case.file, case.content)
    except target.refusals as error:
        fault = _fault_of(error, target, folder, case)
        return fault or f"refused ({type(error).__name__})"
    except InsaneError as error:
        return "insane", _category(str(error)), str(error)[:MESSAGE_MAX]
    except Exception as error:  # noqa: BLE001 (that is what is looked for)
        return "raw exception", _place(error), "".join(traceback.format_exception(error, limit=-6))
    return "accepted"


def _fault_of(error: Exception, target: Target, folder: Path, case: Case) -> tuple[str, str, str] | None:
    """Why a refusal is not a clear one."""
    text, cause = str(error), error.__cause__ or error.__context__
    if isinstance(cause, MemoryError):
        return "memory", _place(cause), f"it asked for more than {ADDRESS_SPACE_MAX >> 30} GiB: {text}"
    shown = text[: MESSAGE_MAX // 2]
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return "unprintable message", _place(error), repr(shown)
    if not text.strip() or len(text) > MESSAGE_MAX:
        return "unclear message", _place(error), f"{len(text)} characters: {shown}"
    named = (str(folder), Path(case.file).name, Path(case.file).stem)
    if target.names_place and not any(name in text for name in named):
        return "message names no file", _place(error), shown
    return None


def _category(text: str) -> str:
    """A sentence without its numbers: equal for findings of one cause."""
    return "".join(c for c in text.partition(":")[0] if not c.isdigit())[:120]


def _place(error: BaseException) -> str:
    """``BadValueError in backend/scene/points.py read_points``: the innermost of our own functions."""
    frames = traceback.extract_tb(error.__traceback__)
    tests = str(_PACKAGE / "tests")
    ours = [
        frame
        for frame in frames
        if frame.filename.startswith(f"{_PACKAGE}/")
        and not frame.filename.startswith(tests)
        and "/.venvs/" not in frame.filename
    ]
    if not ours:
        return type(error).__name__
    innermost = ours[-1]
    return f"{type(error).__name__} in {Path(innermost.filename).relative_to(_PACKAGE)} {innermost.name}"
