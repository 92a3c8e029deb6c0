#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Set up the two environments that PhysHDR needs, or say what to install. Standard library only.

    python3 tools/setup.py [backend] [blender]

``backend``: .venvs/backend, Python ≥ 3.11 with torch (CPU), for training.
``blender``: .venvs/blender, Python 3.13 with the ``bpy`` wheel; where only a ``blender`` ≥ 5.2 is on PATH,
a launcher that runs it. Either way ``.venvs/run-blender SCRIPT -- ARGS`` runs a script inside Blender.
Does nothing where an environment is up to date.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENVS = ROOT / ".venvs"
LAUNCHER = VENVS / "run-blender"
BLENDER_PYTHON = (3, 13)
BLENDER_MINIMUM = (5, 2)
BACKEND_MINIMUM = (3, 11)
#: Preferred first: the version whose CPU build of torch is tested.
BACKEND_CANDIDATES = ("3.11", "3.12", "3.13", "3.14")
LIBRARIES = (
    "libx11-6 libxext6 libxrender1 libxfixes3 libxi6 libxt6 libxkbcommon0 libsm6 libice6 "
    "libgl1 libegl1 libgl1-mesa-dri"
)


def main() -> int:
    wanted = sys.argv[1:] or ["backend", "blender"]
    VENVS.mkdir(exist_ok=True)
    for name in wanted:
        step = {"backend": set_up_backend, "blender": set_up_blender}.get(name)
        if step is None:
            return fail(f"unknown environment '{name}'", "Choose backend or blender.")
        begun = time.perf_counter()
        problem = step()
        if problem:
            return problem
        print(f"[setup] {name}: ready ({time.perf_counter() - begun:.0f} s)", flush=True)
    return 0


def fail(message: str, remedy: str) -> int:
    print(f"error: {message}\n  {remedy}", file=sys.stderr)
    return 1


def set_up_backend() -> int:
    python = find_python(BACKEND_CANDIDATES)
    if python is None:
        return fail(
            "no Python 3.11 or newer was found for the trainer",
            "Install one (Debian: apt install python3 python3-venv; anywhere: uv python install 3.12).",
        )
    return make_environment("backend", python, ".[backend,test,develop]")


def set_up_blender() -> int:
    python = find_python((f"{BLENDER_PYTHON[0]}.{BLENDER_PYTHON[1]}",))
    if python is None:
        return set_up_blender_binary()
    problem = make_environment("blender", python, ".[blender]")
    if problem:
        return problem
    interpreter = VENVS / "blender" / "bin" / "python"
    check = run([interpreter, "-c", "import bpy"])
    if check.returncode:
        return fail(
            f"bpy is installed but cannot be imported: {check.stderr.strip().splitlines()[-1]}",
            f"It needs these system libraries (Debian names): {LIBRARIES}",
        )
    write_launcher(f'exec "{interpreter}" "$@"')
    return 0


#: Run by Blender's Python: the packages of pyproject.toml's extra but bpy, which it is, into the folder SITE.
INSTALL = """
import numpy, subprocess, sys, tomllib
with open({project!r}, "rb") as file:
    wanted = tomllib.load(file)["project"]["optional-dependencies"]["blender"]
wanted = [each for each in wanted if not each.startswith("bpy")]
wanted.append("numpy==" + numpy.__version__)  # some of them bring it; Blender's own parts know this one
pip = [sys.executable, "-m", "pip", "install", "--quiet", "--upgrade", "--target", {site!r}]
sys.exit(subprocess.call([*pip, *wanted]))
"""


