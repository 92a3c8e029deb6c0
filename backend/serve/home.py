# SPDX-License-Identifier: GPL-3.0-or-later
"""A backend's home folder: one backend a folder, found by its connection file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from ...bridge.connection import (
    CONNECTION_FILE,
    Connection,
    read_connection,
    remove_connection,
    write_connection,
)
from ...bridge.errors import OutputError, PhysHDRError
from .failures import BusyError

LOCK_FILE = "backend.lock"


@contextmanager
def own_home(folder: Path) -> Iterator[None]:
    """While active, no other backend serves ``folder``.

    The operating system takes the lock back when the process ends, however it ends: a connection file that
    was left behind is stale exactly if the lock can be had. Raises ``BusyError`` and ``OutputError``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = open(folder / LOCK_FILE, "a")  # noqa: SIM115 (closed below, with the lock)
    except OSError as error:
        raise OutputError(
            f"cannot use {folder} as the backend's home: {error.strerror or error}",
            "Choose another --home, or make that folder writable.",
        ) from error
    with file:
        if not _lock(file):
            raise BusyError(
                f"a backend already serves {folder}{_who(folder)}",
                "Connect to it (its connection file is there), end it, or choose another --home.",
            )
        with suppress(OSError):
            (folder / CONNECTION_FILE).unlink(missing_ok=True)  # of a backend that was killed
        yield


@contextmanager
def announced(folder: Path, connection: Connection) -> Iterator[None]:
    """While active, the connection file is in ``folder``; raises ``OutputError``."""
    write_connection(folder, connection)
    try:
        yield
    finally:
        remove_connection(folder, connection.token)


def _who(folder: Path) -> str:
    try:
        return f" (process {read_connection(folder).pid})"
    except PhysHDRError:
        return ""  # it is only just starting


def _lock(file: IO[str]) -> bool:
    """Lock the file for this process; False where another one has it."""
    if os.name == "nt":
        import msvcrt

        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        raise OutputError(
            f"{file.name} cannot be locked: {error.strerror or error}",
            "Choose a --home on a disk of this machine.",
        ) from error
    return True
