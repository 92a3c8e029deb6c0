# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection file and its folder: for their owner alone, whole or not there, and no stranger's."""

import json
import os
import stat
from types import SimpleNamespace

import pytest

from physhdr.bridge import connection as connection_module
from physhdr.bridge.connection import (
    CONNECTION_FILE,
    LOCK_FILE,
    Connection,
    live_connection,
    new_token,
    private_home,
    read_connection,
    remove_connection,
    write_connection,
)
from physhdr.bridge.errors import FileDamagedError, FileMissingError, OutputError
from physhdr.bridge.lock import Lock


def connection(**changes):
    fields = {"protocol": 1, "port": 5, "token": new_token(), "pid": 7, "version": "0.1", "log": "/größe"}
    return Connection(**{**fields, **changes})


def test_it_comes_back_the_same_and_is_the_owners_alone(tmp_path):
    written = connection()
    before = os.umask(0)
    try:
        path = write_connection(tmp_path, written)
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_connection(tmp_path) == written and written.address == "ws://127.0.0.1:5"
    assert [file.name for file in tmp_path.iterdir()] == [CONNECTION_FILE]


def test_a_newer_one_replaces_it_and_only_its_owner_removes_it(tmp_path):
    old, new = connection(), connection()
    write_connection(tmp_path, old)
    write_connection(tmp_path, new)
    remove_connection(tmp_path, old.token)
    assert read_connection(tmp_path) == new
    remove_connection(tmp_path, new.token)
    remove_connection(tmp_path, new.token)
    with pytest.raises(FileMissingError, match="no backend is running"):
        read_connection(tmp_path)


def test_tokens_are_256_bits_and_differ():
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100 and all(len(bytes.fromhex(token)) == 32 for token in tokens)


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content | {"port": "5"},
        lambda content: content | {"port": True},
        lambda content: content | {"port": 0},
        lambda content: content | {"port": -5},
        lambda content: content | {"port": 1 << 16},
        lambda content: content | {"pid": 0},  # this process's own group
        lambda content: content | {"pid": -1},  # every process
        lambda content: content | {"pid": 1 << 31},
        lambda content: content | {"token": ""},
        lambda content: content | {"token": content["token"][:-1]},
        lambda content: content | {"token": content["token"] + "\n"},
        lambda content: content | {"token": content["token"][:-2] + "\r\n"},
        lambda content: content | {"token": "ü" * 64},
        lambda content: content | {"more": 1},
        lambda content: {key: value for key, value in content.items() if key != "token"},
        lambda content: [content],
    ],
)
def test_what_is_no_connection_file_is_refused(tmp_path, change):
    path = write_connection(tmp_path, connection())
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(FileDamagedError, match="Delete it"):
        read_connection(tmp_path)


def test_a_cut_or_binary_file_is_refused(tmp_path):
    path = write_connection(tmp_path, connection())
    whole = path.read_bytes()
    for content in (b"", whole[:-1], b"\xff\xfe\0", b"[" * 60_000, b" " * 100_000 + whole):
        path.write_bytes(content)
        with pytest.raises(FileDamagedError):
            read_connection(tmp_path)


def test_a_pipe_in_its_place_is_not_waited_for(tmp_path, never_waits):
    os.mkfifo(tmp_path / CONNECTION_FILE)
    with pytest.raises(FileDamagedError, match=r"a pipe or a device[\s\S]*Delete it"):
        read_connection(tmp_path)


def test_a_home_that_cannot_be_written_is_told(tmp_path):
    with pytest.raises(OutputError, match="--home"):
        write_connection(tmp_path / "none", connection())
    (tmp_path / CONNECTION_FILE).mkdir()  # also for root, who may write anywhere
    with pytest.raises(OutputError, match="--home"):
        write_connection(tmp_path, connection())
    assert [file.name for file in tmp_path.iterdir()] == [CONNECTION_FILE]


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def open_umask():
    """As a system has it on which everybody may write everywhere."""
    before = os.umask(0)
    yield
    os.umask(before)