def set_up_blender_binary() -> int:
    """No Python 3.13: use the ``blender`` on PATH, with what our side of it needs in a folder of its own."""
    blender = shutil.which("blender")
    version = blender_version(blender) if blender else None
    if version is None or version < BLENDER_MINIMUM:
        found = f"the blender on PATH is {version}" if version else "no blender is on PATH"
        return fail(
            f"no Python 3.13 was found for Blender's bpy wheel, and {found}",
            "Install Blender 5.2 or newer and put it on PATH, or Python 3.13 (uv python install 3.13).",
        )
    site = VENVS / "blender-site"
    stamp = VENVS / "blender-site.stamp"
    if stamp.exists() and stamp.read_text() == fingerprint(blender):
        return 0
    expression = INSTALL.format(project=str(ROOT / "pyproject.toml"), site=str(site))
    run([blender, "-b", "--python-expr", "import ensurepip; ensurepip.bootstrap()"])
    if run([blender, "-b", "--python-exit-code", "1", "--python-expr", expression]).returncode:
        return fail(
            "the packages that pyproject.toml wants could not be installed for Blender's Python",
            "Check the network and the disk, then try again.",
        )
    write_launcher(
        f'export PYTHONPATH="{site}"\nscript="$1"; shift\n'
        f'exec "{blender}" -b --factory-startup --python-use-system-env --python-exit-code 1 '
        '-P "$script" "$@"'
    )
    stamp.write_text(fingerprint(blender))
    return 0


def blender_version(blender: str) -> tuple[int, int] | None:
    match = re.search(r"Blender (\d+)\.(\d+)", run([blender, "--version"]).stdout)
    return (int(match[1]), int(match[2])) if match else None


def write_launcher(body: str) -> None:
    LAUNCHER.write_text(f"#!/bin/sh\n# Written by tools/setup.py: runs a script inside Blender.\n{body}\n")
    LAUNCHER.chmod(0o755)


def make_environment(name: str, python: str, requirement: str) -> int:
    """A virtual environment with this project (editable) and its extras, renewed when they change."""
    folder = VENVS / name
    stamp = folder / "physhdr.stamp"
    if stamp.exists() and stamp.read_text() == fingerprint(python):
        return 0
    print(f"[setup] {name}: installing {requirement} with {python}; minutes, the first time", flush=True)
    if not (folder / "bin" / "python").exists():
        made = run([python, "-m", "venv", folder])
        if made.returncode:
            return fail(
                f"{python} cannot make a virtual environment: {(made.stdout + made.stderr).strip()}",
                "Install its venv module (Debian: apt install python3-venv).",
            )
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    installed = run([*pip, "--editable", requirement])
    if installed.returncode:
        return fail(
            f"pip failed:\n{installed.stderr.strip()}", "Check the network and the disk, then try again."
        )
    stamp.write_text(fingerprint(python))
    return 0


def fingerprint(interpreter: str) -> str:
    """Changes when the project's requirements, how they are installed, or the interpreter do."""
    content = (ROOT / "pyproject.toml").read_bytes() + Path(__file__).read_bytes()
    return hashlib.sha256(content + interpreter.encode()).hexdigest()


def find_python(versions: tuple[str, ...]) -> str | None:
    """A working interpreter of one of ``versions``: on PATH, from pyenv, or from uv."""
    for version in versions:
        for candidate in candidates(version):
            if works(candidate, version):
                return candidate
    return None


def candidates(version: str) -> list[str]:
    found = [shutil.which(f"python{version}"), shutil.which("python3")]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found += [str(path) for path in sorted(pyenv.glob(f"{version}.*/bin/python{version}"), reverse=True)]
    if shutil.which("uv"):
        found.append(run(["uv", "python", "find", version]).stdout.strip())
    return [path for path in found if path]


def works(python: str, version: str) -> bool:
    """Whether it runs (pyenv's shims may not), is of that version, and can make environments."""
    probe = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    done = run([python, "-c", probe])
    return done.returncode == 0 and done.stdout.strip() == version


def run(command: list) -> subprocess.CompletedProcess:
    try:
        return subprocess.run([str(part) for part in command], cwd=ROOT, capture_output=True, text=True)
    except OSError as error:
        return subprocess.CompletedProcess(command, 1, "", str(error))


if __name__ == "__main__":
    sys.exit(main())
