# SPDX-License-Identifier: GPL-3.0-or-later
"""What the loop's tests share: Blender as a program, and a small data set that it renders once."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
BLENDER = ROOT / ".venvs" / "run-blender"
#: Sides of the data set's pictures.
SIZE = 64


def run_in_blender(script: str | Path, *arguments, timeout: float = 600.0, **environment: str) -> str:
    """Run a script of this repository inside Blender; its output. Fails with it where Blender fails."""
    if not BLENDER.exists():
        pytest.skip("no Blender side: run make setup")
    command = [BLENDER, ROOT / script, "--", *arguments]
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=timeout,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="session")
def in_blender() -> Callable[..., str]:
    return run_in_blender


@pytest.fixture(scope="session")
def data(tmp_path_factory) -> Path:
    """The interior at 64×64: 6 training and 6 test views, 4 under other light, one relit."""
    folder = tmp_path_factory.mktemp("loop") / "data"
    options = ["--resolution", SIZE, "--samples", 8, "--views", 12, "--lit-views", 4, "--relit-views", 1]
    run_in_blender("synth/make_scene.py", "--out", folder, *options, "--ambient-levels", "4")
    return folder
