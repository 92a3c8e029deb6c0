# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that are killed, starved of space and started twice: each with its output's folder."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from .bench import Bench, module_of
from .oracle import SkipError
from .processes import ROOT, Program

#: What logs and records of times hold differs from run to run.
BENCHMARK_VARYING = ("*/log.jsonl", "*/benchmark.log", "*/tensorboard/*", "*/run.json", "report.*", "facts/*")


@dataclass(frozen=True)
class Command:
    """``start(out)`` begins it. ``varying``: names of files whose content differs between equal runs."""

    name: str
    start: Callable[[Path], Program]
    varying: tuple[str, ...] = ()
    warm: bool = True


def export(bench: Bench) -> Command:
    run = bench.material.run
    return Command("export", lambda out: bench.physhdr("export", run, "--out", out))


def evaluate(bench: Bench) -> Command:
    run = bench.material.run
    return Command("evaluate", lambda out: bench.physhdr("evaluate", run, "--out", out))


def video(bench: Bench) -> Command:
    for package, words in (("av", "the package av, which writes videos"),):
        if find_spec(package) is None:
            raise SkipError(f"there is no {words}")
    run = bench.material.run
    frames = ("--seconds", 0.5 if bench.short else 3, "--fps", 10, "--sweep", "exposure")

    def start(out: Path) -> Program:
        out.mkdir(parents=True, exist_ok=True)
        return bench.physhdr("video", run, "--out", out / "video.mp4", "--frames", out / "frames", *frames)

    return Command("video", start)


def prepare(bench: Bench) -> Command:
    if find_spec("pycolmap") is None:
        raise SkipError("there is no pycolmap, which finds the cameras")
    photos = bench.work / "material" / "photos"
    if not (photos / "done").exists() and not (photos.parent / "photos.done").exists():
        shutil.rmtree(photos, ignore_errors=True)
        photos.parent.mkdir(parents=True, exist_ok=True)
        room = module_of(ROOT / "tests" / "backend" / "scene" / "capture" / "room.py")
        room.write_brackets(photos, room.photograph(6))
        (photos.parent / "photos.done").touch()

    def start(out: Path) -> Program:
        # A process of its own: COLMAP's threads and a fork do not go together.
        return bench.cold("prepare", photos, "--out", out / "data", "--threads", 1, "--overwrite")

    return Command("prepare", start)


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
