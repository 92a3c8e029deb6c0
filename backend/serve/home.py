# SPDX-License-Identifier: GPL-3.0-or-later
"""A backend's home folder: one backend a folder, found by its connection file."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from ...bridge.connection import (
    CONNECTION_FILE,
    LOCK_FILE,
    Connection,
    private_home,
    read_connection,
    remove_connection,
    write_connection,
)
from ...bridge.errors import OutputError, PhysHDRError
from .failures import BusyError

#: Seconds to wait for the lock: whoever looks whether a backend lives has it for a moment.
LOOK_SECONDS = 0.5


@contextmanager
def own_home(folder: Path) -> Iterator[None]:
    """While active, no other backend serves ``folder``, which is made its owner's alone.

    The operating system takes the lock back when the process ends, however it ends: a connection file that
    was left behind is stale exactly if the lock can be had. Raises ``BusyError`` and ``OutputError``.
    """
    private_home(folder)
    path = folder / LOCK_FILE
    try:
        _tighten(path)
        # Nothing in a lock's stead where the disk knows none: that would outlive a process that is killed.
        held = FileLock(path, mode=0o600, fallback_to_soft=False).acquire(LOOK_SECONDS)
    except Timeout:
        raise BusyError(
            f"a backend already serves {folder}{_who(folder)}",
            "Connect to it (its connection file is there), end it, or choose another --home.",
        ) from None
    except (OSError, NotImplementedError) as error:
        raise OutputError(
            f"{path} cannot be locked: {getattr(error, 'strerror', None) or error}",
            "Choose a --home on a disk of this machine.",
        ) from error
    with held:
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


def _tighten(path: Path) -> None:
    """A lock that is there already, of a version that left it open to all, for its owner alone."""
    with suppress(FileNotFoundError):
        if stat.S_ISREG(os.lstat(path).st_mode):
            path.chmod(0o600)
