#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Kills, starves, doubles and wears out PhysHDR, and reports how it held up.

    .venvs/backend/bin/python tests/stress/torture.py                     all of it: many hours of two cores
    .venvs/backend/bin/python tests/stress/torture.py --short             each attack a little: minutes
    .venvs/backend/bin/python tests/stress/torture.py --only 'kill-*' --trainings 10 --kills 10
    .venvs/backend/bin/python tests/stress/torture.py --only soak --soak-seconds 3600

Every attack has an oracle: what was killed is done again and must come out as if nothing had happened, bit
for bit; what was refused must say so in one message with a remedy; what was used for long must have given
everything back. The table is printed, and written to WORK/torture.md with the rows of earlier calls; the exit
status is 1 if an attack failed. If killed itself, it resumes: rows that are ok are not repeated without
--fresh, and killed trainings continue where they were.
"""

import argparse
import fnmatch
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from torture_attacks import full_disk, kill_commands, kill_training, soak, stranger, two_at_once
from torture_attacks.bench import (
    Bench,
    Options,
    Result,
    Row,
    Store,
    code_fingerprint,
    row_of,
    rows_in,
    table,
)
from torture_attacks.processes import BIN, ROOT, Program, Warm, WarmProgram

TABLE_FILE = "torture.md"
SHORT_SOAK = 20.0
#: Attacks of a short run that are made at the same time.
AT_ONCE = 3


@dataclass(frozen=True)
class Attack:
    """``what``: shown in the table. ``slow``: begun first in a short run, which does several at once."""

    what: str
    do: Callable[[Bench], Result]
    slow: bool = False


ATTACKS: dict[str, Attack] = {
    "kill-training": Attack(
        "SIGKILL at random and chosen moments of trainings, each then resumed", kill_training.kill_trainings
    ),
    "kill-overwrite": Attack(
        "SIGKILL as a run of another configuration replaces one", kill_training.kill_overwriting
    ),
    "kill-export": Attack("SIGKILL during export, done again", kill_commands.kill_export),
    "kill-evaluate": Attack("SIGKILL during evaluate, done again", kill_commands.kill_evaluate),
    "kill-video": Attack("SIGKILL during video, done again", kill_commands.kill_video),
    "kill-frames": Attack("SIGKILL during numbered pictures, done again", kill_commands.kill_frames),
    "kill-prepare": Attack("SIGKILL during prepare, done again", kill_commands.kill_prepare, True),
    "kill-benchmark": Attack("SIGKILL during a benchmark, then resumed", kill_commands.kill_benchmark, True),
    "kill-render": Attack("SIGKILL during make_scene.py, then resumed", kill_commands.kill_render, True),
    "disk-training": Attack("disk full at every write of a training", full_disk.disk_training),
    "disk-resume": Attack("disk full at every write of a resumed training", full_disk.disk_resume),
    "disk-export": Attack("disk full at every write of export", full_disk.disk_export),
    "disk-evaluate": Attack("disk full at every write of evaluate", full_disk.disk_evaluate),
    "disk-video": Attack("disk full at every write of video", full_disk.disk_video),
    "disk-frames": Attack("disk full at every write of numbered pictures", full_disk.disk_frames),
    "disk-prepare": Attack("disk full at every write of prepare", full_disk.disk_prepare, True),
    "disk-render": Attack("disk full at every write of make_scene.py", full_disk.disk_render, True),
    "two-trainings": Attack("two trainings on one folder", two_at_once.two_trainings),
    "two-readers": Attack("a checkpoint read all the time while it is written", two_at_once.two_readers),
    "two-renders": Attack("two make_scene.py on one folder", two_at_once.two_renders, True),
    "two-benchmarks": Attack("two benchmarks on one folder", two_at_once.two_benchmarks, True),
    "two-servers": Attack("two backends on one home", two_at_once.two_servers),
    "two-exports": Attack("two exports to one folder", two_at_once.two_exports),
    "stranger": Attack("a .blend that names everything that can be named, opened", stranger.open_stranger),
    "soak": Attack("previews, connections and trainings by one backend for long", soak.soak, True),
}


def main() -> int:
    given = parser().parse_args()
    chosen = [n for n in ATTACKS if not given.only or any(fnmatch.fnmatch(n, p) for p in given.only)]
    if not chosen:
        print(f"error: there is no such attack; choose from: {',  '.join(ATTACKS)}", file=sys.stderr)
        return 2
    if not (BIN / "physhdr").exists():
        print(f"error: there is no {BIN / 'physhdr'}: make setup", file=sys.stderr)
        return 2
    work = given.work.resolve() / ("short" if given.short else "full")
    for name in chosen:
        full_disk.unmount_all(work / name)
    end_on_signals(work, chosen)
    if given.short:
        shutil.rmtree(work, ignore_errors=True)
    for name in chosen if given.fresh else []:
        shutil.rmtree(work / name, ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    options = Options(
        short=given.short,
        seed=given.seed,
        data=given.data,
        trainings=given.trainings,
        kills=given.kills,
        threads=given.threads,
        jobs=given.jobs or max(1, (os.cpu_count() or 1) // given.threads),
        tries=given.tries,
        sizes=given.sizes,
        soak_seconds=given.soak_seconds or (SHORT_SOAK if given.short else 3600.0),
    )
    begun = time.monotonic()
    with Warm() if given.short else nullcontext() as warm:
        done = attack_all(chosen, work, options, warm)
    rows = sorted(rows_in(work), key=lambda row: list(ATTACKS).index(row.name) if row.name in ATTACKS else 99)
    shown = table([row for row in rows if row.name in chosen])
    (work / TABLE_FILE).write_text(table(rows), encoding="utf-8")
    print(f"\n{shown}\n{work / TABLE_FILE}")
    failed = [row.name for row in done if row.verdict == "FAILED"]
    say(f"{len(done)} attacks in {time.monotonic() - begun:.0f} s, {len(failed)} failed")
    return 1 if failed else 0


def end_on_signals(work: Path, names: list[str]) -> None:
    """CTRL-C and SIGTERM end it at once: what it started ends with it, what it mounted is unmounted."""

    def end(*_: object) -> None:
        for name in names:
            full_disk.unmount_all(work / name)
        os.write(2, b"\nstopped: repeat the command to resume\n")
        os._exit(130)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        description=(__doc__ or "").splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add = made.add_argument
    add("--only", nargs="+", metavar="NAME", help=f"of: {', '.join(ATTACKS)}; kill-* names several")
    add("--short", action="store_true", help="each attack a little, by commands that start at once")
    add("--data", type=Path, default=ROOT / "data" / "demo", help="what the full-size trainings train on")
    add("--work", type=Path, default=ROOT / "runs" / "torture", help="where everything is written")
    add("--seed", type=int, default=0)
    add("--trainings", type=int, default=10, help="full-size trainings that are killed")
    add("--kills", type=int, default=10, help="of each of them")
    add("--threads", type=int, default=1, help="of each of them: results depend on it by rounding")
    add("--jobs", type=int, default=0, help="of them at once; 0: as many as there are cores for")
    add("--tries", type=int, default=20, help="kills of the other commands")
    add("--sizes", type=int, default=40, help="of the disk that is full")
    add("--soak-seconds", type=float, default=0.0, help="0: an hour, or a short run's seconds")
    add("--fresh", action="store_true", help="do again what earlier calls have done")
    return made


def attack_all(names: list[str], work: Path, options: Options, warm: Warm | None) -> list[Row]:
    """The rows; in a short run several attacks at a time, because half of their time is waiting."""
    code = code_fingerprint()

    def start(*words: object, log: Path) -> Program:
        command = [BIN / "physhdr", *words]
        return WarmProgram(warm, command, log) if warm else Program(command, log)

    material = Store(work, options.short, start)
    before = {row.name: row for row in rows_in(work) if row.verdict == "ok" and row.code == code}

    def attack(name: str) -> Row:
        if name in before:
            say(f"{name:<15} done before: {before[name].outcome}")
            return before[name]
        say(f"{name:<15} {ATTACKS[name].what}")
        bench = Bench(name, work, options, material, warm, say)
        row = row_of(name, ATTACKS[name].what, ATTACKS[name].do, bench, code)
        row.write(bench.folder)
        say(f"{name:<15} {row.verdict} after {row.seconds:.0f} s: {row.count}: {row.outcome}")
        return row

    if not options.short:
        return [attack(name) for name in names]
    slow_first = sorted(names, key=lambda name: not ATTACKS[name].slow)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(attack, slow_first))


_printing = threading.Lock()


def say(text: str) -> None:
    with _printing:
        print(f"[{time.strftime('%H:%M:%S')}] {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
