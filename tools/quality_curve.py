#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Quality per second: train presets on a data set and plot their PSNR on its test views against time.

    .venvs/backend/bin/python tools/quality_curve.py --data DATA --out runs/quality

Writes OUT/quality.json and OUT/quality.png (``--figure``: elsewhere). Seconds are those of training, the
first points included; measuring and the compilation of kernels are not counted. A preset that is finished is
not trained again; one that was interrupted goes on from its last measurement.
"""

import argparse
import dataclasses
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

# torch's OpenMP threads must not spin between operations: they would take the kernels' cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import torch
from quality_plot import plot

from physhdr.backend.cli.kernels import compile_kernels
from physhdr.backend.evaluate import truth
from physhdr.backend.evaluate.metrics import hdr_pair, psnr, quantise
from physhdr.backend.evaluate.published import data_set_of
from physhdr.backend.methods.base import Method
from physhdr.backend.rasterize.cpu import set_threads, thread_count
from physhdr.backend.scene import Scene, read_scene
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import CHECKPOINT_FILE, Trainer

ROOT = Path(__file__).resolve().parent.parent
#: The figure's presets, the quickest first.
CURVES = ("fast", "default", "baseline", "hdr-gs-short", "paper-short", "gausshdr-short")
#: Measurements of a run: at these shares of its iterations squared, so that the steep start is seen well.
MEASUREMENTS = 16
RECORD = "curve.json"


def main() -> int:
    parser = argparse.ArgumentParser(description="Plot test PSNR of presets against seconds of training.")
    parser.add_argument("--data", type=Path, required=True, help="folder of a data set with test views")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "quality", help="folder of the runs")
    parser.add_argument("--presets", nargs="+", default=CURVES, choices=PRESETS)
    parser.add_argument("--figure", type=Path, help="where the figure goes; default: OUT/quality.png")
    parser.add_argument(
        "--iterations", nargs="+", default=[], metavar="PRESET=N", help="instead of a preset's"
    )
    parser.add_argument("--measurements", type=int, default=MEASUREMENTS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0, help="CPU threads; default: one for each core")
    arguments = parser.parse_args()
    if arguments.threads:
        set_threads(arguments.threads)
        torch.set_num_threads(arguments.threads)
    lengths = {name: int(n) for name, _, n in (text.partition("=") for text in arguments.iterations)}

    scene = read_scene(arguments.data)
    curves = {}
    for preset in arguments.presets:
        config = dataclasses.replace(PRESETS[preset], seed=arguments.seed)
        config = dataclasses.replace(config, iterations=lengths.get(preset, config.iterations))
        curves[preset] = train_curve(scene, config, arguments.out / preset, arguments.measurements)
        last = curves[preset]["points"][-1]
        measured = ", ".join(f"{name} {last[name]:.2f} dB" for name in ("LDR-OE", "HDR") if name in last)
        say(f"{preset}: {last['seconds']:.0f} s, {measured}")
    result = {
        "data": arguments.data.resolve().name,
        "threads": thread_count(),
        "presets": {name: curve["points"] for name, curve in curves.items()},
    }
    write_json(arguments.out / "quality.json", result)
    figure = arguments.figure or arguments.out / "quality.png"
    plot(result["presets"], figure)
    say(f"wrote {arguments.out / 'quality.json'}, {figure}")
    return 0


def train_curve(scene: Scene, config: TrainConfig, folder: Path, measurements: int) -> dict[str, Any]:
    """Train by ``config`` in ``folder``: the configuration and one point for each measurement.

    A point: iteration, seconds on the clock and of all CPU cores, Gaussians, LDR-OE and HDR in dB.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # As JSON reads it back: tuples become lists.
    settings = json.loads(json.dumps(dataclasses.asdict(config)))
    record: dict[str, Any] = {"config": settings, "points": []}
    if (folder / RECORD).is_file():
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        record = found if found["config"] == settings else record
    points = record["points"]
    if points and points[-1]["iteration"] == config.iterations:
        return record

    shares = (np.arange(1, measurements + 1) / measurements) ** 2
    due = {max(1, round(share * config.iterations)) for share in shares}
    compile_kernels(config.method.kernels_needed())  # before the clock starts
    started = Clock()
    with started:
        goes_on = points and (folder / CHECKPOINT_FILE).is_file()
        trainer = Trainer(scene, config, resumed=folder if goes_on else None)
    # A record is written before its checkpoint: what was measured after that is measured again.
    del points[next((i for i, p in enumerate(points) if p["iteration"] > trainer.iteration), len(points)) :]
    clock = Clock(points[-1]["seconds"], points[-1]["cpu_seconds"]) if points else started
    while trainer.iteration < config.iterations:
        with clock:
            trainer.step()
        if trainer.iteration in due:
            points.append(
                {
                    "iteration": trainer.iteration,
                    "seconds": clock.seconds,
                    "cpu_seconds": clock.cpu_seconds,
                    "gaussians": trainer.method.size,
                    **quality(trainer.method, scene, config.training_exposures),
                }
            )
            write_json(folder / RECORD, record)
            trainer.save(folder)
    return record


class Clock:
    """A stopwatch that runs within its ``with`` blocks."""

    def __init__(self, seconds: float = 0.0, cpu_seconds: float = 0.0) -> None:
        self.seconds, self.cpu_seconds = seconds, cpu_seconds

    def __enter__(self) -> None:
        self._start, self._cpu_start = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._start
        self.cpu_seconds += time.process_time() - self._cpu_start


@torch.no_grad()
def quality(method: Method, scene: Scene, exposures: tuple[int, ...]) -> dict[str, float]:
    """Mean PSNR of the test views as ``physhdr evaluate`` has it: LDR-OE, and HDR where there is a truth."""
    found = {k: [] for k in exposures}
    hdr = []
    has_truth = truth.has_hdr_truth(scene.root, "test")
    for view in scene.test:
        for k in exposures:
            picture = quantise(method.ldr(view.camera, view.exposures[k], view.lighting_levels).cpu())
            reference = torch.from_numpy(view.values(k)).permute(2, 0, 1)
            found[k].append(psnr(picture, reference))
        if has_truth:
            radiance = method.hdr(view.camera, view.lighting_levels).cpu()
            true = truth.hdr_truth(scene.root, "test", view.index)
            pair = hdr_pair(radiance, true, published=bool(data_set_of(scene)))
            hdr.append(psnr(pair.prediction, pair.truth))
    means = {"LDR-OE": float(np.mean([np.mean(values) for values in found.values()]))}
    return means | ({"HDR": float(np.mean(hdr))} if hdr else {})


def write_json(path: Path, content: dict[str, Any]) -> None:
    temporary = path.with_suffix(".partial")
    temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    temporary.replace(path)


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
