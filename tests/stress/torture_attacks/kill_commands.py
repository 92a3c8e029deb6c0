# SPDX-License-Identifier: GPL-3.0-or-later
"""SIGKILL to commands that write files; the same command again makes what an undisturbed one would have."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from . import commands
from .bench import Bench, Result
from .commands import CHANGES_EVERY, Changes, Command, Reference, reference_of
from .oracle import different_folders, temporaries, tracebacks, unfinished_finals
from .processes import Program

#: How long processes of a killed command may live on.
ORPHANS_END = 20.0


def kill(make: Callable[[Bench], Command]) -> Callable[[Bench], Result]:
    """The attack on a command: at a random time and at a change of its folder, in turn."""

    def attack(bench: Bench) -> Result:
        command = make(bench)
        undisturbed = reference_of(bench, command)
        out, reference = bench.empty("out"), undisturbed.folder
        result = Result("kills")
        left: list[str] = []
        for number in range(_tries(bench, command)):
            if number % 2 == 0:
                shutil.rmtree(out, ignore_errors=True)
            program = command.start(out)
            where = _kill(bench, program, out, number, undisturbed)
            if where is None:
                result.complain(tracebacks(program.output()))
            else:
                result.tries += 1
            label = f"killed {where or 'too late'}"
            result.complain(unfinished_finals(out, reference, command.varying), label)
            result.complain(bench.done(command.start(out)), f"{label}, again")
            result.complain(different_folders(out, reference, command.varying), f"{label}, again")
            now = [path.name for path in temporaries(bench.folder)]
            left = max(left, now, key=len)
            result.complain(_orphans(out), label)
            bench.say(f"{result.tries}, {label}: {len(result.complaints)} complaints")
        if left:
            shown = ", ".join(left[:2])
            result.facts.append(f"up to {len(left)} temporary files of killed ones stay, such as {shown}")
        return result

    return attack


def _tries(bench: Bench, command: Command) -> int:
    if bench.short:
        return 1
    slow = command.name in ("prepare", "benchmark", "render")
    return max(4, bench.options.tries // 2) if slow else bench.options.tries


def _kill(bench: Bench, program: Program, out: Path, number: int, undisturbed: Reference) -> str | None:
    """In words when; None where it had ended. Every third time the first process alone is killed."""
    alone, took, changes = number % 3 == 2, undisturbed.seconds, undisturbed.changes
    if number % 2 == 0 and changes:
        wanted = int(bench.rng.integers(1, changes + 1))
        watched = Changes(out)
        program.until(lambda: watched.look() or watched.count >= wanted, 3.0 * took + 30.0, CHANGES_EVERY)
        where = f"at change {wanted} of {changes}"
    else:
        moment = float(bench.rng.uniform(0.1, 1.0)) * took
        program.until(lambda: False, moment, CHANGES_EVERY)
        where = f"after {moment:.1f} s of {took:.1f}"
    if not program.kill(group=not alone):
        return None
    return where + (", its children not" if alone else "")


def _orphans(out: Path) -> list[str]:
    """Processes that still work for a command that was killed and done again."""
    deadline = time.monotonic() + ORPHANS_END
    while found := _working_on(out):
        if time.monotonic() > deadline:
            for process in found:
                process.kill()
            return [f"process {found[0].pid} still works for the killed one"]
        time.sleep(0.2)
    return []


def _working_on(out: Path) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline", "status"]):
        words = process.info["cmdline"] or []
        ours = any(str(word).startswith(str(out)) for word in words)
        if ours and process.info["status"] != psutil.STATUS_ZOMBIE:
            found.append(process)
    return found


kill_export = kill(commands.export)
kill_evaluate = kill(commands.evaluate)
kill_video = kill(commands.video)
kill_frames = kill(commands.frames)
kill_prepare = kill(commands.prepare)
kill_benchmark = kill(commands.benchmark)
kill_render = kill(commands.render)
