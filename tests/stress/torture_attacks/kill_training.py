# SPDX-License-Identifier: GPL-3.0-or-later
"""SIGKILL to trainings, which then resume and must end as if nothing had happened, bit for bit."""

import hashlib
import json
import os
import shutil
import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .bench import PATIENCE, Bench, Result, code_fingerprint
from .oracle import (
    SkipError,
    badly_refused,
    checkpoint,
    different_tensors,
    events,
    lost_seconds,
    temporaries,
    tracebacks,
)
from .processes import Program

CHECKPOINT, CONFIG, LOG = "checkpoint.safetensors", "config.json", "log.jsonl"
BEGUN = "training from"
#: How often the killed trainings save, seconds; every fifth has the command's own default.
SECONDS_BETWEEN = 5.0
#: What a kill may cost, seconds, and in a short run. Saving takes a fiftieth of the time at most, so that the
#: command saves less often than requested if the disk is busy.
LOST_AT_MOST, LOST_IN_SHORT = 60.0, 15.0
#: What an undisturbed training may take, seconds, on a machine that is also doing other things.
LONG = 7200.0
#: Where chosen moments are looked for, how often: a small checkpoint is written in milliseconds.
FINE = 0.0005


@dataclass(frozen=True)
class Size:
    """Of the trainings that are killed."""

    data: Path
    words: tuple[object, ...]
    old_iterations: int
    seconds_between: float

    @property
    def key(self) -> str:
        identity = [str(self.data.resolve()), [str(word) for word in self.words], code_fingerprint()]
        return hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:10]


def size_of(bench: Bench) -> Size:
    options = bench.options
    if bench.short:
        words = ("--threads", options.threads, "--iterations", 250)
        return Size(bench.material.data, words, 40, 0.2)
    if options.data is None or not (options.data / "dataset.json").is_file():
        raise SkipError(f"there is no data set {options.data}: make demo, or give --data")
    return Size(options.data, ("--threads", options.threads), 60, SECONDS_BETWEEN)


def kill_trainings(bench: Bench) -> Result:
    """``trainings`` × ``kills``, several at a time; finished ones stay in the folder."""
    size = size_of(bench)
    kills = 4 if bench.short else bench.options.kills
    count = 1 if bench.short else bench.options.trainings
    home = bench.folder / size.key
    _old_run(bench, size, home)
    with ThreadPoolExecutor(1 if bench.short else bench.options.jobs) as pool:
        done = list(pool.map(lambda n: Killed(bench, size, home, n, kills).run(), range(count)))
    while _kills(done) < count * kills and len(done) < 2 * count:  # some ended too early
        done.append(Killed(bench, size, home, len(done), count * kills - _kills(done)).run())
    result = Result("kills", tries=_kills(done))
    at_most = LOST_IN_SHORT if bench.short else LOST_AT_MOST
    for each in done:
        result.complain(each["complaints"], f"seed {each['seed']}")
        result.complain(too_dear(each["kills"], at_most), f"seed {each['seed']}")
    blows = [kill for each in done for kill in each["kills"]]
    moments = {name: sum(blow["moment"] == name for blow in blows) for name in MOMENTS}
    cost = [blow["lost"] for blow in blows] or [0.0]
    identical = sum(each["identical"] for each in done)
    result.facts += [
        f"{identical} of {len(done)} trainings bit-identical with undisturbed ones",
        "kills: " + ", ".join(f"{number} {name}" for name, number in moments.items() if number),
        f"{sum(blow['saved'] is None for blow in blows)} before the first checkpoint",
        f"a kill cost {statistics.median(cost):.1f} s of training, {max(cost):.1f} s at most",
    ]
    return result


def too_dear(kills: list[dict[str, Any]], at_most: float) -> list[str]:
    """Complaints of kills that cost more seconds of training than they may."""
    return [
        f"a kill ({kill['moment']}) cost {kill['lost']:.1f} s" for kill in kills if kill["lost"] > at_most
    ]


def _kills(done: list[dict[str, Any]]) -> int:
    return sum(len(each["kills"]) for each in done)


def _old_run(bench: Bench, size: Size, home: Path) -> None:
    """A finished training of another configuration, to be overwritten."""
    old = home / "old"
    if not (old / "done").exists():
        words = ("--preset", "fast", "--seed", 999, *_without_iterations(size.words))
        words = ("train", size.data, "--out", old, "--overwrite", *words)
        bench.must(bench.physhdr(*words, "--iterations", size.old_iterations, log=home / "old.log"))
        (old / "done").touch()


