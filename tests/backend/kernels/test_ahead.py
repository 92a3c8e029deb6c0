# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``physhdr check`` compiles is all that the first steps of a training call, whichever the preset."""

import json
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from physhdr.backend.kernels import ahead

#: In a process of its own: in this one, other tests have compiled whatever they needed.
FIRST_STEPS = """
import dataclasses, json, sys
import numba.core.registry
from physhdr.backend.kernels.ahead import compile_ahead
from physhdr.backend.scene import read_scene
from physhdr.backend.train.presets import PRESETS, needed_by_presets
from physhdr.backend.train.begin import begin
from physhdr.backend.train.trainer import step

def compiled():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith("physhdr.backend.")]
    found = {}
    for module in modules:
        for value in vars(module).values():
            if isinstance(value, numba.core.registry.CPUDispatcher):
                found[f"{value.py_func.__module__}.{value.py_func.__name__}"] = len(value.signatures)
    return found

compile_ahead(needed_by_presets())
scene, more = read_scene(sys.argv[1]), {}
for preset in sys.argv[2:]:
    before = compiled()
    step(begin(scene, dataclasses.replace(PRESETS[preset], iterations=1), "cpu"))
    more[preset] = [name for name, count in compiled().items() if count != before.get(name, 0)]
print(json.dumps(more))
"""


@pytest.mark.long
def test_first_steps_compile_nothing(tiny_data):
    presets = ["default", "paper-short", "gausshdr-short", "hdr-gs-short", "hdr-nerf-small"]
    command = [sys.executable, "-c", FIRST_STEPS, str(tiny_data), *presets]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {preset: [] for preset in presets}


@pytest.mark.parametrize(
    ("on_disk", "processes"),
    [([], [1]), ([Path("kernel.nbc")], []), (None, [])],
    ids=["nothing there", "something there", "nothing can be kept"],
)
def test_processes_share_what_they_can_leave_on_disk(on_disk, processes, monkeypatch):
    started, done = [], []

    def pool(count, context):
        started.append(count)
        return ThreadPoolExecutor(count)

    monkeypatch.setattr(ahead, "cached_files", lambda kernel: on_disk)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 2)
    monkeypatch.setattr(ahead, "ProcessPoolExecutor", pool)
    monkeypatch.setattr(ahead, "_jobs", lambda needs: {"a kernel": lambda: done.append("a kernel")})
    ahead.compile_ahead(ahead.Needs())
    assert started == processes and done == ["a kernel"] * (1 + len(processes))


def test_what_a_process_that_died_left_undone_is_done_here(monkeypatch):
    class Died(ThreadPoolExecutor):
        def __init__(self, count, context):
            super().__init__(count)

        def submit(self, job):
            future = Future()
            future.set_exception(BrokenProcessPool("A process in the process pool was terminated abruptly"))
            return future

    done = []
    monkeypatch.setattr(ahead, "cached_files", lambda kernel: [])
    monkeypatch.setattr(ahead, "usable_cores", lambda: 2)
    monkeypatch.setattr(ahead, "ProcessPoolExecutor", Died)
    jobs = {name: lambda name=name: done.append(name) for name in ("a kernel", "another")}
    monkeypatch.setattr(ahead, "_jobs", lambda needs: jobs)
    ahead.compile_ahead(ahead.Needs())
    assert done == ["a kernel", "another"]
