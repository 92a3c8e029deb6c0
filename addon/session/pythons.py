# SPDX-License-Identifier: GPL-3.0-or-later
"""Pythons on this machine that a backend could be made of. No bpy."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

#: The trainer needs 3.11; preferred are versions for which torch and Numba have had wheels for long.
PREFERRED = ("3.12", "3.11", "3.13", "3.14")
MINIMUM = (3, 11)
#: How the folder of an environment of ours begins (addon/scripts/install_backend.py).
ENVIRONMENT = "environment-"
_PROBE = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2], sys.executable)"


def find_pythons() -> list[Path]:
    """Interpreters that work and can make environments, the preferred one first. Takes about a second."""
    found: dict[Path, None] = {}
    for version in PREFERRED:
        for candidate in _candidates(version):
            path = working_python(candidate)
            if path:
                found[path] = None
    return list(found)


def working_python(candidate: str) -> Path | None:
    """The interpreter behind ``candidate`` if it runs (pyenv's shims may not) and is new enough."""
    try:
        done = subprocess.run(
            [candidate, "-I", "-c", _PROBE], capture_output=True, text=True, timeout=20, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    version, _, executable = done.stdout.strip().partition(" ")
    if done.returncode or not executable:
        return None
    numbers = tuple(int(part) for part in version.split("."))
    return Path(executable) if numbers >= MINIMUM else None


def is_ours(home: Path, python: str) -> bool:
    """Whether ``python`` is of an environment that *Install…* made in the backend's folder."""
    path = Path(python)
    return python != "" and any(
        parent.parent == home and parent.name.startswith(ENVIRONMENT) for parent in path.parents
    )


def base_of(python: str) -> Path | None:
    """The interpreter of which an environment was made, by its own words; None where it is none."""
    try:
        text = (Path(python).parent.parent / "pyvenv.cfg").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None
    entries = dict(re.findall(r"^(\w+)\s*=\s*(.*?)\s*$", text, re.MULTILINE))
    return working_python(entries["executable"]) if "executable" in entries else None


def _candidates(version: str) -> Iterator[str]:
    on_path = shutil.which(f"python{version}")
    if on_path:
        yield on_path
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for path in sorted(pyenv.glob(f"{version}.*/bin/python{version}"), reverse=True):
        yield str(path)
    local = os.environ.get("LOCALAPPDATA")
    if local:  # the installer of python.org
        yield str(Path(local) / "Programs" / "Python" / f"Python{version.replace('.', '')}" / "python.exe")
    # Blender brings its own, which can make an environment of its own like any other.
    if version == "{}.{}".format(*sys.version_info[:2]):
        yield sys.executable
