#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad inputs for everything that reads: each must be refused in one clear sentence, or be understood.

    python tests/stress/fuzz.py                           everything: ten thousand files, 120,000 messages
    python tests/stress/fuzz.py --short                   a few seconds of each, for make test-long
    python tests/stress/fuzz.py --only "PLY" --cases 500  rows whose name has that text
    python tests/stress/fuzz.py --replay FILE …           cases that were found before

A crash, a hang, an exception that is not ours, a message that names nothing, memory that is requested
in vain, a bad input that is accepted: each is a finding, saved as a file under --findings. The exit status
is 1 if there is one.
"""

import argparse
import os
import queue
import sys
import tempfile
import threading
import time
from pathlib import Path

# The backend's CPU kernels would take all cores for pictures of a few pixels; before torch is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from fuzzing.cases import Tally, Target, read_finding
from fuzzing.workers import Order, Worker

ROOT = Path(__file__).resolve().parents[2]
FINDINGS = ROOT / "runs" / "fuzz"
LIVE = "live server"
#: Share of the cases, and seconds for each row, of the short form.
SHORT_SHARE, SHORT_SECONDS = 0.04, 4.0
SECONDS = 900.0


def main() -> int:
    arguments = _arguments()
    if not Path("/proc/self/statm").exists():
        _say("skipped: memory and time of cases are measured on Linux only")
        return 0
    try:
        from fuzzing.targets import TARGETS
    except ImportError as error:
        _say(f"skipped: this Python lacks a package ({error})")
        return 0
    with tempfile.TemporaryDirectory(prefix="physhdr-fuzz-", dir=_memory_folder()) as scratch:
        if arguments.replay:
            return _replay(arguments.replay, TARGETS, Path(scratch))
        chosen = [
            target
            for target in TARGETS
            if not arguments.only or any(text.lower() in target.name.lower() for text in arguments.only)
        ]
        wants_live = not arguments.only or any(text.lower() in LIVE for text in arguments.only)
        begun = time.monotonic()
        tallies = _try_all(chosen, arguments, Path(scratch))
        if wants_live:
            from fuzzing.live import attack

            tallies += attack(Path(scratch), arguments.seed, arguments.short)
    _table(tallies, time.monotonic() - begun, arguments.seed)
    findings = [finding for tally in tallies for finding in tally.findings.values()]
    for finding in findings:
        path = finding.write(arguments.findings)
        _say(f"\nFOUND by {finding.target}: {finding.kind}, {finding.where}")
        _say("  " + finding.detail.strip().replace("\n", "\n  ")[-1500:])
        again = (
            f"--replay {path}" if finding.case.form != "live" else f'--only "{LIVE}" --seed {finding.seed}'
        )
        _say(f"  python tests/stress/fuzz.py {again}")
    return 1 if findings or any(tally.broken for tally in tallies) else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, help=f"for all rows together (default {SECONDS:g})")
    parser.add_argument("--cases", type=int, help="for each row (default: each row's own)")
    parser.add_argument("--seed", type=int, default=0, help="other seeds make other cases")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="rows whose name has this")
    parser.add_argument("--short", action="store_true", help="a few seconds of each row")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes at once")
    parser.add_argument("--findings", type=Path, default=FINDINGS, help="folder for what is found")
    parser.add_argument("--replay", type=Path, nargs="+", metavar="FILE", help="try these again")
    return parser.parse_args()


def _try_all(targets: list[Target], arguments: argparse.Namespace, scratch: Path) -> list[Tally]:
    """Every row by one of ``--jobs`` processes; the rows as they are in ``targets``."""
    tallies = {target.name: Tally(target.name) for target in targets}
    waiting: queue.SimpleQueue[Target] = queue.SimpleQueue()
    for target in targets:
        waiting.put(target)
    deadline = time.monotonic() + (arguments.seconds or SECONDS)
    left, lock = [len(targets)], threading.Lock()

    def share() -> float:
        """Seconds for the next row: what is left, shared by the rows that are left."""
        with lock:
            seconds = (deadline - time.monotonic()) * arguments.jobs / left[0]
            left[0] -= 1
        return min(seconds, SHORT_SECONDS) if arguments.short else seconds

    def take_turns() -> None:
        worker = Worker(scratch)
        try:
            while True:
                target = waiting.get_nowait()
                count = arguments.cases or target.count
                if arguments.short and not arguments.cases:
                    count = max(20, int(SHORT_SHARE * count))
                order = Order(target.name, arguments.seed, 0, count, share())
                worker.run(target, order, tallies[target.name])
                _say(_line(tallies[target.name]))
        except queue.Empty:
            pass
        finally:
            worker.close()

    threads = [threading.Thread(target=take_turns) for _ in range(arguments.jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return list(tallies.values())


def _replay(paths: list[Path], targets: tuple[Target, ...], scratch: Path) -> int:
    """Try found cases again: one line each; returns 1 if one is still a finding."""
    known = {target.name: target for target in targets}
    worker, status = Worker(scratch), 0
    for path in paths:
        finding = read_finding(path)
        tally = Tally(finding.target)
        if finding.target not in known:
            _say(f"{path.name}: there is no row '{finding.target}'")
            status = 1
            continue
        order = Order(finding.target, finding.seed, finding.number, finding.number + 1, 600.0, finding.case)
        worker.run(known[finding.target], order, tally)
        outcome = ", ".join(tally.outcomes) or tally.broken or f"skipped: {tally.skipped}"
        bad = bool(tally.findings or tally.broken)
        _say(f"{path.name}: {'FOUND' if bad else 'right'}: {outcome}")
        for found in tally.findings.values():
            _say(f"  {found.where}\n  {found.detail}")
        status |= bad
    worker.close()
    return status


def _memory_folder() -> str | None:
    """Where files never meet a disk, if there is such a place."""
    place = Path("/dev/shm")
    return str(place) if place.is_dir() and os.access(place, os.W_OK) else None


def _line(tally: Tally) -> str:
    outcome = ", ".join(f"{count} {what}" for what, count in sorted(tally.outcomes.items()))
    for word, why in (("skipped", tally.skipped), ("BROKEN", tally.broken)):
        if why:
            outcome = f"{outcome}; " * bool(outcome) + f"{word}: {why}"
    return f"{tally.name:<30} {tally.tried:>7} {len(tally.findings):>8}  {tally.seconds:>5.0f} s  {outcome}"


def _table(tallies: list[Tally], seconds: float, seed: int) -> None:
    _say(f"\n{'attack':<30} {'count':>7} {'findings':>8}  {'time':>7}  outcome")
    for tally in tallies:
        _say(_line(tally))
    tried, found = sum(t.tried for t in tallies), sum(len(t.findings) for t in tallies)
    _say(f"{'together':<30} {tried:>7} {found:>8}  {seconds:>5.0f} s  seed {seed}")


def _say(line: str) -> None:
    sys.stdout.write(line.encode("utf-8", "backslashreplace").decode() + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
