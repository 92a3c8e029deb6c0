# SPDX-License-Identifier: GPL-3.0-or-later
"""A backend's home folder: one backend per folder, found by its connection file."""

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

#: Seconds to wait for the lock, which is held briefly by others to check whether a backend is alive.
LOOK_SECONDS = 0.5


@contextmanager
def own_home(folder: Path) -> Iterator[None]:
    """While active, no other backend serves ``folder``, which is made accessible to its owner only.

    The operating system releases the lock when the process ends, however it ends: a leftover connection file
    is stale exactly if the lock can be acquired. Raises ``BusyError`` and ``OutputError``.
    """
    private_home(folder)
    path = folder / LOCK_FILE
    try:
        _tighten(path)
        # No soft lock where the disk does not support locks: it would outlive a killed process.
        held = FileLock(path, mode=0o600, fallback_to_soft=False).acquire(LOOK_SECONDS)
    except Timeout:
        raise BusyError(
            f"a backend already serves {folder}{_who(folder)}",
            "Connect to it by its connection file, end it, or choose another --home.",
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
        return ""  # it is still starting


def _tighten(path: Path) -> None:
    """Restrict an existing lock file to its owner."""
    with suppress(FileNotFoundError):
        if stat.S_ISREG(os.lstat(path).st_mode):
            path.chmod(0o600)