def test_a_home_is_its_owners_alone_whether_made_or_found(tmp_path, open_umask):
    private_home(tmp_path / "new" / "home")
    assert mode(tmp_path / "new" / "home") == 0o700
    for found in (0o777, 0o755, 0o2775, 0o711):
        home = tmp_path / f"{found:o}"
        home.mkdir()
        (home / "environment").mkdir(mode=0o755)
        home.chmod(found)
        private_home(home)
        private_home(home)
        assert mode(home) == 0o700 and mode(home / "environment") == 0o755


def test_on_windows_a_home_is_as_the_folder_around_it(tmp_path, monkeypatch, open_umask):
    """0700 would close it to the user where an administrator's process made it."""
    monkeypatch.setattr(connection_module, "os", SimpleNamespace(name="nt"))
    private_home(tmp_path / "home")
    assert mode(tmp_path / "home") == 0o777


def test_folders_that_are_not_a_backends_alone_are_left_as_they_are(tmp_path, monkeypatch):
    """The user's own folder, those around it, and those that all users write to: a wrong --home, no more."""
    own, everybodys = tmp_path / "home" / "me", tmp_path / "tmp"
    own.mkdir(parents=True)
    everybodys.mkdir()
    monkeypatch.setenv("HOME", str(own))
    (tmp_path / "link").symlink_to(own)
    for folder, found in (
        (own, 0o755),
        (own.parent, 0o755),
        (everybodys, 0o1777),
        (tmp_path / "link", 0o755),
    ):
        folder.chmod(found)
        with pytest.raises(OutputError, match=rf"{folder} is open[\s\S]*say {folder / 'physhdr'}"):
            private_home(folder)
        assert mode(folder) == found
    private_home(everybodys / "physhdr")  # as it says


def test_a_file_that_was_left_behind_is_no_backend(tmp_path):
    """The home's lock tells: the process that the file names may be any other by now, as this one here."""
    written = connection(pid=os.getpid())
    write_connection(tmp_path, written)
    lock = Lock(tmp_path / LOCK_FILE, 0o600)
    for _ in range(2):  # with no lock's file, and with one that is nobody's
        with pytest.raises(FileMissingError, match=r"connection\.json was left behind"):
            live_connection(tmp_path)
        lock.path.touch()
    assert lock.take()
    assert live_connection(tmp_path) == written
    lock.release()
    with pytest.raises(FileMissingError, match="left behind"):
        live_connection(tmp_path)
    assert read_connection(tmp_path) == written


def stranger(monkeypatch, wrote):
    """``wrote`` (its inode) looks as if another user had written it."""
    number = wrote.lstat().st_ino
    real = {name: getattr(os, name) for name in ("stat", "lstat", "fstat")}

    def seen(name):
        def look(*arguments, **options):
            found = real[name](*arguments, **options)
            if found.st_ino != number:
                return found
            return SimpleNamespace(st_uid=os.geteuid() + 4711, st_mode=found.st_mode)

        return look

    for name in real:
        monkeypatch.setattr(os, name, seen(name))


def test_another_users_home_is_not_used(tmp_path, monkeypatch):
    home = tmp_path / "home"
    home.mkdir(mode=0o777)
    stranger(monkeypatch, home)
    with pytest.raises(OutputError, match=r"home belongs to another user[\s\S]*of your own"):
        private_home(home)


def test_what_another_user_left_in_a_home_is_named(tmp_path, monkeypatch):
    home = tmp_path / "home"
    private_home(home)
    write_connection(home, connection())
    stranger(monkeypatch, home / CONNECTION_FILE)
    for _ in range(2):  # that the folder is closed by now changes nothing
        with pytest.raises(OutputError, match=r"connection\.json belongs to another user[\s\S]*Delete it"):
            private_home(home)
    with pytest.raises(FileDamagedError, match=r"connection\.json belongs to another user"):
        read_connection(home)


def test_a_file_in_the_place_of_a_home_is_told(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "home", tmp_path / ("x" * 300)):
        with pytest.raises(OutputError, match=r"as the backend's home[\s\S]*Choose another"):
            private_home(folder)
