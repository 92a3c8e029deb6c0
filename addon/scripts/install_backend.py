# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the backend's own environment: run by the Python that is to be its base, standard library only.

    python install_backend.py --target FOLDER --launcher EXTENSION/backend/launch.py --torch cpu

The environment is made under a name that says what is in it, and is complete or not used at all; others are
removed when it is. Says how far it is as one JSON object a line (addon/session/task.py).
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path

MINIMUM = (3, 11)
STAMP = "physhdr-complete.json"
PREFIX = "environment-"
#: Bytes that an environment needs, unpacking included: measured 1.2 GB with torch for the CPU.
SPACE = {"cpu": 3 << 30, "cuda": 12 << 30, "pip": 3 << 30}
#: Where pip finds torch beside its usual places. PyPI's is CUDA's for Linux, the processor's elsewhere.
TORCH_INDEX = {
    "cpu": "https://download.pytorch.org/whl/cpu",
    "cuda": "https://download.pytorch.org/whl/cu128" if os.name == "nt" else "",
    "pip": "",
}
#: The project's extras that each build needs.
EXTRAS = {"cpu": ("backend",), "cuda": ("backend", "cuda"), "pip": ("backend",)}
#: About how many packages come with the requirements, for the progress bar.
PACKAGES = 55


class InstallError(Exception):
    """Something the user can mend: a message and a hint."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


def say(**content: object) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


class Lines:
    """The lines that a program writes, as it writes them; then its exit ``status``."""

    def __init__(self, command: list[str]) -> None:
        self.command, self.status = command, 0

    def __iter__(self) -> Iterator[str]:
        process = subprocess.Popen(
            self.command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        assert process.stdout is not None
        yield from process.stdout
        self.status = process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--target", type=Path, required=True)
    parser.add_argument("--launcher", type=Path, required=True)
    parser.add_argument("--torch", choices=tuple(TORCH_INDEX), default="cpu")
    parser.add_argument("--fresh", action="store_true", help="make it anew even if it is complete")
    options = parser.parse_args()
    try:
        python = install(options.target, options.launcher, options.torch, options.fresh)
        return check(python, options.launcher)
    except InstallError as error:
        say(error={"code": "install_failed", "message": error.message, "hint": error.hint})
        return 1
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        say(error={"code": "install_failed", "message": f"{error.strerror}{where}", "hint": "See the log."})
        return 1
    except KeyboardInterrupt:
        return 130


def install(target: Path, launcher: Path, torch: str, fresh: bool) -> Path:
    """The interpreter of a complete environment in ``target``, made where there is none."""
    if sys.version_info < MINIMUM:
        raise InstallError(
            f"Python {sys.version.split()[0]} is too old for the backend", "Choose Python 3.11 or newer."
        )
    requirements = []
    for extra in EXTRAS[torch]:
        command = [sys.executable, str(launcher), "requirements", extra]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise InstallError(
                f"cannot read the requirements: {done.stderr.strip()}", "Reinstall the extension."
            )
        requirements += done.stdout.splitlines()
    identity = json.dumps([sorted(requirements), torch, sys.version, sys.base_prefix])
    folder = target / (PREFIX + hashlib.sha256(identity.encode()).hexdigest()[:12])
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if (folder / STAMP).exists() and not fresh:
        say(progress=0.8, message="the environment is there already")
        return python
    target.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(target).free
    if free < SPACE[torch]:
        raise InstallError(
            f"{target} has {free / 1e9:.1f} GB free; the backend needs {SPACE[torch] / 1e9:.0f} GB",
            "Free some space, or set another folder in the extension's preferences.",
        )
    try:
        say(progress=0.01, message=f"making an environment with {sys.executable}")
        venv.EnvBuilder(with_pip=True, clear=True, symlinks=os.name != "nt").create(folder)
        pip_install(python, requirements, TORCH_INDEX[torch])
        (folder / STAMP).write_text(identity, encoding="utf-8")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    for other in target.glob(PREFIX + "*"):
        if other != folder:
            shutil.rmtree(other, ignore_errors=True)
    return python


def pip_install(python: Path, requirements: list[str], index: str) -> None:
    """pip with a line of progress for each package."""
    command = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    command += ["--progress-bar", "off", *(["--extra-index-url", index] if index else []), *requirements]
    collected, last = 0, ""
    lines = Lines(command)
    for line in lines:
        sys.stdout.write(line)
        last = line.strip() or last
        if line.startswith("Collecting "):
            collected += 1
            share = min(collected / PACKAGES, 1.0)
            say(progress=0.05 + 0.55 * share, message=f"fetching {line.split()[1]}")
        elif line.lstrip().startswith("Downloading "):
            say(progress=0.05 + 0.55 * min(collected / PACKAGES, 1.0), message=line.strip()[:80].lower())
        elif line.startswith("Installing collected"):
            say(progress=0.62, message="unpacking: a minute or two")
    if lines.status:
        raise InstallError(
            f"pip could not install the backend's packages: {last}",
            "Check the network and the disk, then install again; the log has all of pip's lines.",
        )


def check(python: Path, launcher: Path) -> int:
    """Run the backend's own check and pass its lines on, in the last fifth of the progress bar."""
    lines = Lines([str(python), str(launcher), "check", "--json"])
    for line in lines:
        try:
            content = json.loads(line) if line.startswith("{") else {}
        except ValueError:
            content = {}
        if "progress" in content:
            say(**{**content, "progress": round(0.8 + 0.2 * content["progress"], 4)})
        elif "result" in content:
            say(result={**content["result"], "environment": str(python)})
        else:
            sys.stdout.write(line)
            sys.stdout.flush()
    return lines.status


if __name__ == "__main__":
    sys.exit(main())
