#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Set up the two environments that PhysHDR needs, or say what to install. Standard library only.

    python3 tools/setup.py [backend] [blender]

``backend``: .venvs/backend, Python ≥ 3.11 with torch (CPU), for training.
``blender``: .venvs/blender, Python 3.13 with the ``bpy`` wheel; where only a ``blender`` ≥ 5.2 is on PATH,
a launcher that runs it. Either way ``.venvs/run-blender SCRIPT -- ARGS`` runs a script inside Blender.
Does nothing where an environment is up to date.

pip installs, not uv, although tools/lock.py resolves with it: pip comes with Python, and a second installer
would be one more requirement or a second way. What is installed is what the locks name, file by file (locks/,
tools/lock.py): pip refuses whatever has another SHA-256, and builds nothing but this project. torch is taken
from PyTorch's own index, without CUDA; where that cannot be reached, from wherever pip is set up to look:
PyPI's build for Linux has CUDA, and its libraries come with it.
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
LOCKS = ROOT / "locks"
LAUNCHER = VENVS / "run-blender"
BLENDER_PYTHON = (3, 13)
BLENDER_MINIMUM = (5, 2)
#: Preferred first: the version whose CPU build of torch is tested.
BACKEND_CANDIDATES = ("3.11", "3.12", "3.13", "3.14")
PYTORCH = "https://download.pytorch.org/whl/cpu"
#: Of pip, when it asks PyTorch's index: what cannot be reached is given up after half a minute, not two.
BRIEFLY = ("--retries", "1", "--timeout", "15")
#: A lock is all that is needed, torch apart: pip adds nothing, and runs no code of what it installs.
LOCKED = ("--no-deps", "--require-hashes", "--only-binary=:all:")
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
    return make_environment("backend", python, ("backend.txt", "develop.txt"), torch=True)


def set_up_blender() -> int:
    python = find_python((f"{BLENDER_PYTHON[0]}.{BLENDER_PYTHON[1]}",))
    if python is None:
        return set_up_blender_binary()
    problem = make_environment("blender", python, ("bpy.txt", "blender.txt"))
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


#: Run by Blender's Python: what our side needs beside bpy, which it is, into the folder SITE.
INSTALL = """
import subprocess, sys
pip = [sys.executable, "-m", "pip", "install", "--quiet", "--upgrade", "--target", {site!r}, "--no-deps"]
sys.exit(subprocess.call([*pip, "--require-hashes", "--only-binary=:all:", "-r", {lock!r}]))
"""


