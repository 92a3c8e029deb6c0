# SPDX-License-Identifier: GPL-3.0-or-later
"""What is shown is what was said, and a training goes on when nobody can be shown it."""

import os
import shlex
import subprocess
import sys
from pathlib import Path, PureWindowsPath
from types import SimpleNamespace

import pytest
from rich.table import Table

from physhdr.backend import shell
from physhdr.backend.runs.terminal import aside, console
from physhdr.backend.shell import as_word

#: Shows a training's events on the stdout that it is given; whatever is raised is its exit status.
SHOWS = """
import sys
from physhdr.backend.runs.terminal import TrainingBar, aside
from physhdr.backend.train.events import Finished, Progress, Started
bar = TrainingBar()
bar.start()
aside.print("reading the data set")
bar.show(Started(0, 9, 1, "x"))
bar.show(Progress(9, 9, 1, {"rec": 1.0}, 1.0, 0.0, {}))
bar.show(Finished(9, 1.0, 1.0, False, ""))
bar.stop()
sys.stderr.write("trained")
"""


@pytest.mark.parametrize("said", [console, aside])
def test_a_path_is_shown_as_it_is_and_whole(said, capsys):
    """Brackets are markup to rich, colons emoji, and a width of 80 characters would break it."""
    path = f"/runs/room [best]/a :smile: [/b] {'x' * 100}/run"
    said.print(f"wrote {path}")
    assert capsys.readouterr().out == f"wrote {path}\n"


def test_a_table_keeps_to_the_terminals_width(capsys):
    table = Table("a column")
    table.add_row("words " * 50)
    console.print(table)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= console.width


def shown_on(stdout) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", SHOWS], stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=120
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_training_goes_on_where_what_it_shows_finds_no_room():
    with open("/dev/full", "w") as full:
        done = shown_on(full)
    assert (done.returncode, done.stderr) == (0, "trained")


def test_a_training_goes_on_when_its_reader_is_gone():
    """As ``head`` is, and ``tee`` when it is killed."""
    reader, writer = os.pipe()
    os.close(reader)
    done = shown_on(writer)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "trained")


@pytest.mark.skipif(os.name == "nt", reason="POSIX's shell")
def test_a_path_in_a_command_can_be_copied_with_it():
    path = Path("/runs/the dog's room/[1] $HOME")
    assert shlex.split(f"physhdr train --resume {as_word(path)}")[-1] == str(path)
    assert as_word(Path("/runs/dog")) == "/runs/dog"


@pytest.mark.parametrize(
    ("path", "word"),
    [
        (r"D:\runs\größe_1.2-x", r"D:\runs\größe_1.2-x"),
        (r"C:\R&D\run", r'"C:\R&D\run"'),  # cmd: another command
        (r"C:\a^b\100%", r'"C:\a^b\100%"'),
        (r"D:\a;b\run", r'"D:\a;b\run"'),  # PowerShell: another command
        (r"D:\a,b\run", r'"D:\a,b\run"'),  # PowerShell: two words
        (r"D:\Tom's\run", r'"D:\Tom' + "'" + r's\run"'),
        (r"D:\my run (2)", r'"D:\my run (2)"'),
        ("\\\\server\\my share\\", '"\\\\server\\my share\\\\"'),
    ],
)
def test_a_path_is_one_word_in_both_of_windows_shells(path, word, monkeypatch):
    monkeypatch.setattr(shell, "os", SimpleNamespace(name="nt"))
    assert as_word(PureWindowsPath(path)) == word
