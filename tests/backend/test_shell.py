# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands that are told to people: what a shell makes of them."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from physhdr.backend.shell import pip_install


def test_pip_is_the_one_of_this_python(monkeypatch) -> None:
    monkeypatch.setattr(sys, "executable", "/home/me/venv/bin/python")
    assert pip_install("usd-core") == "/home/me/venv/bin/python -m pip install usd-core"
    words = shlex.split(pip_install("av>=13", upgrade=True))
    assert words[1:] == ["-m", "pip", "install", "--upgrade", "av>=13"]


@pytest.mark.skipif(os.name == "nt", reason="needs a POSIX shell")
def test_a_python_in_a_folder_with_a_space_is_found(tmp_path: Path, monkeypatch) -> None:
    """As on macOS, where extensions are in Application Support."""
    python = tmp_path / "Application Support" / "python"
    python.parent.mkdir()
    python.write_text('#!/bin/sh\necho "$@"\n', encoding="ascii")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    told = subprocess.run(pip_install("numpy>=2"), shell=True, capture_output=True, text=True, check=True)
    assert told.stdout == "-m pip install numpy>=2\n"
