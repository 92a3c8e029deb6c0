# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that are killed, starved of space and started twice: each with its output's folder."""

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from .bench import PATIENCE, Bench, module_of
from .oracle import SkipError, finals
from .processes import ROOT, Program

#: Disks allocate bytes in pages of this many.
PAGE = 4096
#: How often a folder is looked at for a change, seconds.
CHANGES_EVERY = 0.001
#: It names the folder that it was made in.
PREPARE_VARYING = ("data/prepare.json",)
#: Logs and records of times differ from run to run.
BENCHMARK_VARYING = ("*/log.jsonl", "*/benchmark.log", "*/tensorboard/*", "*/run.json", "report.*", "facts/*")


@dataclass(frozen=True)
class Command:
    """``start(out)`` begins it. ``varying``: names of files whose content differs between equal runs."""

    name: str
    start: Callable[[Path], Program]
    varying: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reference:
    """An undisturbed command's output: its folder, seconds, and how often the folder changed meanwhile."""

    folder: Path
    seconds: float
    changes: int

    @property
    def size(self) -> int:
        """Bytes on a disk of pages."""
        return sum(-(-path.stat().st_size // PAGE) * PAGE for path in finals(self.folder))


def reference_of(bench: Bench, command: Command) -> Reference:
    """Made once for all attacks on the command."""
    home = bench.made / command.name
    record = home / "reference.json"
    with bench.making(command.name):
        if not record.exists():
            shutil.rmtree(home, ignore_errors=True)
            begun = time.monotonic()
            changes = Changes(home / "out")
            program = command.start(home / "out")
            program.until(changes.look, PATIENCE, CHANGES_EVERY)
            bench.must(program)
            took = {"seconds": time.monotonic() - begun, "changes": changes.count}
            record.write_text(json.dumps(took), encoding="utf-8")
        return Reference(home / "out", **json.loads(record.read_text(encoding="utf-8")))


class Changes:
    """Counts how often the files in a folder changed (more, fewer, other names)."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.count = folder, 0
        self._seen = self._names()

    def _names(self) -> frozenset[str]:
        """Of the folder and of hidden ones beside it, which become it."""
        names = [path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*")]
        beside = self.folder.parent.glob(f".{self.folder.name}*")
        return frozenset([*names, *(path.name for path in beside)])

    def look(self) -> bool:
        """Always False: for ``Program.until``, which then looks until the program's end."""
        try:
            names = self._names()
        except OSError:  # a folder went away while it was listed: that is a change as well
            names = frozenset()
        if names != self._seen:
            self.count += 1
            self._seen = names
        return False


def export(bench: Bench) -> Command:
    run = bench.material.run
    return Command("export", lambda out: bench.physhdr("export", run, out))


def evaluate(bench: Bench) -> Command:
    run = bench.material.run
    return Command("evaluate", lambda out: bench.physhdr("evaluate", run, "--out", out))


def video(bench: Bench) -> Command:
    if find_spec("av") is None:
        raise SkipError("there is no package av, which writes videos")
    # The encoder's threads may round differently; ``frames`` compares what it is given.
    return Command("video", _flight(bench, "video.mp4"), varying=("*.mp4",))


def frames(bench: Bench) -> Command:
    return Command("frames", _flight(bench, "frames"))


def _flight(bench: Bench, name: str) -> Callable[[Path], Program]:
    run = bench.material.run
    words = ("--seconds", 0.5 if bench.short else 3, "--fps", 10, "--sweep", "exposure")

    def start(out: Path) -> Program:
        out.mkdir(parents=True, exist_ok=True)
        return bench.physhdr("render", run, "--out", out / name, *words)

    return start


def prepare(bench: Bench) -> Command:
    if find_spec("pycolmap") is None:
        raise SkipError("there is no pycolmap, which finds the cameras")
    photos = bench.made / "photos" / "brackets"
    with bench.making("photos"):
        if not (photos.parent / "done").exists():
            shutil.rmtree(photos, ignore_errors=True)
            photos.parent.mkdir(parents=True, exist_ok=True)
            room = module_of(ROOT / "tests" / "backend" / "scene" / "capture" / "room.py")
            room.write_brackets(photos, room.photograph(6))
            (photos.parent / "done").touch()

    def start(out: Path) -> Program:
        # A process of its own: COLMAP's threads and a fork do not go together.
        return bench.cold("prepare", photos, "--out", out / "data", "--threads", 1, "--overwrite")

    return Command("prepare", start, PREPARE_VARYING)


def benchmark(bench: Bench) -> Command:
    data = bench.material.data
    seeds, iterations = ("0", 30) if bench.short else ("0,1", 150)
    words = ("--methods", "default", "--scenes", f"tiny={data}", "--seeds", seeds)
    words += ("--budget", f"iterations={iterations}", "--threads-per-job", 1)

    def start(out: Path) -> Program:
        return bench.physhdr("benchmark", "--out", out, *words)

    return Command("benchmark", start, BENCHMARK_VARYING)


def render(bench: Bench) -> Command:
    size, views, workers = (16, 2, 1) if bench.short else (48, 6, 2)
    words = ("--resolution", size, "--samples", 2, "--views", views, "--lit-views", 0)
    words += ("--relit-views", 1, "--ambient-levels", 4, "--workers", workers)
    return Command("render", lambda out: bench.make_scene("--out", out, *words))
