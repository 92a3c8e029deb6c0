# SPDX-License-Identifier: GPL-3.0-or-later
"""Lets several commands, also of several machines, work through one benchmark without doing a run twice.

Who does a run holds a claim on it: a small file that only one can create, touched every few seconds. A claim
of a dead process (same machine), or one not touched for long (another machine), is taken over. In the worst
case two do one run: each in a folder of its own, which appears by a rename, so only time is lost.
"""

import contextlib
import json
import os
import secrets
import socket
import threading
import time
from pathlib import Path

TOUCH_EVERY = 5.0
#: Seconds without a sign of life after which a claim is dead.
STALE_AFTER = 60.0


class Claims:
    """This process's claims, files in ``folder``. A context manager: at its end all are given back.

    ``pid`` says who we are: a parameter for tests alone.
    """

    def __init__(self, folder: Path, pid: int | None = None) -> None:
        self.folder = folder
        self._me = {"host": socket.gethostname(), "pid": pid or os.getpid(), "token": secrets.token_hex(8)}
        self._held: set[str] = set()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._touch, name="claims", daemon=True)

    def __enter__(self) -> "Claims":
        self.folder.mkdir(parents=True, exist_ok=True)
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
        """Whether the run is ours to do now. Raises ``OSError`` where the folder cannot be written."""
        path = self.folder / name
        if path.exists() and self._is_dead(path):
            grave = self.folder / f".{name}.{secrets.token_hex(4)}"
            with contextlib.suppress(OSError):  # of several that bury it, one can
                os.rename(path, grave)
                grave.unlink()
        if not self._create(path):
            return False
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
        owner = _owner(path)
        if owner and owner.get("host") == self._me["host"] and not _is_running(owner.get("pid")):
            return True
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
                    os.utime(self.folder / name)


def _owner(path: Path) -> dict[str, object] | None:
    try:
        owner = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return owner if isinstance(owner, dict) else None


def _is_running(pid: object) -> bool:
    """Whether a process of this machine lives; a doubt counts as yes."""
    if not isinstance(pid, int) or pid <= 0:
        return False
    if os.name == "nt":
        return True  # os.kill would end it: the time of the last touch decides there
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
