# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory, start, compilation, other processors: each figure from a fresh process (``workers``)."""

import json
import os
import platform
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

#: What is to be kept to: MB resident, seconds.
PEAK_MB, WARM_SECONDS, COLD_SECONDS = 2000.0, 3.0, 25.0
#: The first iteration is that of a picture this large; it is started so many times.
START_SIZE, STARTS = 400, 5

#: What a processor of that name has, in LLVM's words.
_NEHALEM = ["64bit", "cmov", "crc32", "cx8", "cx16", "fxsr", "mmx", "popcnt", "sahf"]
_NEHALEM += ["sse", "sse2", "sse3", "sse4.1", "sse4.2", "ssse3"]
_HASWELL = ["avx", "avx2", "bmi", "bmi2", "f16c", "fma", "fsgsbase", "invpcid", "lzcnt", "movbe"]
_HASWELL += ["pclmul", "rdrnd", "xsave", "xsaveopt"]
FEATURES = {"nehalem": {*_NEHALEM}, "haswell": {*_NEHALEM, *_HASWELL}}
NATIVE = "this one"
#: What ``workers.speeds`` calls the time of compilation.
READY = "kernels ready after, s"


class WorkerError(Exception):
    """A worker ended without a result; the message is what it said last."""


def run(command: list[str], environment: dict[str, str] | None = None) -> str:
    """The standard output of a Python process; raises ``WorkerError``."""
    variables = {**os.environ, "OMP_WAIT_POLICY": "passive", **(environment or {})}
    process = subprocess.run([sys.executable, *command], env=variables, capture_output=True, text=True)
    if process.returncode:
        last = (process.stderr.strip().splitlines() or ["it said nothing"])[-1]
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


def environment_of(processor: str, cache: str) -> dict[str, str]:
    """Variables that make Numba compile for ``processor`` (the features that this machine has as well)."""
    if processor == NATIVE:
        return {"NUMBA_CACHE_DIR": cache}
    import llvmlite.binding

    # The name alone would not do: Numba takes the features from the machine whatever the name is.
    host = llvmlite.binding.get_host_cpu_features()
    features = ",".join(
        f"{'+' if there and feature in FEATURES[processor] else '-'}{feature}"
        for feature, there in host.items()
    )
    return {"NUMBA_CACHE_DIR": cache, "NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": features}


def processor_times(names: list[str], rounds: int = 2) -> dict[str, dict[str, float] | str]:
    """By processor: milliseconds by work, medians of processes in turn; or why it does not run."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        raise WorkerError(f"{', '.join(names)} are x86 processors, this is {platform.machine()}")
    samples: dict[str, list[dict[str, float]]] = {name: [] for name in (NATIVE, *names)}
    failures: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            for name in [name for name in samples if name not in failures]:
                environment = environment_of(name, f"{folder}/{name}")
                try:
                    samples[name].append(worker("speeds", torch.get_num_threads(), environment=environment))
                except WorkerError as error:
                    failures[name] = str(error)
    return {name: failures.get(name) or _medians(results) for name, results in samples.items()}


def _medians(results: list[dict[str, float]]) -> dict[str, float]:
    medians = {work: statistics.median(result[work] for result in results) for work in results[0]}
    # The first process compiled the kernels, the others found them.
    return medians | {READY: results[0][READY]}
