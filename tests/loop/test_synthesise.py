# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that several Blenders render make the data set that one makes, here and on a Ray cluster."""

import hashlib
import json
from pathlib import Path

import pytest

from physhdr.backend.cli import main

LAUNCHER = Path(__file__).resolve().parents[2] / ".venvs" / "blender" / "bin" / "python"
ASKED = ["--resolution", "16", "--samples", "1", "--views", "3", "--lit-views", "0"]


@pytest.fixture(scope="module")
def one(in_blender, tmp_path_factory) -> Path:
    """What one process makes, with one thread."""
    out = tmp_path_factory.mktemp("one") / "data"
    in_blender("synth/make_scene.py", "--out", out, *ASKED, "--threads", 1)
    return out


def files(out: Path) -> dict[str, str]:
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize(
    "where",
    [
        pytest.param(["--jobs", "2"], id="here", marks=pytest.mark.long),
        pytest.param(["--ray", "local", "--parts", "2"], id="ray", marks=pytest.mark.long),
    ],
)
def test_parts_make_the_same_data_set(one, tmp_path, capsys, where):
    if "--ray" in where:
        pytest.importorskip("ray")
    blender = str(LAUNCHER) if LAUNCHER.exists() else "blender"
    out = tmp_path / "data"
    words = ["synthesise", "--blender", blender, *where, "--", "--out", str(out), *ASKED, "--threads", "1"]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "part 1 of 2: done" in told and "part 2 of 2: done" in told
    expected, found = files(one), files(out)
    assert len(expected) > 15 and found.keys() == expected.keys()
    # Smoothed normals may differ in their last bits (docs/formats.md), between any two processes.
    different = [name for name in expected if found[name] != expected[name]]
    assert len(different) < len(expected) / 4, different
    assert json.loads((out / "dataset.json").read_text())["splits"]
