# SPDX-License-Identifier: GPL-3.0-or-later
"""The same thing started twice at once, and readers beside a writer."""

import re
import shutil
import threading
import time
from collections.abc import Callable

from . import commands
from .bench import PATIENCE, Bench, Result
from .kill_training import BEGUN, CHECKPOINT
from .oracle import (
    badly_ended,
    badly_refused,
    checkpoint,
    different_folders,
    different_tensors,
    temporaries,
)
from .processes import Program


def _names(output: str, program: Program) -> list[str]:
    """Whether a refusal says who holds the folder."""
    if re.search(rf"\b{program.pid}\b", output):
        return []
    return [f"the refusal does not name process {program.pid}, which holds it"]


# ---- trainings -------------------------------------------------------------------------------------------


def _hold_until_the_other_ends(first: Program, other: Program) -> None:
    """Stop whichever of two trainings begins, so that the other finds the folder held however slow it is."""

    def begun() -> list[Program]:
        return [program for program in (first, other) if BEGUN in program.output()]

    if first.until(lambda: bool(begun()) or other.poll() is not None, PATIENCE, 0.001):
        for holder in begun()[:1]:
            with holder.held():
                (other if holder is first else first).wait(PATIENCE)


def two_trainings(bench: Bench) -> Result:
    """One holds the folder, the other is refused with the first one's name; the first ends as if alone."""
    data, threads = bench.material.data, ("--threads", 1)
    # The first must still train when the other has loaded torch. In a short run it is held until then.
    count = 200 if bench.short else 3000
    # It saves often: there must be something to resume long before it ends.
    often = ("--checkpoint-seconds", 0.2)
    first_words = ("train", data, "--iterations", count, "--seed", 1, *often, *threads)
    other_words = ("train", data, "--iterations", count, "--seed", 2, *threads)
    references = [bench.empty("reference_1"), bench.empty("reference_2")]
    for words, reference in zip((first_words, other_words), references, strict=True):
        bench.must(bench.physhdr(*words, "--out", reference))
    result = Result("times")
    run = bench.folder / "run"
    for number in range(2 if bench.short else 12):
        how = ("overwriting", "at the same time", "resuming")[number % 3]
        shutil.rmtree(run, ignore_errors=True)
        first = bench.physhdr(*first_words, "--out", run, "--overwrite", log=bench.folder / "first.log")
        if how != "at the same time":
            first.until(lambda p=first: BEGUN in p.output(), PATIENCE, 0.001)
        if how == "resuming":
            first.until(lambda: (run / CHECKPOINT).exists(), PATIENCE, 0.001)
            words: tuple[object, ...] = ("train", "--resume", run, *threads)
        else:
            words = (*other_words, "--out", run, "--overwrite")
        other = bench.physhdr(*words, log=bench.folder / "other.log")
        if bench.short:
            _hold_until_the_other_ends(first, other)
        ended = [first.wait(PATIENCE), other.wait(PATIENCE)]
        result.tries += 1
        if how == "at the same time" and ended[0] != 0:  # then the other one had it first
            pair, reference = (other, first), references[1]
            ended.reverse()
        else:
            pair, reference = (first, other), references[0]
        complaints = badly_ended(ended[0], pair[0].output())
        complaints += badly_refused(ended[1], pair[1].output(), str(run)) or _names(pair[1].output(), pair[0])
        complaints += different_tensors(run / CHECKPOINT, reference / CHECKPOINT)
        complaints += [f"{path.name} is left" for path in temporaries(run)]
        result.complain(complaints, how)
        bench.say(f"{number + 1}, {how}: {len(complaints)} complaints")
    return result


def two_readers(bench: Bench) -> Result:
    """A training that saves all the time; its checkpoint is read all the time, exported and evaluated."""
    data, run = bench.material.data, bench.empty("run")
    count = 400 if bench.short else 3000
    program = bench.physhdr(
        *("train", data, "--out", run, "--iterations", count, "--threads", 1),
        *("--checkpoint-seconds", 0.05),
        log=bench.folder / "train.log",
    )
    result = Result("reads")
    ended, seen, opened = threading.Event(), set(), 0

    def read() -> None:
        while not ended.is_set():
            if not (run / CHECKPOINT).exists():
                time.sleep(0.01)
                continue
            try:
                seen.add(int(checkpoint(run / CHECKPOINT)[1]["iteration"]))
            except Exception as error:  # noqa: BLE001 (no reader may ever see half a checkpoint)
                result.complain([f"{type(error).__name__}: {error}"], "reading")
            result.tries += 1
            time.sleep(0.002)

    reader = threading.Thread(target=read, name="reader", daemon=True)
    reader.start()
    try:
        program.until((run / CHECKPOINT).exists, PATIENCE)
        while program.poll() is None or not opened:
            for name, *option in (("export",), ("evaluate", "--out")):
                reading = bench.physhdr(name, run, *option, bench.folder / name)
                result.complain(bench.done(reading), name)
                opened += 1
            if len(result.complaints) > 20:
                break
        result.complain(badly_ended(program.wait(PATIENCE), program.output()), "train")
    finally:
        ended.set()
        reader.join(30.0)
    result.facts.append(f"{len(seen)} different checkpoints seen, {opened} commands beside the training")
    return result


# ---- other commands --------------------------------------------------------------------------------------


def _two(make: Callable[[Bench], commands.Command], times: int) -> Callable[[Bench], Result]:
    """Two of one command into one folder: both end well, and what they made is what one would have made."""

    def attack(bench: Bench) -> Result:
        command = make(bench)
        out, reference = bench.empty("out"), commands.reference_of(bench, command).folder
        result = Result("times")
        for number in range(1 if bench.short else times):
            shutil.rmtree(out, ignore_errors=True)
            pair = [command.start(out)]
            time.sleep(float(bench.rng.uniform(0.0, 1.0)) if number % 2 else 0.0)
            pair.append(command.start(out))
            for program in pair:
                result.complain(badly_ended(program.wait(PATIENCE), program.output()), f"pair {number + 1}")
            result.complain(different_folders(out, reference, command.varying), f"pair {number + 1}")
            result.complain([f"{path} is left" for path in temporaries(out)], f"pair {number + 1}")
            result.tries += 1
            bench.say(f"pair {number + 1}: {len(result.complaints)} complaints")
        return result

    return attack


two_exports = _two(commands.export, 10)
two_renders = _two(commands.render, 4)
two_benchmarks = _two(commands.benchmark, 4)


def two_servers(bench: Bench) -> Result:
    """The second is refused with the name of the one that serves the home; the first continues."""
    result = Result("times")
    for number in range(1 if bench.short else 10):
        home = bench.empty("home")
        words = ("serve", "--home", home, "--threads", 1)
        first = bench.physhdr(*words, "--log", home / "backend.log", log=bench.folder / "first.log")
        if number % 2 == 0:
            first.until((home / "connection.json").exists, PATIENCE)
        other = bench.physhdr(*words, "--log", home / "other.log", log=bench.folder / "other.log")
        if number % 2:  # which of two that start together comes first is open
            first.until(lambda p=first, o=other: o.poll() is not None or p.poll() is not None, PATIENCE)
            if first.poll() is not None:
                first, other = other, first
        complaints = badly_refused(other.wait(60.0), other.output(), str(home))
        if number % 2 == 0:
            complaints += _names(other.output(), first)
        if first.poll() is not None:
            complaints.append(f"the first one ended as well, with {first.poll()}")
        first.interrupt()
        complaints += badly_ended(first.wait(60.0), first.output())
        result.complain(complaints, f"pair {number + 1}")
        result.tries += 1
    return result
