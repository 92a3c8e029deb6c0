# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a user names: what is no regular file is refused at once, what is too much is not read."""

import os
import socket
from pathlib import Path

import pytest

from physhdr.bridge.errors import FileDamagedError, FileMissingError, PhysHDRError
from physhdr.bridge.regular import damaged_where_it_fails, read_json_object, read_text, regular_file

pytestmark = pytest.mark.usefixtures("never_waits")


def test_a_file_and_a_link_to_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to("file")
    assert regular_file(tmp_path / "file") == tmp_path / "file"
    assert regular_file(tmp_path / "link") == tmp_path / "link"


def test_what_is_no_file_is_named_and_never_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        with pytest.raises(FileDamagedError, match=rf"{name} is a pipe, not a file\n  Choose another"):
            read_text(tmp_path / name, "Choose another.")
    with pytest.raises(FileDamagedError, match="/dev/zero is a device"):
        read_text(Path("/dev/zero"))
    with pytest.raises(FileMissingError, match="is a folder, not a file"):
        read_text(tmp_path)


def test_sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's path may have 108 bytes
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("socket")
        with pytest.raises(FileDamagedError, match="socket is a socket"):
            regular_file(tmp_path / "socket")


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("gone", FileMissingError, "gone is missing"),
        ("file/below", FileMissingError, "below is missing"),
        ("dangling", FileMissingError, "dangling is missing"),
        ("nul\0byte", FileMissingError, r"nul\\x00byte' cannot be the name"),
        ("half \ud800", FileMissingError, r"half \\ud800' cannot be the name"),
        ("x" * 5000, FileDamagedError, "cannot be read: File name too long"),
        ("loop", FileDamagedError, "cannot be read: Too many levels"),
    ],
)
def test_names_that_lead_nowhere(tmp_path: Path, name: str, error: type[PhysHDRError], message: str) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "dangling").symlink_to("nothing")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(error, match=message) as refused:
        regular_file(tmp_path / name)
    assert len(refused.value.message) < 600


def test_a_file_without_end_takes_no_memory(tmp_path: Path) -> None:
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FileDamagedError, match="has 1099511627776 bytes: no such file has more than"):
        read_text(tmp_path / "sparse")


def test_json_of_windows_has_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a":\r\n 1}\r\n')
    assert read_json_object(tmp_path / "a.json") == {"a": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "line 1, column 1"),
        (b'{"a": 1,}', "is not valid JSON: line 1"),
        (b"\xff\xfe", "cannot be read as JSON: 'utf-8'"),
        (b"[" * 100_000, "cannot be read as JSON: maximum recursion"),
        (b'{"a": ' + b"1" * 5000 + b"}", "cannot be read as JSON: Exceeds the limit"),
        (b'{"b": {"a": 1, "c": 2, "a": 3}}', "'a' stands twice in one object"),
        (b'{"name": "half \\ud800"}', "surrogates not allowed"),
        (b'{"\\uDFFF": 1}', "surrogates not allowed"),
        (b"null", "holds a NoneType, not an object"),
        (b"[]", "holds a list, not an object"),
    ],
)
def test_what_is_no_object_of_json(tmp_path: Path, text: bytes, message: str) -> None:
    (tmp_path / "a.json").write_bytes(text)
    with pytest.raises(FileDamagedError, match=rf"a\.json .*{message}"):
        read_json_object(tmp_path / "a.json")


def test_a_pair_of_halves_is_a_character(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b'{"\\ud83d\\udd76": "\\\\udef"}')
    assert read_json_object(tmp_path / "a.json") == {"🕶": "\\udef"}


@pytest.mark.parametrize(
    "error", [KeyError("x"), MemoryError(), RuntimeError("no"), EOFError(), ValueError("x" * 5000)]
)
def test_a_library_may_fail_in_any_way(error: Exception) -> None:
    damaged = pytest.raises(FileDamagedError, match=r"a\.bin is no array \(.{1,200}\)")
    with damaged, damaged_where_it_fails("a.bin is no array"):
        raise error
    with pytest.raises(FileMissingError, match="gone"), damaged_where_it_fails("a.bin is no array"):
        raise FileMissingError("gone")


def test_what_a_library_says_in_several_lines_is_one() -> None:
    damaged = pytest.raises(FileDamagedError, match=r"no picture \(ends early: at 12\)$")
    with damaged, damaged_where_it_fails("a.bin is no picture"):
        raise ValueError("ends early:\n  at 12\n")
