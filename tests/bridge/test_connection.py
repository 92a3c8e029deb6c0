# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection file: for its owner alone, whole or not there, and no stranger's."""

import json
import os
import stat

import pytest

from physhdr.bridge.connection import (
    CONNECTION_FILE,
    Connection,
    new_token,
    read_connection,
    remove_connection,
    write_connection,
)
from physhdr.bridge.errors import FileDamagedError, FileMissingError, OutputError


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
    for content in (b"", whole[:-1], b"\xff\xfe\0"):
        path.write_bytes(content)
        with pytest.raises(FileDamagedError):
            read_connection(tmp_path)


def test_a_home_that_cannot_be_written_is_told(tmp_path):
    with pytest.raises(OutputError, match="--home"):
        write_connection(tmp_path / "none", connection())
    (tmp_path / CONNECTION_FILE).mkdir()  # also for root, who may write anywhere
    with pytest.raises(OutputError, match="--home"):
        write_connection(tmp_path, connection())
    assert [file.name for file in tmp_path.iterdir()] == [CONNECTION_FILE]
