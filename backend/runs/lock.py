# SPDX-License-Identifier: GPL-3.0-or-later
"""One training per folder: a process that trains in a run's folder holds its lock, and states who it is.

The lock is released when the process ends, however it ends (``bridge.lock``). Its holder is named in another
file, because locked files cannot be read on Windows.
"""

import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ...bridge.atomic import atomic_path
from ...bridge.errors import OutputError, PhysHDRError
from ...bridge.lock import Lock, LocksRefusedError

LOCK_FILE = "training.lock"
HOLDER_FILE = "training.json"
#: A process that ends removes its lock file; one that has just opened that file must try again.
WAIT_SECONDS = 0.5


class RunHeldError(PhysHDRError):
    """Another process trains in the run's folder."""


@contextmanager
def hold(folder: Path, report: Callable[[str], None]) -> Iterator[None]:
    """While active, no other process trains in ``folder``, which must exist.

    If the disk does not support locks, this is only reported, and nothing prevents another training. Raises
    ``RunHeldError``, which names the holder, and ``OutputError`` if the lock file cannot be made.
    """
    lock = Lock(folder / LOCK_FILE, mode=0o600)  # who could read it could hold it
    try:
        free = lock.take(WAIT_SECONDS)
    except LocksRefusedError as error:
        report(f"{folder} cannot be locked ({error.message}): do not train there twice at once")
        yield
        return
    except OutputError as error:
        raise OutputError(error.message, "Choose another --out, or make it writable.") from error
    if not free:
        raise RunHeldError(
            f"{folder} is being trained already{_holder(folder)}",
            "Wait for its end, stop it (CTRL-C saves), or choose another --out.",
        )
    try:
        with suppress(OutputError):  # a full disk: naming the holder is optional
            _announce(folder)
        yield
    finally:
        with suppress(OSError):
            (folder / HOLDER_FILE).unlink(missing_ok=True)
        lock.release()


def _announce(folder: Path) -> None:
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
    with atomic_path(folder / HOLDER_FILE) as temporary:
        temporary.write_text(json.dumps(holder) + "\n", encoding="utf-8")


def _holder(folder: Path) -> str:
    """`` by process 7 on host, since …``; empty if not stated (yet)."""
    try:
        holder = json.loads((folder / HOLDER_FILE).read_text(encoding="utf-8"))
        return f" by process {holder['pid']} on {holder['host']}, since {holder['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return ""
