# SPDX-License-Identifier: GPL-3.0-or-later
"""A file is there complete or not at all, whoever writes it, however it is interrupted."""

import errno
import os
import signal
import stat
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

from physhdr.bridge import atomic
from physhdr.bridge.atomic import ABANDONED_SECONDS, atomic_path, remove_leftovers
from physhdr.bridge.errors import OutputError

WRITES_FOR_EVER = """
    import sys, time
    from pathlib import Path
    from physhdr.bridge.atomic import atomic_path
    with atomic_path(Path(sys.argv[1])) as temporary:
        temporary.write_text("half")
        print(temporary, flush=True)
        time.sleep(60)
"""


def write(path: Path, text: str, **options):
    with atomic_path(path, **options) as temporary:
        assert temporary.parent == path.parent and (temporary.suffix == path.suffix or not path.suffix)
        temporary.write_text(text)


@pytest.fixture
def killed(tmp_path):
    """What a process that was killed while it wrote ``tmp_path / "a.json"`` has left behind."""
    command = [sys.executable, "-c", textwrap.dedent(WRITES_FOR_EVER), str(tmp_path / "a.json")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    left = Path(process.stdout.readline().strip())
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    return left


def test_a_file_appears_whole_and_nothing_else_does(tmp_path):
    write(tmp_path / "new" / "a.json", "first")
    write(tmp_path / "new" / "a.json", "second")
    assert (tmp_path / "new" / "a.json").read_text() == "second"
    assert os.listdir(tmp_path / "new") == ["a.json"]


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
def test_whoever_is_interrupted_leaves_what_was_there(tmp_path, error):
    write(tmp_path / "a.json", "whole")
    with pytest.raises(error), atomic_path(tmp_path / "a.json") as temporary:
        temporary.write_text("half")
        raise error
    assert (tmp_path / "a.json").read_text() == "whole" and os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_is_one_error_with_the_callers_remedy(tmp_path, monkeypatch, call):
    """Some disks (over a network) tell that they are full only when what was written is to be on them."""
    write(tmp_path / "a.json", "whole")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(*((os, call) if call == "fsync" else (Path, call)), full)
    with pytest.raises(OutputError, match=r"a\.json: No space left on device\s+Make room"):
        write(tmp_path / "a.json", "more", remedy="Make room.")
    monkeypatch.undo()
    assert (tmp_path / "a.json").read_text() == "whole" and os.listdir(tmp_path) == ["a.json"]


def test_it_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """And the name, too, when the call returns: a power cut leaves the old file or the new one."""
    done, fsync, replace = [], os.fsync, Path.replace

    def noted_sync(descriptor):
        done.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")
        fsync(descriptor)

    def noted_replace(source, target):
        done.append("name")
        return replace(source, target)

    monkeypatch.setattr(os, "fsync", noted_sync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    write(tmp_path / "a.json", "text")
    write(tmp_path / "b.json", "text", sync_name=False)
    assert done == ["file", "name", "folder", "file", "name"]


def test_a_folder_that_cannot_be_synced_is_no_error(tmp_path, monkeypatch):
    fsync = os.fsync

    def refuse(descriptor):
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", refuse)
    write(tmp_path / "a.json", "text")
    assert (tmp_path / "a.json").read_text() == "text"


def test_the_mode_is_what_open_gives_or_the_one_that_was_asked_for(tmp_path):
    before = os.umask(0o027)
    try:
        write(tmp_path / "usual", "text")
        with atomic_path(tmp_path / "secret", mode=0o600) as temporary:
            assert stat.S_IMODE(temporary.stat().st_mode) == 0o600  # there is no moment at which it is open
        with atomic_path(tmp_path / "replaced") as temporary:
            other = tmp_path / "other"
            other.touch(mode=0o600)
            other.replace(temporary)  # as libraries do that write by a rename of their own
    finally:
        os.umask(before)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    assert modes == {"usual": 0o640, "secret": 0o600, "replaced": 0o640}


def test_of_many_that_write_at_once_one_wins_whole(tmp_path):
    texts = [str(k) * 100_000 for k in range(8)]
    threads = [threading.Thread(target=write, args=(tmp_path / "a.txt", text)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (tmp_path / "a.txt").read_text() in texts and os.listdir(tmp_path) == ["a.txt"]


def test_what_a_killed_one_left_goes_an_hour_later_when_the_file_is_written_again(tmp_path, killed):
    assert killed.read_text() == "half" and not (tmp_path / "a.json").exists()
    others = [
        tmp_path / name
        for name in (".a-notours.json", ".b-12345678.tmp.json", ".a-12345678.tmp.txt", "a-12345678.tmp.json")
    ]
    long_ago = time.time() - ABANDONED_SECONDS - 10
    for path in others:
        path.touch()
        os.utime(path, (long_ago, long_ago))
    write(tmp_path / "a.json", "whole")
    assert killed.exists()  # somebody may still write it
    os.utime(killed, (long_ago, long_ago))
    write(tmp_path / "a.json", "whole")
    assert sorted(tmp_path.iterdir()) == sorted([*others, tmp_path / "a.json"])


def test_whoever_knows_that_nobody_writes_need_not_wait(tmp_path, killed):
    remove_leftovers(tmp_path / "b.json")
    assert killed.exists()
    remove_leftovers(tmp_path / "a.json")
    assert not killed.exists()
    remove_leftovers(tmp_path / "no folder" / "a.json")


@pytest.mark.parametrize("name", ["ü" * 121 + "a.safetensors", "x" * 255, "a." + "x" * 253])
def test_names_may_be_as_long_as_the_file_system_allows(tmp_path, name):
    assert len(name.encode()) == 255
    if name.startswith("a."):  # nothing of the name can be left out: a program may look at the suffix
        with pytest.raises(OutputError, match="File name too long"):
            write(tmp_path / name, "text")
    else:
        write(tmp_path / name, "text")
        assert os.listdir(tmp_path) == [name]


def test_a_folder_in_the_way_and_a_file_for_a_folder(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=r"a folder is there\s+Choose another"):
        write(tmp_path / "folder", "text")
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        write(tmp_path / "file" / "a.json", "text")
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_a_link_is_replaced_and_what_it_leads_to_stays(tmp_path):
    (tmp_path / "mine.json").write_text("mine")
    (tmp_path / "a.json").symlink_to(tmp_path / "mine.json")
    write(tmp_path / "a.json", "text")
    assert not (tmp_path / "a.json").is_symlink() and (tmp_path / "mine.json").read_text() == "mine"


@pytest.fixture
def held(monkeypatch):
    """How often Windows refuses to replace a file that somebody has open."""
    left = [0]
    replace = Path.replace

    def refusing(source, target):
        if left[0]:
            left[0] -= 1
            error = PermissionError(errno.EACCES, "Access is denied")
            error.winerror = 5
            raise error
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", refusing)
    return left


def test_a_file_that_is_held_for_a_moment_is_replaced_after_it(tmp_path, held):
    """On Windows, where antivirus programs and indexers hold what is new, and readers what they read."""
    (tmp_path / "a.json").write_text("before")
    held[0] = 4
    write(tmp_path / "a.json", "text")
    assert (tmp_path / "a.json").read_text() == "text" and held == [0]


def test_one_that_is_held_for_good_stays_and_the_error_says_why(tmp_path, held, monkeypatch):
    (tmp_path / "a.json").write_text("before")
    monkeypatch.setattr(atomic, "HELD_SECONDS", 0.05)
    held[0] = 10**6
    told = r"a\.json: Access is denied[\s\S]*Close the program that has it open"
    with pytest.raises(OutputError, match=told):
        write(tmp_path / "a.json", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert (tmp_path / "a.json").read_text() == "before"


def test_a_folder_is_renamed_once_nobody_has_open_what_is_in_it(tmp_path):
    """As a benchmark's and a data set's new folder are, which an antivirus program has just begun to read."""
    (tmp_path / "work").mkdir()
    calls = []

    def rename():
        calls.append(1)
        if len(calls) < 4:
            error = PermissionError(errno.EACCES, "The process cannot access the file")
            error.winerror = 32
            raise error
        os.rename(tmp_path / "work", tmp_path / "final")

    atomic.patiently(rename)
    assert len(calls) == 4 and [path.name for path in tmp_path.iterdir()] == ["final"]


def test_another_refusal_is_not_waited_for(tmp_path, monkeypatch):
    def refuse(source, target):
        raise PermissionError(errno.EACCES, "no")

    monkeypatch.setattr(Path, "replace", refuse)
    begun = time.monotonic()
    with pytest.raises(OutputError, match=r"a\.json: no\n  Check that the folder can be written"):
        write(tmp_path / "a.json", "text")
    assert time.monotonic() - begun < 5.0


def test_the_last_look_may_refuse(tmp_path):
    """A user may save a file of that name in the seconds that a large one takes to write."""

    def mine(path):
        if path.exists():
            raise OutputError(f"{path} is mine")

    with pytest.raises(OutputError, match="is mine"), atomic_path(tmp_path / "a", check=mine) as temporary:
        temporary.write_text("text")
        (tmp_path / "a").write_text("saved meanwhile")
    assert (tmp_path / "a").read_text() == "saved meanwhile" and os.listdir(tmp_path) == ["a"]
    assert atomic.MARK == ".tmp"  # data sets of earlier versions are tidied by it
