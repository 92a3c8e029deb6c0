# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory, start, compilation: each figure from a fresh process (``workers``)."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from measure import Row

HERE = Path(__file__).parent

#: Limits: MB resident, seconds.
PEAK_MB, WARM_SECONDS, COLD_SECONDS = 2000.0, 3.0, 25.0
#: The first iteration is that of a picture this large; it is started so many times.
START_SIZE, STARTS = 400, 5


class WorkerError(Exception):
    """A worker ended without a result; the message is its last output."""


def run(command: list[str], environment: dict[str, str] | None = None) -> str:
    """The standard output of a Python process; raises ``WorkerError``."""
    variables = {**os.environ, "OMP_WAIT_POLICY": "passive", **(environment or {})}
    process = subprocess.run([sys.executable, *command], env=variables, capture_output=True, text=True)
    if process.returncode:
        last = (process.stderr.strip().splitlines() or ["it printed nothing"])[-1]
        raise WorkerError(f"ended with status {process.returncode}: {last}")
    return process.stdout


def worker(name: str, *arguments: object, environment: dict[str, str] | None = None) -> dict[str, float]:
    """The result of a function of ``workers`` in a process of its own."""
    output = run([str(HERE / "workers.py"), name, *map(str, arguments)], environment)
    return json.loads(output.splitlines()[-1])


def memory_rows(quick: bool) -> Iterator[Row]:
    """Peak memory of a training at 200 k Gaussians with 35 views × 5 exposures."""
    for preset in ("default", "paper"):
        result = worker("memory", preset, torch.get_num_threads())
        yield Row(
            work=f"peak memory, {preset}, {result['gaussians'] / 1000:.0f} k",
            value=result["peak_mb"],
            unit="MB",
            at_most=PEAK_MB,
            note=f"of which pictures {result['pictures_mb']:.0f} MB",
        )


def start_rows(quick: bool) -> Iterator[Row]:
    """Compiling everything with an empty cache, then starts that find it."""
    with tempfile.TemporaryDirectory() as folder:
        cache = {"NUMBA_CACHE_DIR": folder + "/cache"}
        start, cpu_start = time.perf_counter(), children_seconds()
        run(["-c", "from physhdr.backend.cli.trial_step import compile_for_presets as f; f(print)"], cache)
        yield Row(
            work="kernels of all presets, empty cache",
            value=time.perf_counter() - start,
            unit="s",
            at_most=COLD_SECONDS,
            note=f"CPU time {children_seconds() - cpu_start:.1f} s",
        )
        write_data(Path(folder, "data"))
        starts, cpu_start = [], children_seconds()
        for _ in range(STARTS):
            begun = time.time()
            first = worker("first-iteration", folder + "/data", folder + "/run", environment=cache)
            starts.append(first["done"] - begun)
        yield Row(
            work="physhdr train to its 1st iteration",
            value=statistics.median(starts),
            unit="s",
            at_most=WARM_SECONDS,
            note=f"CPU time {(children_seconds() - cpu_start) / STARTS:.1f} s; the first {starts[0]:.1f} s",
        )


def children_seconds() -> float:
    """CPU seconds of the processes that were started and have ended."""
    times = os.times()
    return times.children_user + times.children_system


def write_data(folder: Path) -> None:
    """A small data set of 400 × 400 pictures, the tests' one."""
    sys.path.insert(0, str(HERE.parent / "tests" / "backend"))
    from tiny_scene import write_tiny_scene

    folder.mkdir()
    write_tiny_scene(folder, size=START_SIZE)
