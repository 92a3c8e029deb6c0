#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run every room's tests with the interpreter that it needs, and print how long each took.

The two rooms run side by side: most of their tests keep one core busy. What Blender's side says is printed
when the backend's is done.
"""

import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BACKEND = ROOT / ".venvs" / "backend" / "bin"
BLENDER = ROOT / ".venvs" / "run-blender"

#: What runs, in which interpreter, on which folders: the quick and the fundamental first, one row at a time.
STAGES = [
    {"lint": [BACKEND / "ruff", "check", "."]},
    {
        "backend": [BACKEND / "python", "-m", "pytest", "tests/bridge", "tests/backend"],
        "blender": [BLENDER, "tests/run_in_blender.py", "--", "tests/bridge", "tests/synth", "tests/addon"],
    },
    {"loop": [BACKEND / "python", "-m", "pytest", "tests/loop"]},
]


def main() -> int:
    begun = time.perf_counter()
    for stage in STAGES:
        if not run_together(stage):
            return 1
    print(f"\nall suites passed in {time.perf_counter() - begun:.0f} s")
    return 0


def run_together(suites: dict[str, list]) -> bool:
    """Run the suites at the same time; the output of the first as it comes, then of the others."""
    start = time.perf_counter()
    passed = True
    with ExitStack() as files:
        running = []
        for name, command in suites.items():
            output = files.enter_context(tempfile.TemporaryFile()) if running else None
            words = [str(part) for part in command] + sys.argv[1:] * (name != "lint")
            process = subprocess.Popen(words, cwd=ROOT, stdout=output, stderr=output and subprocess.STDOUT)
            running.append((name, process, output))
        for name, process, output in running:
            print(f"\n== {name} ==", flush=True)
            status = process.wait()
            if output is not None:
                output.seek(0)
                sys.stdout.buffer.write(output.read())
            seconds = time.perf_counter() - start
            print(f"== {name}: {'passed' if status == 0 else 'FAILED'} after {seconds:.0f} s ==", flush=True)
            passed &= status == 0
    return passed


if __name__ == "__main__":
    sys.exit(main())
