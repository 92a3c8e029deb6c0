#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Install the wheel into an empty environment and train with it, outside the checkout. Needs no network.

    .venvs/backend/bin/python tools/try_wheel.py

The packages that it needs are this Python's own: pip is not asked for them. PhysHDR itself, which is there
too, is found in the new environment first. A few iterations on a small data set, then what comes after: an
evaluation, an export, a picture.
"""

import json
import os
import runpy
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from pathlib import Path

from build_dist import ROOT, BuildError, build

#: Writes a data set of 32×32 pixels.
WRITER = ROOT / "tests" / "backend" / "tiny_scene.py"
#: Asked of the new environment: which copy is imported, and what its metadata say.
ASK = """
import importlib.metadata, json, physhdr
from physhdr.backend import project
metadata = importlib.metadata.metadata("physhdr")
print(json.dumps([physhdr.__file__, project.version(), metadata["Version"], metadata["License-Expression"]]))
"""


class TrialError(Exception):
    """What an installed copy does not do."""


def main() -> int:
    begun = time.perf_counter()
    # No link on the way, so that paths can be compared.
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = attempt(Path(folder).resolve())
        except (BuildError, TrialError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(f"[wheel] {result}; {time.perf_counter() - begun:.0f} s")
    return 0


def attempt(folder: Path) -> str:
    """All of it in ``folder``; what was done, in words. Raises ``TrialError`` and ``BuildError``."""
    _, wheel = build(ROOT, folder / "dist")
    environment = folder / "environment"
    venv.EnvBuilder(symlinks=os.name != "nt").create(environment)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    python = programs / Path(sys.executable).name
    here = Path.cwd()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python]
    call([*pip, "install", "--quiet", "--no-index", "--no-deps", wheel], here)
    [site] = [path for path in environment.rglob("site-packages") if path.is_dir()]
    # After PhysHDR was installed: pip must not take the one that is there for the one to be replaced.
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")

    work = folder / "work"
    work.mkdir()
    runpy.run_path(str(WRITER))["write_tiny_scene"](work / "data")
    file, version, recorded, licence = json.loads(call([python, "-c", ASK], work))
    if not Path(file).is_relative_to(environment):
        raise TrialError(f"not the installed package was imported, but {file}")
    if version != recorded or licence != "GPL-3.0-or-later":
        raise TrialError(f"it calls itself {version}; its metadata say {recorded}, {licence}")
    physhdr = programs / "physhdr"
    call([physhdr, "train", "data", "--out", "run", "--iterations", "6"], work)
    call([physhdr, "evaluate", "run"], work)
    call([physhdr, "export", "run"], work)
    call([physhdr, "render", "run", "--view", "test/0", "--out", "view.exr"], work)
    for name in ("run/checkpoint.safetensors", "run/evaluation.json", "run/model.safetensors", "view.exr"):
        if not (work / name).is_file():
            raise TrialError(f"{name} was not written")
    return f"PhysHDR {version} was installed, and trained, evaluated, exported and drew a picture"


def call(command: list, folder: Path) -> str:
    """What a command says, run in ``folder`` without any setting of this Python's; raises ``TrialError``."""
    settings = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))
    }
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=settings, capture_output=True, text=True, check=False)
    if done.returncode:
        output = (done.stderr or done.stdout).strip()
        raise TrialError(f"{' '.join(words)} ended with {done.returncode}:\n{output}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
