#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""ruff, its formatting, and pyright over all rooms: as on Linux, then as on Windows and on macOS.

    .venvs/backend/bin/python tools/lint.py            what `make lint` runs
    .venvs/backend/bin/python tools/lint.py --quick    ruff, and pyright as on Linux over what is shipped but
                                                       for the built-in scenes: what `make test` runs
    .venvs/backend/bin/python tools/lint.py --others   pyright over the rest: what `make test-long` runs
    .venvs/backend/bin/python tools/lint.py --whole    every file for every system, not only where they differ

Two programs run at a time. For Windows and macOS only those files are looked at that import something which
is not the same there (``DIFFERS``): that takes less than half as long, and finds the same.
"""

import argparse
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("addon", "backend", "bridge", "lab", "synth")
#: What `make test` leaves to `make test-long`: nothing that a room calls, but for the scenes, which are data.
LATER = ("benchmarks", "lab/tools", "synth/scenes", "tests/stress", "tools")
#: What pyright calls the systems on which most users of Blender are.
OTHER_SYSTEMS = ("Windows", "Darwin")
#: Modules of which a system lacks a part, or the whole; and the questions which system this is.
DIFFERS = re.compile(
    r"^\s*(?:import|from)\s+(?:asyncio|ctypes|fcntl|mmap|msvcrt|multiprocessing|os|psutil|pwd|resource|select"
    r"|selectors|shutil|signal|socket|subprocess|tempfile|termios|threading|time|winreg)\b"
    r"|\bsys\.(?:platform|getwindowsversion)\b|\.(?:owner|group)\(\)",
    re.MULTILINE,
)


def files_that_differ(root: Path) -> list[str]:
    """The rooms' files, relative to ``root``, whose types may be others on another system."""
    files = sorted(path for room in ROOMS for path in (root / room).rglob("*.py"))
    return [str(path.relative_to(root)) for path in files if DIFFERS.search(path.read_text(encoding="utf-8"))]


def shipped_files(root: Path) -> list[str]:
    """The rooms' files, relative to ``root``, but for those that come ``LATER``."""
    files = sorted(path.relative_to(root) for room in ROOMS for path in (root / room).rglob("*.py"))
    return [str(path) for path in files if not any(path.is_relative_to(later) for later in LATER)]


def checks(*, quick: bool = False, others: bool = False, whole: bool = False) -> dict[str, list[str]]:
    """Name → command, the longest first among those that take long. ``quick``, ``others``: of these alone."""
    programs = Path(sys.executable).parent
    ruff, pyright = (
        str(programs / "ruff"),
        [str(programs / "pyright"), "--level", "error", "--pythonplatform"],
    )
    found = {"ruff check": [ruff, "check", "."], "ruff format": [ruff, "format", "--check", "."]}
    if quick:
        return found | {"pyright": [*pyright, "Linux", *shipped_files(ROOT)]}
    found = (
        {"pyright, the rest": [*pyright, "Linux", *LATER]}
        if others
        else found | {"pyright": [*pyright, "Linux"]}
    )
    files = [] if whole else files_that_differ(ROOT)
    return found | {f"pyright, {system}": [*pyright, system, *files] for system in OTHER_SYSTEMS}


def run(name: str, command: list[str]) -> bool:
    """Run one of the checks and print what it says; whether it found nothing."""
    begun = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    said = (done.stdout + done.stderr).rstrip()
    verdict = "passed" if done.returncode == 0 else "FAILED"
    print(f"{said}\n[lint] {name}: {verdict} after {time.perf_counter() - begun:.0f} s", flush=True)
    return done.returncode == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--quick", action="store_true", help="as on Linux, what is shipped")
    parts.add_argument("--others", action="store_true", help="as on Windows and macOS, and the rest")
    parser.add_argument("--whole", action="store_true", help="every file for every system")
    args = parser.parse_args()
    wanted = checks(quick=args.quick, others=args.others, whole=args.whole)
    with ThreadPoolExecutor(max_workers=2) as pool:
        passed = list(pool.map(run, wanted.keys(), wanted.values()))
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
