# SPDX-License-Identifier: GPL-3.0-or-later
"""The machine and versions that computed a run: CPU seconds are comparable on one kind of machine only."""

import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import psutil

from ...backend.project import version, version_of

PACKAGE = Path(__file__).resolve().parents[2]


def this_machine() -> dict[str, Any]:
    """``host``, ``cpu``, ``cores``, ``memory`` (bytes), ``system``, ``versions`` of this machine."""
    return {
        "host": platform.node(),
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory": psutil.virtual_memory().total,
        "system": f"{platform.system()} {platform.machine()}",
        "versions": _versions(),
    }


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("torch", "numba", "numpy"):
        if installed := version_of(name):
            found[name] = installed
    return found | {"physhdr": _revision()}


def _revision() -> str:
    """The commit, with + if files differ from it; the package's version if this is not a checkout.

    A repository that merely contains the package, such as that of an environment's owner, does not count.
    """

    def git(*words: str) -> str:
        command = ["git", "-C", str(PACKAGE), *words]
        done = subprocess.run(
            command, capture_output=True, encoding="utf-8", errors="replace", check=True, timeout=20
        )
        return done.stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")) != PACKAGE:
            return version()
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "backend", "bridge")
        return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.SubprocessError):
        return version()


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
