#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run every room's tests with the interpreter that it needs, and print how long each took."""

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BACKEND = ROOT / ".venvs" / "backend" / "bin"
BLENDER = ROOT / ".venvs" / "run-blender"

#: What runs, in which interpreter, on which folders: the quick and the fundamental first.
SUITES = [
    ("lint", [BACKEND / "ruff", "check", "."]),
    ("backend", [BACKEND / "python", "-m", "pytest", "tests/bridge", "tests/backend"]),
    ("blender", [BLENDER, "tests/run_in_blender.py", "--", "tests/bridge", "tests/synth", "tests/addon"]),
    ("loop", [BACKEND / "python", "-m", "pytest", "tests/loop"]),
]


def main() -> int:
    begun = time.perf_counter()
    for name, command in SUITES:
        print(f"\n== {name} ==", flush=True)
        start = time.perf_counter()
        status = subprocess.call([str(part) for part in command] + sys.argv[1:] * (name != "lint"), cwd=ROOT)
        print(f"== {name}: {'passed' if status == 0 else 'FAILED'} in {time.perf_counter() - start:.0f} s ==")
        if status:
            return status
    print(f"\nall suites passed in {time.perf_counter() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