def _without_iterations(words: tuple[object, ...]) -> tuple[object, ...]:
    return words[: words.index("--iterations")] if "--iterations" in words else words


MOMENTS = ("random", "overwriting", "begun", "saving", "final")


class Killed:
    """One training, its undisturbed twin, and the ledger of what was done to it."""

    def __init__(self, bench: Bench, size: Size, home: Path, number: int, kills: int) -> None:
        self.bench, self.size, self.kills = bench, size, kills
        self.seed = 100 + number
        self.folder, self.twin = home / f"seed_{self.seed}", home / f"undisturbed_{self.seed}"
        self.old, self.log = home / "old", home / f"seed_{self.seed}.log"
        self._ledger = home / f"seed_{self.seed}.json"
        self.options: tuple[object, ...] = ("--checkpoint-seconds", size.seconds_between)
        if number % 5 == 4 and not bench.short:
            self.options = ()
        self.state: dict[str, Any] = {"seed": self.seed, "kills": [], "complaints": [], "identical": False}
        with suppress(OSError, ValueError):
            self.state = json.loads(self._ledger.read_text(encoding="utf-8"))
        self.rng = np.random.default_rng([bench.options.seed, self.seed, len(self.state["kills"])])

    def run(self) -> dict[str, Any]:
        if self.state.get("done"):
            self._say("done before")
            return self.state
        self._train_the_twin()
        self.total = int(checkpoint(self.twin / CHECKPOINT)[1]["iteration"])
        if not self.folder.exists():
            shutil.copytree(self.old, self.folder)
        tries, ended = 0, False
        while len(self.state["kills"]) < self.kills and tries < 3 * self.kills and not ended:
            tries += 1
            ended = not self._strike(self._next_moment())
        if not ended:
            self._strike("final")
        self._finish()
        return self.state

    # -- the undisturbed one ---------------------------------------------------------------------------

    def _train_the_twin(self) -> None:
        done = self.twin / "undisturbed.json"
        if not done.exists():
            self._say("the undisturbed training")
            words = ("--seed", self.seed, *self.size.words)
            program = self.bench.physhdr(
                "train", self.size.data, "--out", self.twin, "--overwrite", *words, log=self.log
            )
            self.bench.must(program, LONG)
            begun = next(e["time"] for e in events(self.twin / LOG) if e["event"] == "started")
            took = {"startup": begun - program.started, "training": time.time() - begun}
            done.write_text(json.dumps(took), encoding="utf-8")
        took = json.loads(done.read_text(encoding="utf-8"))
        self.startup, self.takes = took["startup"], took["training"]

    # -- one kill --------------------------------------------------------------------------------------

    def _next_moment(self) -> str:
        """The first is a new run over an old one; of the others two have a chosen moment."""
        done = [kill["moment"] for kill in self.state["kills"]]
        if self._is_the_old_run():
            return "overwriting"
        left = [moment for moment in ("begun", "saving") if moment not in done]
        if self.bench.short and "begun" in left:
            left.remove("begun")  # so that one of few kills comes at a random time
        chosen = left and (len(done) + len(left) >= self.kills or self.rng.random() < 0.3)
        return str(self.rng.choice(left)) if chosen else "random"

    def _strike(self, moment: str) -> bool:
        """Resume and be killed; False if the training ended before."""
        left_behind = temporaries(self.folder)
        program = self._resume()
        landed = self._wait_and_kill(program, moment)
        killed = time.time()
        output = program.output()
        if BEGUN in output and (stale := [path for path in left_behind if _is_older(path, program.started)]):
            self._complain([f"the next start left {stale[0].name} of the killed one"])
        if not landed:
            if program.poll() not in (0, None):
                self._complain([f"it ended with {program.poll()}: {output.strip()[-300:]}"])
                return False
            return program.poll() is None
        self._judge(moment, program, killed)
        return True

    def _resume(self) -> Program:
        """``--resume``, or from the beginning if there is nothing to resume."""
        words = ("--threads", self.bench.options.threads, *self.options)
        ours = not self._is_the_old_run() and (self.folder / CONFIG).exists()
        if ours and (self.folder / CHECKPOINT).exists():
            program = self.bench.physhdr("train", "--resume", self.folder, *words, log=self.log)
            if not self._has_old_weights():
                return program
            # The replaced run has left its weights: resuming from them would be another training.
            if program.until(lambda: BEGUN in program.output(), PATIENCE):
                self._complain(["old weights were resumed under a new configuration"])
                program.kill()
            else:
                self._complain(badly_refused(program.poll() or 0, program.output(), str(self.folder)))
        words = ("--seed", self.seed, *self.size.words, *self.options)
        return self.bench.physhdr(
            "train", self.size.data, "--out", self.folder, "--overwrite", *words, log=self.log
        )

    def _is_the_old_run(self) -> bool:
        with suppress(OSError):
            return (self.folder / CONFIG).read_bytes() == (self.old / CONFIG).read_bytes()
        return False

    def _has_old_weights(self) -> bool:
        with suppress(OSError):
            return (self.folder / CHECKPOINT).read_bytes() == (self.old / CHECKPOINT).read_bytes()
        return False

    def _wait_and_kill(self, program: Program, moment: str) -> bool:
        """Whether the kill came before the end."""
        patience = 10.0 * (self.startup + self.takes) + PATIENCE
        if moment == "random":
            left = max(1, self.kills - len(self.state["kills"]))
            remaining = self.takes * (1.0 - self._iteration() / self.total)
            time_until = self.rng.uniform(0.0, self.startup + 2.0 * remaining / (left + 1))
            program.until(lambda: False, time_until, every=0.005)
            return program.kill()
        if moment == "begun":
            program.until(lambda: BEGUN in program.output(), patience, every=0.005)
        elif moment == "overwriting":
            watched = CONFIG if self.rng.random() < 0.5 else CHECKPOINT
            before = _stamp(self.folder / watched)
            program.until(lambda: _stamp(self.folder / watched) != before, patience, FINE)
        elif moment == "saving":
            program.until(lambda: BEGUN in program.output(), patience, every=0.005)
            program.until(self._is_saving, patience, FINE)
        else:
            log = self.folder / LOG
            program.until(lambda: BEGUN in program.output(), patience, every=0.005)
            program.until(lambda: self._last_told(log) >= self.total, patience, every=0.002)
            program.until(self._is_saving, 5.0, FINE)
        return program.kill()

    def _is_saving(self) -> bool:
        with suppress(OSError), os.scandir(self.folder) as entries:
            return any(
                "checkpoint" in entry.name and entry.name != CHECKPOINT and "lock" not in entry.name
                for entry in entries
            )
        return False

    def _last_told(self, log: Path) -> int:
        """The iteration of the log's last lines."""
        with suppress(OSError, ValueError, IndexError):
            with open(log, "rb") as file:
                file.seek(max(0, log.stat().st_size - 4096))
                lines = file.read().decode("utf-8", "replace").splitlines()
            last = [json.loads(line) for line in lines[-2:] if line.startswith("{") and line.endswith("}")]
            return max(event["iteration"] for event in last)
        return 0

    # -- what is left ----------------------------------------------------------------------------------

    def _iteration(self) -> int:
        """The iteration of the folder's checkpoint; 0 without one, or with another run's."""
        if self._is_the_old_run() or not (self.folder / CHECKPOINT).exists():
            return 0
        with suppress(Exception):
            return int(checkpoint(self.folder / CHECKPOINT)[1]["iteration"])
        return 0

    def _judge(self, moment: str, program: Program, killed: float) -> None:
        path, saved = self.folder / CHECKPOINT, None
        self._complain(tracebacks(program.output()))
        if path.exists():
            try:
                saved = int(checkpoint(path)[1]["iteration"])
            except Exception as error:  # noqa: BLE001 (whatever it is, a kill must not damage a checkpoint)
                self._complain([f"after a kill ({moment}) {path} is damaged: {error}"])
        logged = [event for event in events(self.folder / LOG) if event["time"] >= program.started]
        old = self._has_old_weights() or self._is_the_old_run()
        lost = 0.0 if old else lost_seconds(logged, saved or 0, killed)
        blow = {"moment": moment, "saved": None if old else saved, "lost": lost, "time": killed}
        self.state["kills"].append(blow)
        self._write()
        self._say(
            f"kill {len(self.state['kills'])}, {moment}: at {saved or 0}/{self.total}, {lost:.1f} s lost"
        )

    def _finish(self) -> None:
        for number in range(3):
            if number and self._iteration() >= self.total:
                break  # one start at least, which tidies up after the last kill
            self._complain(self.bench.done(self._resume(), LONG))
        differing = different_tensors(self.folder / CHECKPOINT, self.twin / CHECKPOINT)
        self._complain(differing)
        if (self.folder / CONFIG).read_bytes() != (self.twin / CONFIG).read_bytes():
            self._complain(["its config.json is not the undisturbed one's"])
        if left := temporaries(self.folder):
            self._complain([f"{left[0].name} is left at the end"])
        self.state |= {"identical": not differing, "done": True}
        self._write()
        self._say("bit-identical with the undisturbed training" if not differing else "NOT identical")

    def _complain(self, complaints: list[str]) -> None:
        for complaint in complaints:
            self._say(f"COMPLAINT: {complaint}")
        self.state["complaints"] += complaints
        self._write()

    def _write(self) -> None:
        pending = self._ledger.with_suffix(".partial")
        pending.write_text(json.dumps(self.state, indent=1), encoding="utf-8")
        os.replace(pending, self._ledger)

    def _say(self, text: str) -> None:
        self.bench.say(f"seed {self.seed}: {text}")


