# SPDX-License-Identifier: GPL-3.0-or-later
"""Pythons on this machine that a backend could be made of. No bpy."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from .process import unseen

#: The trainer needs 3.11; preferred are versions for which torch and Numba have had wheels for long.
PREFERRED = ("3.12", "3.11", "3.13", "3.14")
MINIMUM = (3, 11)
#: How the folders of environments of ours begin, elsewhere and on Windows (addon/scripts/install_backend.py).
ENVIRONMENT = ("environment-", "env-")
_PROBE = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2], sys.executable)"
#: In the path of a Python of Microsoft's Store. What such a one writes below AppData lands elsewhere, where
#: Blender does not find it: it can make no environment for us.
STORE = "PythonSoftwareFoundation.Python"

#: Where python.org's installer and Homebrew put them.
_ON_MACOS = (
    "/Library/Frameworks/Python.framework/Versions/{}/bin",
    "/opt/homebrew/bin",
    "/usr/local/bin",
)


def find_pythons() -> list[Path]:
    """Interpreters that work and can make environments, the preferred one first. Takes about a second."""
    found: dict[Path, None] = {}
    for version in PREFERRED:
        for candidate in _candidates(version):
            path = working_python(candidate)
            if path and STORE not in str(path):
                found[path] = None
    return list(found)


def working_python(candidate: str) -> Path | None:
    """The interpreter behind ``candidate`` if it runs (pyenv's shims may not) and is new enough."""
    try:
        # UTF-8 from both sides: Windows' code page has not all letters of a user's name.
        done = subprocess.run(
            [candidate, "-I", "-X", "utf8", "-c", _PROBE],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=20,
            check=False,
            **unseen(),
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    # The last line: a wrapper may have greeted. Any other program may have said anything.
    found = re.fullmatch(r"(\d+)\.(\d+) (.+)", (done.stdout.strip().splitlines() or [""])[-1])
    if done.returncode or found is None:
        return None
    recent = (int(found[1]), int(found[2])) >= MINIMUM
    return Path(found[3]) if recent and os.path.isfile(found[3]) else None


def is_ours(home: Path, python: str) -> bool:
    """Whether ``python`` is of an environment that *Get the Trainer* made in the backend's folder."""
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
    if os.name == "nt":
        yield from map(str, _on_windows(version, os.environ))
    else:
        yield from map(str, _with_pyenv(version))
    if sys.platform == "darwin":  # a program that was started by a click has none of these on its path
        for folder in _ON_MACOS:
            yield f"{folder.format(version)}/python{version}"
    # Blender brings its own, which can make an environment of its own like any other.
    if version == "{}.{}".format(*sys.version_info[:2]):
        yield sys.executable


def _with_pyenv(version: str) -> list[Path]:
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    return sorted(pyenv.glob(f"{version}.*/bin/python{version}"), reverse=True)


def _on_windows(version: str, environment: Mapping[str, str]) -> Iterator[Path]:
    """Where python.org's installers, its install manager and pyenv-win put them: mostly not on the path."""
    digits = version.replace(".", "")
    if local := environment.get("LOCALAPPDATA"):
        yield Path(local, "Programs", "Python", f"Python{digits}", "python.exe")  # for one user
        yield Path(local, "Python", f"pythoncore-{version}-64", "python.exe")
    if programs := environment.get("ProgramFiles"):
        yield Path(programs, f"Python{digits}", "python.exe")  # for all users
    pyenv = environment.get("PYENV") or Path(environment.get("USERPROFILE", ""), ".pyenv", "pyenv-win")
    yield from sorted(Path(pyenv, "versions").glob(f"{version}.*/python.exe"), reverse=True)
