# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a prepared data set: where it may be, and what it replaces."""

import errno
import os
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import pytest

from physhdr.backend.scene.capture.data_set import new_folder
from physhdr.bridge.errors import OutputError


def make(out: Path, content: str = "new", overwrite: bool = False) -> None:
    with new_folder(out, overwrite) as folder:
        (folder / "prepare.json").write_text(content)
        for name in ("images/train_000_0.png", "sparse/0/cameras.bin"):
            (folder / name).parent.mkdir(parents=True)
            (folder / name).write_text(content)


def refused(out: Path, overwrite: bool = False) -> str:
    with pytest.raises(OutputError) as caught, new_folder(out, overwrite):
        pytest.fail("the block must not begin")
    assert caught.value.hint
    return str(caught.value)


def test_the_working_directory_may_be_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "here"
    out.mkdir()
    monkeypatch.chdir(out)
    make(Path("."))
    assert Path("images/train_000_0.png").read_text() == "new"  # this folder, not one that took its name
    make(Path("."), "newer", overwrite=True)
    assert Path("prepare.json").read_text() == "newer"
    assert sorted(path.name for path in out.iterdir()) == ["images", "prepare.json", "sparse"]
    assert list(tmp_path.iterdir()) == [out]


def test_a_mount_point_cannot_be_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.path.ismount", lambda path: Path(path) == tmp_path)
    assert "is a mount point" in refused(tmp_path)
    make(tmp_path / "data")


def test_what_others_put_there_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "data"
    make(out)
    for name in ("run/config.json", "run/log.jsonl", "images/mine.png", "notes.txt"):
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text("mine")
    assert "did not write: images/mine.png, notes.txt, run: it is not" in refused(out, overwrite=True)
    assert (out / "run" / "config.json").read_text() == "mine"
    assert (out / "prepare.json").read_text() == "new"


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    out = tmp_path / "data"
    make(out)
    with pytest.raises(KeyboardInterrupt), new_folder(out, True) as folder:
        (folder / "prepare.json").write_text("half")
        raise KeyboardInterrupt
    assert (out / "prepare.json").read_text() == "new" and list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("at", range(6))
@pytest.mark.parametrize("failure", [OSError("full"), KeyboardInterrupt()], ids=["error", "interrupt"])
def test_a_replacement_that_fails_at_any_step_is_undone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int, failure: BaseException
) -> None:
    """Three entries go out and three come in: six renames, and the one that fails leaves what was there."""
    out = tmp_path / "data"
    make(out)
    rename, calls = Path.rename, []

    def fails_once(path: Path, target: Path) -> Path:
        calls.append(path)
        if len(calls) == at + 1:
            raise failure
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fails_once)
    with pytest.raises((OutputError, KeyboardInterrupt)):
        make(out, "newer", overwrite=True)
    assert sorted(path.read_text() for path in out.rglob("*") if path.is_file()) == ["new"] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_what_a_desktop_leaves_is_no_ones_work(tmp_path: Path) -> None:
    make(tmp_path / "data")
    for name in (".DS_Store", "images/.DS_Store", "images/Thumbs.db"):
        (tmp_path / "data" / name).write_bytes(b"")
    make(tmp_path / "data", "newer", overwrite=True)
    assert (tmp_path / "data" / "prepare.json").read_text() == "newer"


class NamesOnWindows:
    """``os`` as Windows' Python has it in ``tempfile``, which tries one name after the other there."""

    name = "nt"

    def __getattr__(self, name: str) -> object:
        return getattr(os, name)


def test_a_place_that_may_not_be_written_is_told_after_one_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def refuse(path: Path, mode: int = 0o777, **_: int) -> None:
        tried.append(path)
        raise PermissionError(errno.EACCES, "Access is denied", str(path))

    monkeypatch.setattr(os, "mkdir", refuse)
    monkeypatch.setattr(tempfile, "_os", NamesOnWindows())
    assert "Access is denied" in refused(tmp_path / "data")
    assert len([path for path in tried if path != tmp_path]) == 1


def test_nothing_is_made_for_its_maker_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On Windows mode 0700 is a list of who may, which what lies in a folder keeps wherever it is moved."""
    modes, mkdir = [], os.mkdir

    def told(path: Path, mode: int = 0o777, **options: int) -> None:
        modes.append(mode)
        mkdir(path, mode, **options)

    monkeypatch.setattr(os, "mkdir", told)
    make(tmp_path / "data")
    assert set(modes) == {0o777}


KILLED = """
    import os, signal, sys
    from pathlib import Path
    from physhdr.backend.scene.capture.data_set import new_folder
    with new_folder(Path(sys.argv[1]), False) as folder:
        (folder / "half a picture.png").write_bytes(b"half")
        print("made", flush=True)
        if len(sys.argv) == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        sys.stdin.read()
"""


def begin(out: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(KILLED), str(out), *more]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "made\n"
    return process


@pytest.mark.long
def test_what_a_killed_call_left_goes_and_what_another_is_at_stays(tmp_path: Path) -> None:
    begin(tmp_path / "data").wait()
    (left,) = tmp_path.iterdir()
    with begin(tmp_path / "data", "goes on") as running:
        (being_made,) = tmp_path.iterdir()  # the killed one's is gone
        assert being_made != left
        make(tmp_path / "data")
        assert {path.name for path in tmp_path.iterdir()} == {"data", being_made.name}
        running.kill()
    make(tmp_path / "data", "newer", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.long
def test_a_former_data_set_that_a_kill_left_aside_is_kept(tmp_path: Path) -> None:
    begin(tmp_path / "data").wait()
    (left,) = tmp_path.iterdir()
    (left / "replaced").mkdir()
    make(tmp_path / "data")
    assert {path.name for path in tmp_path.iterdir()} == {"data", left.name}
