#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run every room's tests with the interpreter that it needs, and print how long each took.

The backend's suite runs beside the other two, of which one follows the other: most tests keep one core busy.
What these say is printed when the backend's is done.
"""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BACKEND = ROOT / ".venvs" / "backend" / "bin"
BLENDER = ROOT / ".venvs" / "run-blender"

#: The suites: interpreter, and what runs in it on which folders.
SUITES = {
    "lint": [BACKEND / "ruff", "check", "."],
    "backend": [BACKEND / "python", "-m", "pytest", "tests/bridge", "tests/backend"],
    "blender": [BLENDER, "tests/run_in_blender.py", "--", "tests/bridge", "tests/synth", "tests/addon"],
    "loop": [BACKEND / "python", "-m", "pytest", "tests/loop"],
}


@dataclass(frozen=True)
class Outcome:
    """How a suite ended; ``output``: what it said, where that was not shown as it came."""

    name: str
    passed: bool
    seconds: float
    output: bytes | None

    def tell(self) -> None:
        if self.output is not None:
            print(f"\n== {self.name} ==", flush=True)
            sys.stdout.buffer.write(self.output)
        ended = "passed" if self.passed else "FAILED"
        print(f"== {self.name}: {ended} after {self.seconds:.0f} s ==", flush=True)


def main() -> int:
    begun = time.perf_counter()
    outcomes = [run("lint", is_shown=True)]
    if outcomes[0].passed:
        with ThreadPoolExecutor(1) as second_row:
            beside = [second_row.submit(run, name, is_shown=False) for name in ("blender", "loop")]
            outcomes.append(run("backend", is_shown=True))
            for suite in beside:
                outcomes.append(suite.result())
                outcomes[-1].tell()
    if not all(outcome.passed for outcome in outcomes):
        return 1
    print(f"\nall suites passed in {time.perf_counter() - begun:.0f} s")
    return 0


def run(name: str, is_shown: bool) -> Outcome:
    """Run a suite with the options of this command; tell how it ended if it ``is_shown`` as it comes."""
    start = time.perf_counter()
    words = [str(word) for word in SUITES[name]] + sys.argv[1:] * (name != "lint")
    if is_shown:
        print(f"\n== {name} ==", flush=True)
    said = {} if is_shown else {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(words, cwd=ROOT, check=False, **said)
    outcome = Outcome(name, done.returncode == 0, time.perf_counter() - start, done.stdout)
    if is_shown:
        outcome.tell()
    return outcome


if __name__ == "__main__":
    sys.exit(main())
