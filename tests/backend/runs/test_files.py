# SPDX-License-Identifier: GPL-3.0-or-later
"""A run that is replaced is gone as a whole, and what is not a run's is not touched."""

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.backend.runs.files import remove_results, writable_folder
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.bridge.errors import OutputError

SHORT = ["--iterations", "12", "--set", "sh_degree_every=5"]
CHECKPOINT = "checkpoint.safetensors"


class NamesOnWindows:
    """``os`` as Windows' Python has it in ``tempfile``, which tries one name after the other there."""

    name, O_TEMPORARY = "nt", 0

    def __getattr__(self, name):
        return getattr(os, name)


def test_a_folder_that_may_not_be_written_is_told_after_one_try(tmp_path, monkeypatch):
    tried = []

    def refuse(path, *_, opener=None, **__):
        if opener is not None:
            return opener(path, os.O_RDWR)
        tried.append(path)
        raise PermissionError(errno.EACCES, "Access is denied", str(path))

    with monkeypatch.context() as refusing:
        for module in (os, io):
            refusing.setattr(module, "open", refuse)
        refusing.setattr(tempfile, "_os", NamesOnWindows())
        refusing.setattr(tempfile, "TemporaryFile", tempfile.NamedTemporaryFile)
        with pytest.raises(OutputError, match=r"cannot write to .*: Access is denied"):
            writable_folder(tmp_path)
    assert len(tried) == 1
    assert writable_folder(tmp_path) == tmp_path and not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def trained(tiny_data, tmp_path_factory):
    """A run with everything that the commands leave in its folder."""
    run = tmp_path_factory.mktemp("runs") / "run"
    assert main(["train", str(tiny_data), "--out", str(run), *SHORT]) == 0
    assert main(["evaluate", str(run), "--confidence"]) == 0 and main(["export", str(run)]) == 0
    assert main(["export", str(run), str(run / "web"), "--web"]) == 0
    return run


@pytest.fixture
def run(trained, tmp_path):
    """A copy of it."""
    folder = tmp_path / "run"
    folder.mkdir()
    for path in trained.iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    shutil.copytree(trained / "web", folder / "web")
    return folder


def physhdr(*words, **options):
    command = [Path(sys.executable).with_name("physhdr"), *words]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )


@pytest.mark.long
def test_nothing_old_survives_a_kill_after_the_new_configuration(run, tiny_data, capsys):
    """As attacked: replaced, killed right after "training from", resumed."""
    replaced = physhdr(
        "train", tiny_data, "--out", run, "--overwrite", "--preset", "fast", "--seed", "77",
        *("--iterations", "100000"), env={**os.environ, "PYTHONUNBUFFERED": "1"}
    )  # fmt: skip
    for line in replaced.stdout:
        if "training from" in line:
            break
    replaced.send_signal(signal.SIGKILL)
    replaced.wait()
    replaced.stdout.close()
    assert json.loads((run / "config.json").read_text())["config"]["seed"] == 77
    left = {path.name for path in run.iterdir() if not path.name.startswith(("training.", "tensorboard"))}
    assert left <= {"config.json", "log.jsonl", "views.json"}  # of the new one
    for command in (["train", "--resume"], ["evaluate"], ["export"]):
        assert main([*command, str(run)]) == 1
        assert "there is no checkpoint" in capsys.readouterr().err


def test_of_a_folder_web_only_a_page_of_ours_goes_and_what_it_lists(run):
    (run / "web" / "notes.txt").write_text("mine")
    remove_results(run)
    assert [path.name for path in (run / "web").iterdir()] == ["notes.txt"]
    (run / "web" / "index.html").write_text("<title>mine</title>")
    (run / "web" / "viewer.js").write_text("mine")
    remove_results(run)
    assert len(list((run / "web").iterdir())) == 3


@pytest.mark.parametrize("command", [["train", "--resume"], ["evaluate"], ["export"]])
def test_old_weights_under_another_configuration_are_refused(command, run, tiny_data, tmp_path, capsys):
    """However they came together: a copy, a crash of an older PhysHDR."""
    other = tmp_path / "other"
    words = ["--preset", "fast", "--seed", "77", "--iterations", "12"]
    assert main(["train", str(tiny_data), "--out", str(other), *words]) == 0
    (run / "config.json").write_bytes((other / "config.json").read_bytes())
    capsys.readouterr()
    assert main([*command, str(run)]) == 1
    message = capsys.readouterr().err
    assert "another configuration" in message and "Traceback" not in message
    assert CHECKPOINT in message


