# SPDX-License-Identifier: GPL-3.0-or-later
"""Lets several commands, also of several machines, work through one benchmark without doing a run twice.

Who does a run holds a claim on it: a small file that only one can create, touched every few seconds. A claim
is taken over when its process is dead; where that cannot be known (another machine or container, no Linux),
when it was not touched for long. In the worst case two do one run: each in a folder of its own, which appears
by a rename, so only time is lost.
"""

import contextlib
import json
import os
import secrets
import socket
import threading
import time
from pathlib import Path
from typing import Any

from ...bridge.errors import OutputError

TOUCH_EVERY = 5.0
#: Seconds without a sign of life after which a claim is dead whose process cannot be looked at.
STALE_AFTER = 60.0


class Claims:
    """This process's claims, files in ``folder``. A context manager: at its end all are given back.

    ``pid`` says who we are: a parameter for tests alone.
    """

    def __init__(self, folder: Path, pid: int | None = None) -> None:
        self.folder = folder
        pid = pid or os.getpid()
        self._me: dict[str, Any] = {
            "host": socket.gethostname(),  # for people
            "pid": pid,
            "token": secrets.token_hex(8),
            "machine": _machine(),
            "started": _state_and_start(pid)[1],
        }
        self._held: set[str] = set()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._touch, name="claims", daemon=True)

    def __enter__(self) -> "Claims":
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._unwritable(error) from error
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        for name in list(self._held):
            self.release(name)
        with contextlib.suppress(OSError):
            self.folder.rmdir()  # only if nobody else holds one

    def take(self, name: str) -> bool:
        """Whether the run is ours to do now. Raises ``OutputError`` where the folder cannot be written."""
        path = self.folder / name
        try:
            if path.exists() and self._is_dead(path):
                self._bury(path)
            if not self._create(path):
                return False
        except OSError as error:
            raise self._unwritable(error) from error
        with self._lock:
            self._held.add(name)
        return True

    def release(self, name: str) -> None:
        """The run is done, or was given up."""
        with self._lock:
            self._held.discard(name)
        path = self.folder / name
        if _owner(path) == self._me:
            path.unlink(missing_ok=True)

    def is_taken(self, name: str) -> bool:
        """Whether somebody who lives, not us, is at it."""
        path = self.folder / name
        return name not in self._held and path.exists() and not self._is_dead(path)

    def _bury(self, path: Path) -> None:
        """Remove a claim that was found dead, and no other."""
        grave = self.folder / f".{path.name}.{secrets.token_hex(4)}"
        try:
            os.rename(path, grave)  # of several that bury it, one can
        except OSError:
            return
        if self._is_dead(grave):
            grave.unlink(missing_ok=True)
        else:  # somebody took it over meanwhile: it is theirs
            os.replace(grave, path)

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(
            f"cannot write claims into {self.folder}: {error.strerror or error}",
            "Check that the folder can be written and that the disk has space.",
        )

    def _create(self, path: Path) -> bool:
        self.folder.mkdir(parents=True, exist_ok=True)  # another process may have tidied it away
        pending = self.folder / f".{path.name}.{self._me['token']}"
        pending.write_text(json.dumps(self._me), encoding="utf-8")
        try:
            os.link(pending, path)  # it appears whole or not at all, and not where there is one
        except FileExistsError:
            return False
        except OSError:  # a file system without hard links: the content comes a moment after the name
            try:
                with open(path, "x", encoding="utf-8") as file:
                    json.dump(self._me, file)
            except FileExistsError:
                return False
        finally:
            pending.unlink(missing_ok=True)
        return True

    def _is_dead(self, path: Path) -> bool:
        owner = _owner(path) or {}
        if self._me["machine"] is not None and owner.get("machine") == self._me["machine"]:
            # However long ago it was touched: a stopped process (CTRL-Z) goes on some day, its jobs do now.
            return not _is_running(owner.get("pid"), owner.get("started"))
        try:
            touched = path.stat().st_mtime
        except OSError:
            return True  # gone meanwhile
        return self._now() - touched > STALE_AFTER

    def _now(self) -> float:
        """The time by the clock of the disk that the folder is on, which may be another machine's."""
        probe = self.folder / f".clock.{self._me['token']}"
        try:
            probe.write_bytes(b"")
            return probe.stat().st_mtime
        except OSError:
            return time.time()
        finally:
            with contextlib.suppress(OSError):
                probe.unlink()

    def _touch(self) -> None:
        while not self._end.wait(TOUCH_EVERY):
            with self._lock:
                held = list(self._held)
            for name in held:
                with contextlib.suppress(OSError):
                    if _owner(self.folder / name) == self._me:  # not taken over while we could not touch it
                        os.utime(self.folder / name)


def _owner(path: Path) -> dict[str, Any] | None:
    try:
        owner = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return owner if isinstance(owner, dict) else None


def _machine() -> str | None:
    """Where a process number means one process: this boot, this container; None where that is not known."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.stat('/proc/self/ns/pid').st_ino}"
    except OSError:  # not Linux
        return None


def _state_and_start(pid: int) -> tuple[str, int | None]:
    """A process's state (``Z``: dead, but not yet missed) and when it began, in ticks since the boot."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "", None
    fields = stat.rpartition(")")[2].split()  # a name in brackets, of any characters, is before
    return fields[0], int(fields[19])


def _is_running(pid: object, started: object) -> bool:
    """Whether this very process of ``_machine`` lives; a doubt counts as yes."""
    if not isinstance(pid, int) or pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # somebody else's
    state, begun = _state_and_start(pid)
    return begun is None or (state not in ("Z", "X") and begun == started)  # else its number was given again
