#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""ruff, its formatting, and pyright over all rooms: as on Linux, then as on Windows and on macOS.

    .venvs/backend/bin/python tools/lint.py            what `make lint` runs
    .venvs/backend/bin/python tools/lint.py --quick    ruff, and pyright as on Linux over what you changed:
                                                       what `make test` runs
    .venvs/backend/bin/python tools/lint.py --others   pyright over everything: what `make test-long` runs
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
#: What pyright looks at, as pyproject.toml has it.
TYPED = (*ROOMS, "benchmarks", "tests/stress", "tools")
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


def changed_files(root: Path) -> list[str]:
    """The files, relative to ``root``, that are not as in the branch that this one follows.

    None of them where git knows no such branch, as in a copy without its history.
    """
    git = ["git", "-C", str(root)]
    commands = [
        ["diff", "--name-only", "--diff-filter=d", "@{upstream}"],
        ["ls-files", "-o", "--exclude-standard"],
    ]
    found = [
        subprocess.run([*git, *command], capture_output=True, text=True, check=False) for command in commands
    ]
    if any(done.returncode for done in found):
        return []
    names = sorted(name for done in found for name in done.stdout.splitlines())
    return [
        name
        for name in names
        if name.endswith(".py") and name.startswith(tuple(f"{folder}/" for folder in TYPED))
    ]


def checks(*, quick: bool = False, others: bool = False, whole: bool = False) -> dict[str, list[str]]:
    """Name → command, the longest first among those that take long. ``quick``, ``others``: of these alone."""
    programs = Path(sys.executable).parent
    ruff = str(programs / "ruff")
    pyright = [str(programs / "pyright"), "--level", "error", "--pythonplatform"]
    found = {"ruff check": [ruff, "check", "."], "ruff format": [ruff, "format", "--check", "."]}
    if quick:
        changed = changed_files(ROOT)
        return found | ({"pyright": [*pyright, "Linux", *changed]} if changed else {})
    files = [] if whole else files_that_differ(ROOT)
    types = {"pyright": [*pyright, "Linux"]}
    types |= {f"pyright, {system}": [*pyright, system, *files] for system in OTHER_SYSTEMS}
    return types if others else found | types


def run(name: str, command: list[str]) -> bool:
    """Run one of the checks and print what it says; whether it found nothing."""
    begun = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    output = (done.stdout + done.stderr).rstrip()
    verdict = "passed" if done.returncode == 0 else "FAILED"
    print(f"{output}\n[lint] {name}: {verdict} after {time.perf_counter() - begun:.0f} s", flush=True)
    return done.returncode == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--quick", action="store_true", help="ruff, and pyright over what you changed")
    parts.add_argument("--others", action="store_true", help="pyright over everything")
    parser.add_argument("--whole", action="store_true", help="every file for every system")
    args = parser.parse_args()
    wanted = checks(quick=args.quick, others=args.others, whole=args.whole)
    with ThreadPoolExecutor(max_workers=2) as pool:
        passed = list(pool.map(run, wanted.keys(), wanted.values()))
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