def _stamp(path: Path) -> tuple[int, int] | None:
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_mtime_ns
    return None


def _is_older(path: Path, moment: float) -> bool:
    with suppress(OSError):
        return path.stat().st_mtime < moment
    return False


# ---- a run that replaces another one ---------------------------------------------------------------------


def kill_overwriting(bench: Bench) -> Result:
    """A finished run is replaced by one of another configuration, which is killed as it begins.

    What is in the folder afterwards is the old run or the new one, never the one's weights under the other's
    configuration: whatever --resume does with it ends as one of the two would have ended.
    """
    data, threads = bench.material.data, ("--threads", 1)
    old_words = ("train", data, "--iterations", 60, *threads)
    new_words = ("train", data, "--preset", "fast", "--seed", 77, "--iterations", 90, *threads)
    old, new = bench.empty("old"), bench.empty("new")
    bench.must(bench.physhdr(*old_words, "--out", old))
    bench.must(bench.physhdr(*new_words, "--out", new))
    result = Result("kills")
    run = bench.folder / "run"
    for number in range(1 if bench.short else bench.options.tries):
        shutil.rmtree(run, ignore_errors=True)
        shutil.copytree(old, run)
        where = ("config", "checkpoint", "begun", "any")[number % 4]
        program = bench.physhdr(*new_words, "--out", run, "--overwrite")
        stamps = {name: _stamp(run / name) for name in (CONFIG, CHECKPOINT)}
        if where in ("config", "checkpoint"):
            name = CONFIG if where == "config" else CHECKPOINT
            program.until(lambda n=name, s=stamps: _stamp(run / n) != s[n], PATIENCE, FINE)
        elif where == "begun":
            program.until(lambda p=program: BEGUN in p.output(), PATIENCE, FINE)
        else:
            program.until(lambda p=program: "computing" in p.output(), PATIENCE, FINE)
            program.until(lambda: False, bench.rng.uniform(0.0, 1.0), FINE)
        result.tries += program.kill()
        result.complain(_judge_overwritten(bench, run, old, new), f"killed at '{where}'")
        bench.say(f"{number + 1}, {where}: {len(result.complaints)} complaints")
        again = bench.physhdr(*new_words, "--out", run, "--overwrite")
        result.complain(bench.done(again) or different_tensors(run / CHECKPOINT, new / CHECKPOINT), "again")
    return result