def set_up_blender_binary() -> int:
    """No Python 3.13: use the ``blender`` on PATH, with what our side of it needs in a folder of its own."""
    blender = shutil.which("blender")
    version = blender_version(blender) if blender else None
    if blender is None or version is None or version < BLENDER_MINIMUM:
        found = f"the blender on PATH is {version}" if version else "no blender is on PATH"
        return fail(
            f"no Python 3.13 was found for Blender's bpy wheel, and {found}",
            "Install Blender 5.2 or newer and put it on PATH, or Python 3.13 (uv python install 3.13).",
        )
    site = VENVS / "blender-site"
    stamp = VENVS / "blender-site.stamp"
    if stamp.exists() and stamp.read_text() == fingerprint(blender):
        return 0
    expression = INSTALL.format(lock=str(LOCKS / "blender.txt"), site=str(site))
    run([blender, "-b", "--python-expr", "import ensurepip; ensurepip.bootstrap()"])
    if run([blender, "-b", "--python-exit-code", "1", "--python-expr", expression]).returncode:
        return fail(
            "the packages of locks/blender.txt could not be installed for Blender's Python",
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


def make_environment(name: str, python: str, locks: tuple[str, ...], torch: bool = False) -> int:
    """A virtual environment with what ``locks`` name and this project, editable; renewed when they change."""
    folder = VENVS / name
    stamp = folder / "physhdr.stamp"
    if stamp.exists() and stamp.read_text() == fingerprint(python):
        return 0
    print(f"[setup] {name}: installing {', '.join(locks)} with {python}; minutes, the first time", flush=True)
    if not is_whole(folder):
        made = run([python, "-m", "venv", "--clear", folder])
        if made.returncode:
            return fail(
                f"{python} cannot make a virtual environment: {(made.stdout + made.stderr).strip()}",
                "Install its venv module (Debian: apt install python3-venv).",
            )
    pip = [folder / "bin" / "python", "-m", "pip", "--disable-pip-version-check"]
    install = [*pip, "install", "--quiet"]
    steps = [lambda: run([*install, *LOCKED, *from_locks(*locks)])]
    steps += [lambda: install_torch(name, install)] if torch else []
    steps += [lambda: complete(name, pip)]
    # What would build it comes from the lock, and its requirements are there.
    steps += [lambda: run([*install, "--no-build-isolation", "--no-deps", "--editable", "."])]
    for step in steps:
        done = step()
        if done.returncode:
            return fail_pip(done)
    stamp.write_text(fingerprint(python))
    return 0


def is_whole(folder: Path) -> bool:
    """Whether an environment is there that was made to its end, and for this place: its scripts name it."""
    script = folder / "bin" / "activate"  # the last that is written
    text = script.read_text() if script.exists() else ""
    # As it was called when it was made: .venvs may be a link.
    named = any(
        re.search(rf"""[='" ]{re.escape(str(each))}["')\s]""", text) for each in (folder, folder.resolve())
    )
    return named and run([folder / "bin" / "python", "-m", "pip", "--version"]).returncode == 0


def from_locks(*names: str) -> list:
    return [word for name in names for word in ("-r", LOCKS / name)]


def install_torch(name: str, install: list) -> subprocess.CompletedProcess:
    """torch alone, from PyTorch's own index and no other; from pip's own settings where it cannot be had."""
    wanted = [*LOCKED, *from_locks("torch.txt")]
    # pip's settings may name more indexes, and any of them may offer a torch: this one takes their place.
    only = {"PIP_EXTRA_INDEX_URL": PYTORCH}
    done = run([*install, "--index-url", PYTORCH, *BRIEFLY, *wanted], only)
    if done.returncode and "No matching distribution found" in done.stderr:
        print(f"[setup] {name}: no torch from {PYTORCH}; from where pip is set up to look", flush=True)
        return run([*install, *wanted])
    return done


def complete(name: str, pip: list) -> subprocess.CompletedProcess:
    """Whether all that packages ask for is there; a torch with CUDA gets its libraries first."""
    done = run([*pip, "check"])
    if done.returncode and re.search(r"^torch .* which is not installed", done.stdout, re.MULTILINE):
        print(f"[setup] {name}: this torch has CUDA: fetching its libraries, several GB", flush=True)
        done = run([*pip, "install", "--quiet", *LOCKED, *from_locks("torch-cuda.txt")])
        return run([*pip, "check"]) if done.returncode == 0 else done
    return done


def fail_pip(done: subprocess.CompletedProcess) -> int:
    output = done.stderr.strip() or done.stdout.strip()
    output = output[max(output.find("ERROR"), 0) :]
    if "DO NOT MATCH THE HASHES" in output:
        return fail(
            f"a package is not the file that was locked; it was not installed:\n{output}",
            "Somebody may have exchanged it: see where it came from (pip config list). If it was pip's "
            "cache: pip cache purge. If the lock is what is wrong: make lock.",
        )
    return fail(f"pip failed:\n{output}", "Check the network and the disk, then try again.")


def fingerprint(interpreter: str) -> str:
    """Changes when the project's requirements or locks, how they are installed, or the interpreter do.

    So it does when the checkout is moved: what is installed of it names its place.
    """
    files = [ROOT / "pyproject.toml", Path(__file__), *sorted(LOCKS.glob("*.txt"))]
    content = b"".join(path.read_bytes() for path in files)
    return hashlib.sha256(content + interpreter.encode() + os.fsencode(ROOT)).hexdigest()


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


def run(command: list, more: dict[str, str] | None = None) -> subprocess.CompletedProcess:
    """The command's output and exit status; ``more``: added to the environment."""
    # Where pip's settings say "user", it would refuse to install into an environment.
    words, environment = [str(part) for part in command], {**os.environ, "PIP_USER": "0", **(more or {})}
    try:
        return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=environment)
    except OSError as error:
        return subprocess.CompletedProcess(command, 1, "", str(error))


if __name__ == "__main__":
    sys.exit(main())