def test_a_new_training_that_cannot_begin_leaves_the_old_run_whole(run, tmp_path, capsys):
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    assert main(["train", str(tmp_path / "nothing"), "--out", str(run), "--overwrite"]) == 1
    assert before == {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}


def test_a_folder_of_somebody_else_s_is_left_alone(tiny_data, tmp_path, capsys):
    (tmp_path / "config.json").write_text('{"an editor": "s settings"}')
    (tmp_path / "comparison.png").write_text("mine")
    for more in ([], ["--overwrite"]):
        assert main(["train", str(tiny_data), "--out", str(tmp_path), *SHORT, *more]) == 1
        assert "config.json is not a run's configuration" in capsys.readouterr().err
    assert (tmp_path / "config.json").read_text() == '{"an editor": "s settings"}'
    assert {path.name for path in tmp_path.iterdir()} == {"config.json", "comparison.png"}


def test_a_training_removes_nothing_from_a_folder_that_held_no_run(tiny_data, tmp_path, capsys):
    """Files of the names that ours have are the user's own there."""
    own = {
        "model.safetensors": b"a model of mine",
        "methods.md": b"my notes",
        "log.jsonl": b"a log of mine\n",
    }
    for name, content in own.items():
        (tmp_path / name).write_bytes(content)
    assert main(["train", str(tiny_data), "--out", str(tmp_path), *SHORT, "--overwrite"]) == 0
    for name, content in own.items():
        assert (tmp_path / name).read_bytes().startswith(content)
    capsys.readouterr()
    assert main(["export", str(tmp_path)]) == 1
    assert "not a PhysHDR model" in capsys.readouterr().err
    assert (tmp_path / "model.safetensors").read_bytes() == b"a model of mine"


def test_weights_without_a_configuration_are_not_replaced(tiny_data, tmp_path, capsys):
    (tmp_path / CHECKPOINT).write_bytes(b"of another program")
    assert main(["train", str(tiny_data), "--out", str(tmp_path), *SHORT, "--overwrite"]) == 1
    assert "has no configuration and would be" in capsys.readouterr().err
    assert (tmp_path / CHECKPOINT).read_bytes() == b"of another program"


@pytest.mark.long
def test_two_trainings_in_one_folder(tiny_data, tmp_path, capsys):
    """The second is refused whatever it wants, the first one is not disturbed."""
    run = tmp_path / "run"
    first = physhdr("train", tiny_data, "--out", run, "--iterations", "100000", "--checkpoint-seconds", "0")
    try:
        deadline = time.monotonic() + 120
        while not (run / CHECKPOINT).exists():
            assert first.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        for words in (
            ["train", str(tiny_data), "--out", str(run), "--overwrite"],
            ["train", "--resume", str(run)],
        ):
            assert main(words) == 1
            message = capsys.readouterr().err
            assert f"is being trained already by process {first.pid} on " in message
        reached = set()
        while len(reached) < 5:  # every read meets a whole file
            reached.add(load_checkpoint(run / CHECKPOINT)[1]["iteration"])
            assert first.poll() is None and time.monotonic() < deadline
    finally:
        first.send_signal(signal.SIGTERM)  # as a cluster ends a job: it saves
    said, _ = first.communicate(timeout=60)
    assert first.returncode == 130 and "to resume: physhdr train --resume" in said
    assert int(load_checkpoint(run / CHECKPOINT)[1]["iteration"]) >= max(map(int, reached))
    assert not [path for path in run.iterdir() if path.name.startswith((".", "training."))]


def test_what_a_killed_training_had_begun_to_write_goes(run):
    for name in (
        ".checkpoint-ab12cdef.tmp.safetensors",
        ".config-01234567.tmp.json",
        ".views-92f25f0b.tmp.json",
        ".tmpkGAOr4",
    ):
        (run / name).write_bytes(b"half")
    for name in (".checkpoint-notours.safetensors", "mine.partial", ".tmpnotes.txt"):
        (run / name).write_bytes(b"somebody's")
    assert main(["train", "--resume", str(run)]) == 0
    hidden = {path.name for path in run.iterdir() if path.name.startswith(".") or path.suffix == ".partial"}
    assert hidden == {".checkpoint-notours.safetensors", "mine.partial", ".tmpnotes.txt"}
