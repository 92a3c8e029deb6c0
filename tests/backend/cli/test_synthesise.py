# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that several programs render, and the last step that completes the data set, with a false Blender."""

import pickle
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from physhdr.backend.cli import main
from physhdr.backend.cli.synthesise import SCRIPT
from physhdr.backend.jobs.pools import LocalPool, Outcome

#: Notes how it is called. ``--out fails``: its second part fails; ``waits``, ``lasts``: parts, or what comes
#: after them, never end.
FALSE_BLENDER = """#!/bin/sh
if [ "$1" = --version ]; then echo "{version}"; exit; fi
echo "$@" >> "{calls}"
case "$*" in *--part*) last="" ;; *) last="_last" ;; esac
case "$*$last" in
    *fails*"--part 2/"*) echo "first line"; echo "error: no card"; echo "Blender quit"; exit 3 ;;
    *refused*) echo "error: refused" >&2; exit 1 ;;
    *waits* | *lasts_last) sleep 1000 ;;
esac
"""


@pytest.fixture
def blender(tmp_path, monkeypatch):
    """A program that says it is Blender, in the folder where the command is given."""
    monkeypatch.chdir(tmp_path)

    def make(version="Blender 5.2.0"):
        path = tmp_path / "blender"
        path.write_text(FALSE_BLENDER.format(version=version, calls=tmp_path / "calls.txt"))
        path.chmod(0o755)
        return path

    return make


def calls(folder: Path) -> list[str]:
    return (folder / "calls.txt").read_text().splitlines()


@pytest.mark.parametrize(
    ("version", "start"),
    [
        ("Blender 5.2.0\n\tbuild date: 2026-06-16", "--background --python-exit-code 1 --python "),
        ("Python 3.13.1", ""),
    ],
)
def test_every_part_is_rendered_and_then_the_rest(blender, tmp_path, version, start):
    words = ["--blender", blender(version), "--jobs", 2, "--parts", 3, "--threads-per-job", 2]
    assert main(["synthesise", *map(str, words), "--", "--out", "data", "--views", "6"]) == 0
    begun = f"{start}{SCRIPT} -- --out data --views 6"
    *parts, last = calls(tmp_path)
    assert sorted(parts) == [f"{begun} --part {k}/3 --threads 2" for k in (1, 2, 3)] and last == begun
    assert not (tmp_path / "data").exists()  # the false one has made nothing, and nothing is left of ours


def test_as_many_parts_as_jobs_and_one_that_fails_is_left_to_the_last_step(blender, tmp_path, capsys):
    assert main(["synthesise", "--blender", str(blender()), "--jobs", "2", "--", "--out=fails"]) == 0
    told = capsys.readouterr().out
    assert "part 1 of 2: done" in told and "part 2 of 2: failed: error: no card" in told
    assert len(calls(tmp_path)) == 3


def test_what_make_scene_refuses_is_the_status(blender, tmp_path):
    assert main(["synthesise", "--blender", str(blender()), "--", "--out", "refused"]) == 1
    assert not (tmp_path / "refused").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "make_scene.py's own options are missing"),
        (["--"], "make_scene.py's own options are missing"),
        (["--", "--views", "6", "--out"], "make_scene.py's own options are missing"),
        (["--", "--out", "data", "--part", "1/2"], "--part is set by physhdr synthesise"),
        (["--", "--out", "data", "--from-file=current"], "others cannot see"),
        (["--jobs", "0", "--", "--out", "data"], "--jobs is 0"),
        (["--parts", "0", "--", "--out", "data"], "--parts is 0"),
        (["--blender", "no-blender", "--", "--out", "data"], "there is no program 'no-blender'"),
        (["--blender", "true", "--", "--out", "data"], "is neither Blender nor a Python"),
    ],
)
def test_what_cannot_be_is_one_clear_message(blender, tmp_path, capsys, words, said):
    given = words if "--blender" in words else ["--blender", str(blender()), *words]
    assert main(["synthesise", *given]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "data").exists() and not (tmp_path / "calls.txt").exists()


@pytest.mark.parametrize(("out", "called", "asleep"), [("waits", 2, 2), ("lasts", 3, 1)])
def test_a_polite_end_ends_the_parts_and_the_last_step(blender, tmp_path, out, called, asleep):
    command = [Path(sys.executable).with_name("physhdr"), "synthesise", "--blender", blender(), "--jobs", "2"]
    process = subprocess.Popen([*map(str, command), "--", "--out", out], cwd=tmp_path)
    deadline = time.monotonic() + 60
    while len(sleeping := _sleeping(psutil.Process(process.pid).children(recursive=True))) < asleep:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == 130
    assert not _sleeping(sleeping) and not (tmp_path / out).exists() and len(calls(tmp_path)) == called


def _sleeping(family: list[psutil.Process]) -> list[psutil.Process]:
    """What false Blenders have started and is alive."""
    found = []
    for each in family:
        with suppress(psutil.NoSuchProcess):
            if each.name() == "sleep" and each.status() != psutil.STATUS_ZOMBIE:
                found.append(each)
    return found


class Elsewhere(LocalPool):
    """Does each job in a process that begins in another folder, as a machine of a cluster does."""

    def __init__(self, address: str, threads: int) -> None:
        super().__init__(2)
        self.folder = Path(address)

    def submit(self, name, work):
        there = "import pickle, sys; print(pickle.load(sys.stdin.buffer)(lambda: False).kind)"

        def done(_):
            command = [sys.executable, "-c", there]
            ended = subprocess.run(command, input=pickle.dumps(work), capture_output=True, cwd=self.folder)
            return Outcome(ended.stdout.decode().strip(), ended.stderr.decode())

        super().submit(name, done)


def test_a_relative_folder_is_the_same_on_every_machine(blender, tmp_path, monkeypatch, capsys):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr("physhdr.backend.cli.synthesise.RayPool", Elsewhere)
    words = ["--blender", str(blender()), "--ray", str(elsewhere), "--", "--out", "data"]
    assert main(["synthesise", *words]) == 0
    told = capsys.readouterr().out
    assert "part 1 of 2: done" in told and "part 2 of 2: done" in told, told
    assert not list(elsewhere.iterdir()) and not (tmp_path / "data").exists()
