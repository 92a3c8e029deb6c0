# SPDX-License-Identifier: GPL-3.0-or-later
"""What one process of a machine keeps the others out of: a file's lock, or jobs in a folder, a lock each.

The locks are the operating system's, so they go with the process however it ends, and a process that stands
still keeps its own. The library is filelock: the extension brings it along. Some disks know no locks, and a
Blender may lack the library: nothing is locked then, and the caller learns it.
"""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from .errors import OutputError, PhysHDRError

if TYPE_CHECKING:
    from filelock import BaseFileLock


#: How often, and how many seconds apart, a folder is made that others tidy away in the same moment.
TRIES, TRY_EVERY = 20, 0.02


class LocksRefusedError(PhysHDRError):
    """Nothing can be locked there; ``message`` says why, in a few words."""


class Lock:
    """The lock of the file ``path``, which is there while it is held and whose content means nothing.

    ``mode``: the file's; what the process's umask leaves of 0666 if ``None``.
    """

    def __init__(self, path: Path, mode: int | None = None) -> None:
        self.path = path
        self._mode = mode
        self._lock: BaseFileLock | None = None
        self._file: os.stat_result | None = None

    def take(self, wait: float = 0.0) -> bool:
        """Whether it is ours now, after ``wait`` seconds at most; not for a moment after it was given back.

        Raises ``LocksRefusedError``, and ``OutputError`` where the file cannot be made.
        """
        try:
            from filelock import FileLock, Timeout
        except ModuleNotFoundError as error:
            raise LocksRefusedError("this Python has no filelock") from error
        # What the library falls back to otherwise is files that outlive a killed process.
        make = partial(FileLock, self.path, thread_local=False, fallback_to_soft=False)
        lock = make() if self._mode is None else make(mode=self._mode)
        new = not self.path.exists()
        try:
            lock.acquire(timeout=wait, blocking=wait > 0)
        except Timeout:
            return False
        except OSError as error:
            # It could not even be made. Its folder was gone for a moment: another may have made both since.
            if isinstance(error, FileNotFoundError) or not self.path.exists():
                raise OutputError(
                    f"cannot write to {self.path.parent}: {error.strerror or error}",
                    "Choose another folder, or make it writable.",
                ) from error
            if new:
                with suppress(OSError):
                    self.path.unlink()
            raise LocksRefusedError(error.strerror or str(error)) from error
        try:
            self._file = self.path.stat()
        except FileNotFoundError:  # on Windows the library removes the file after it gave the lock back
            lock.release()
            return False
        self._lock = lock
        return True

    def release(self) -> None:
        """Give it back; nothing where it is not ours."""
        if self._lock is None:
            return
        with suppress(OSError):  # Windows keeps an open file; the library removes it there
            # While it is held: whoever waits for the lock looks whether its file is there still. If somebody
            # has removed it, another's may be there.
            if self._file is not None and os.path.samestat(self._file, self.path.stat()):
                self.path.unlink()
        self._lock.release()
        self._lock = None


class Claims:
    """Which of the jobs of a folder are this process's, for processes that share the work.

    A claim is the lock of a file of the job's name in ``folder``. A context manager: at its end all are given
    back, and the folder goes with the last. ``warn`` is called, once, where nothing can be locked: then every
    process does every job, which is safe only where their results may replace each other.
    """

    def __init__(self, folder: Path, warn: Callable[[str], None]) -> None:
        self.folder = folder
        self._warn: Callable[[str], None] | None = warn
        self._held: dict[str, Lock] = {}

    @property
    def keep_others_out(self) -> bool:
        """False once a lock was refused: others may be at whatever we have."""
        return self._warn is not None

    def __enter__(self) -> "Claims":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None = None,
        error: BaseException | None = None,
        traceback: TracebackType | None = None,
    ) -> None:
        for name in list(self._held):
            self.release(name)
        with suppress(OSError, PhysHDRError):
            for path in self.folder.iterdir():  # files of the dead, for jobs that were done
                lock = Lock(path)
                if lock.take():
                    lock.release()
            self.folder.rmdir()  # only if nobody else holds one

    def take(self, name: str) -> bool:
        """Whether the job is ours to do now; not where we have it already.

        Nor for a moment in which another process looks whether somebody has it: who wants it asks again.
        Raises ``OutputError`` where the folder cannot be written.
        """
        if name in self._held:
            return False
        lock = Lock(self.folder / name)
        try:
            free = self._taken(lock)
        except LocksRefusedError as error:
            free = True
            if self._warn is not None:
                where = self.folder.parent
                self._warn(f"{where} cannot be locked ({error.message}): do not work there twice at once")
                self._warn = None
        if free:
            self._held[name] = lock
        return free

    def release(self, name: str) -> None:
        """The job is done, or was given up; nothing where it is not ours."""
        lock = self._held.pop(name, None)
        if lock is not None:
            lock.release()

    def is_taken(self, name: str) -> bool:
        """Whether another process is at it. Raises ``OutputError`` where the folder cannot be written."""
        if name in self._held or not (self.folder / name).exists() or not self.keep_others_out:
            return False
        if not self.take(name):
            return True
        self.release(name)
        return False

    def _taken(self, lock: Lock) -> bool:
        """What ``lock.take`` says, in a folder that is there: whoever ends may tidy it away at any moment."""
        for _ in range(TRIES):
            with suppress(OutputError):
                self._make_folder()
                return lock.take()
            time.sleep(TRY_EVERY)
        self._make_folder()  # what hinders it now hinders it for good
        return lock.take()

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot write claims into {self.folder}: {error.strerror or error}",
                "Check that the folder can be written and that the disk has space.",
            ) from error