def _judge_overwritten(bench: Bench, run: Path, old: Path, new: Path) -> list[str]:
    config = (run / CONFIG).read_bytes() if (run / CONFIG).exists() else b""
    twin = next((each for each in (old, new) if (each / CONFIG).read_bytes() == config), None)
    if config and twin is None:
        return ["config.json is neither the old run's nor the new one's"]
    is_old_weights = (run / CHECKPOINT).exists() and (
        (run / CHECKPOINT).read_bytes() == (old / CHECKPOINT).read_bytes()
    )
    may_open = twin is not None and (run / CHECKPOINT).exists() and (twin is old or not is_old_weights)
    complaints = []
    exported = bench.physhdr("export", run, bench.empty("exported"))
    status = exported.wait(PATIENCE)
    if may_open:
        complaints += bench.done(exported)
    else:
        complaints += [f"export: {c}" for c in badly_refused(status, exported.output(), str(run))]
    resumed = bench.physhdr("train", "--resume", run, "--threads", 1)
    status = resumed.wait(PATIENCE)
    if status == 0 and twin is not None:
        complaints += [f"resumed: {c}" for c in different_tensors(run / CHECKPOINT, twin / CHECKPOINT)]
    elif may_open:
        complaints += bench.done(resumed)
    else:
        complaints += [f"resume: {c}" for c in badly_refused(status, resumed.output(), str(run))]
    return complaints
