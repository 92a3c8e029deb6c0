#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Run every room's tests with the interpreter that it needs, and print how long each took.

    python tools/run_tests.py           what `make test` runs: all but the tests that are marked `long`
    python tools/run_tests.py --long    what `make test-long` runs: those tests, the rest of lint, the
                                        installed wheel, short fuzz and torture

Other arguments are passed on to pytest. Two lanes run side by side, in each one suite after the other. A
suite's output is printed when it is done, but for the first lane's, which is printed as it comes.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parent.parent
BACKEND = ROOT / ".venvs" / "backend" / "bin"
BLENDER = ROOT / ".venvs" / "run-blender"

PYTEST = (BACKEND / "python", "-m", "pytest")
IN_BLENDER = (BLENDER, "tests/run_in_blender.py", "--")
#: The backend's suite in two processes: a third of its tests wait for processes that they started. One that
#: dies is not replaced: with another in its place, pytest-xdist waits for ever and names no test.
BESIDE = ("-n", "2", "--dist", "loadfile", "--max-worker-restart", "0")

#: What a suite finds in its environment, where nothing else is set there. Two processes keep the
#: cores busy: threads of torch would wait for one another, a fifth of the time.
ENVIRONMENTS = {"backend": {"OMP_NUM_THREADS": "1"}}

#: Name of a suite → its command. Both lanes take about as long. Kernels are compiled first: two processes
#: that need them at once would both compile them.
LANES: tuple[dict[str, tuple], ...] = (
    {
        "kernels": (BACKEND / "physhdr", "check"),
        "backend": (*PYTEST, *BESIDE, "-m", "not long", "tests/bridge", "tests/backend", "tests/lab"),
    },
    {
        "lint": (BACKEND / "python", "tools/lint.py", "--quick"),
        "blender": (*IN_BLENDER, "-m", "not long", "tests/synth", "tests/addon"),
        "loop": (*PYTEST, "-m", "not long", "tests/loop", "tests/test_docs.py"),
    },
)
LONG: tuple[dict[str, tuple], ...] = (
    {
        "lint": (BACKEND / "python", "tools/lint.py", "--others"),
        "bridge in blender": (*IN_BLENDER, "tests/bridge"),
        "long blender": (*IN_BLENDER, "-m", "long", "tests/synth", "tests/addon"),
        "long": (*PYTEST, "-m", "long", "tests/backend", "tests/lab"),
    },
    {
        "long loop": (*PYTEST, "-m", "long", "tests/loop"),
        "wheel": (BACKEND / "python", "tools/try_wheel.py"),
        "fuzz": (BACKEND / "python", "tests/stress/fuzz.py", "--short"),
        "torture": (BACKEND / "python", "tests/stress/torture.py", "--short"),
    },
)


class Lane(threading.Thread):
    """Runs suites one after the other; ``passed`` once it has ended, if all of them did.

    ``loud``: the suites write to this process's output as they run; else what they wrote is in ``written``,
    one file a suite, complete when the suite's name is in ``done``.
    """

    def __init__(self, suites: dict[str, tuple], arguments: list[str], *, loud: bool) -> None:
        super().__init__()
        self.suites, self.arguments, self.loud = suites, arguments, loud
        self.passed = True

    def run(self) -> None:
        for name, command in self.suites.items():
            begun = time.perf_counter()
            environment = ENVIRONMENTS.get(name, {}) | os.environ
            # Else each of the processes that tests start would compile every module again.
            environment.pop("PYTHONDONTWRITEBYTECODE", None)
            words = [str(part) for part in command] + self.arguments * (
                "pytest" in command or BLENDER in command
            )
            if self.loud:
                say(f"\n== {name} ==")
                status = subprocess.call(words, cwd=ROOT, env=environment)
            else:
                with tempfile.TemporaryFile() as output:
                    status = subprocess.call(
                        words, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT
                    )
                    show(name, output)
            self.passed &= status == 0
            verdict = "passed" if status == 0 else "FAILED"
            say(f"== {name}: {verdict} after {time.perf_counter() - begun:.0f} s ==")


PRINTING = threading.Lock()


def say(line: str) -> None:
    with PRINTING:
        print(line, flush=True)


def show(name: str, output: IO[bytes]) -> None:
    """All that a suite wrote, in one piece."""
    output.seek(0)
    with PRINTING:
        print(f"\n== {name} ==", flush=True)
        sys.stdout.buffer.write(output.read())
        sys.stdout.flush()


def main() -> int:
    arguments = sys.argv[1:]
    lanes = LANES
    if "--long" in arguments:
        arguments.remove("--long")
        lanes = LONG
    begun = time.perf_counter()
    running = [Lane(suites, arguments, loud=index == 0) for index, suites in enumerate(lanes)]
    for lane in running:
        lane.start()
    for lane in running:
        lane.join()
    passed = all(lane.passed for lane in running)
    say(f"\n{'all' if passed else 'NOT all'} suites passed, in {time.perf_counter() - begun:.0f} s")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
