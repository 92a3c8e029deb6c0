# SPDX-License-Identifier: GPL-3.0-or-later
"""Lets several processes, also of several machines, fill one data set's folder without doing a picture twice.

Whoever renders a picture holds a claim on it: a small file that only one can create, and that its owner
touches every few seconds from a thread. A claim whose owner is dead (same machine) or has not touched it for
long (another machine) may be taken over. In the worst case two render one picture: it is the same picture,
and each file appears by a rename, so only time is lost.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path

FOLDER = ".claims"
TOUCH_EVERY = 5.0
"""Seconds between an owner's signs of life."""
STALE_AFTER = 60.0
"""Seconds without a sign of life after which another machine's claim is dead."""


class Claims:
    """This process's claims in one data set. Use as a context: what is still held is given back at the end.

    ``host`` and ``pid`` say who we are; they are parameters for tests alone.
    """

    def __init__(
        self,
        out: Path,
        stale_after: float = STALE_AFTER,
        touch_every: float = TOUCH_EVERY,
        host: str | None = None,
        pid: int | None = None,
    ) -> None:
        self.folder = out / FOLDER
        self.stale_after = stale_after
        self.touch_every = touch_every
        self.me = {
            "host": host or socket.gethostname(),
            "pid": pid or os.getpid(),
            "token": secrets.token_hex(8),
        }
        self._held: set[str] = set()
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Claims:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._thread = threading.Thread(target=self._touch, name="claims", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._end.set()
        if self._thread is not None:
            self._thread.join()
        for name in list(self._held):
            self.release(name)
        with suppress(OSError):
            self.folder.rmdir()  # only if nobody else holds one

    def take(self, name: str) -> bool:
        """Whether the picture is ours to make now. ``name``: like ``train_003``.

        Raises:
            OSError: the folder cannot be written.
        """
        path = self.folder / name
        for _ in range(2):
            if self._create(path):
                with self._lock:
                    self._held.add(name)
                return True
            if not self._is_dead(path):
                return False
            self._bury(path)
        return False

    def release(self, name: str) -> None:
        """The picture is there, or was given up."""
        with self._lock:
            self._held.discard(name)
        if self._owner(self.folder / name) == self.me:
            (self.folder / name).unlink(missing_ok=True)

    def others(self) -> list[str]:
        """What living others are at work on, for the report."""
        with suppress(OSError):
            names = [path for path in self.folder.iterdir() if not path.name.startswith(".")]
            return sorted(p.name for p in names if p.name not in self._held and not self._is_dead(p))
        return []

    def _create(self, path: Path) -> bool:
        self.folder.mkdir(parents=True, exist_ok=True)  # another process may have tidied it away
        pending = path.with_name(f".{path.name}.{self.me['token']}")
        pending.write_text(json.dumps(self.me), encoding="utf-8")
        try:
            os.link(pending, path)  # it appears complete, or not at all; fails if there is one
        except FileExistsError:
            return False
        except OSError:  # no hard links on this file system: the content comes a moment after the name
            try:
                with open(path, "x", encoding="utf-8") as file:
                    json.dump(self.me, file)
            except FileExistsError:
                return False
        finally:
            pending.unlink(missing_ok=True)
        return True

    def _owner(self, path: Path) -> dict[str, object] | None:
        try:
            owner = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return owner if isinstance(owner, dict) else None

    def _is_dead(self, path: Path) -> bool:
        owner = self._owner(path)
        if owner is not None and owner.get("host") == self.me["host"] and not _is_running(owner.get("pid")):
            return True
        try:
            touched = path.stat().st_mtime
        except OSError:
            return True  # gone meanwhile
        return self._now() - touched > self.stale_after

    def _now(self) -> float:
        """The time by the clock of the disk that the folder is on, which may not be this machine's."""
        probe = self.folder / f".clock.{self.me['token']}"
        try:
            probe.write_bytes(b"")
            return probe.stat().st_mtime
        except OSError:
            return time.time()
        finally:
            with suppress(OSError):
                probe.unlink(missing_ok=True)

    def _bury(self, path: Path) -> None:
        """Take a dead claim away; of several that try, one moves it."""
        grave = path.with_name(f".{path.name}.dead.{secrets.token_hex(4)}")
        with suppress(OSError):
            os.rename(path, grave)
            grave.unlink(missing_ok=True)

    def _touch(self) -> None:
        while not self._end.wait(self.touch_every):
            with self._lock:
                held = list(self._held)
            for name in held:
                with suppress(OSError):
                    os.utime(self.folder / name)


def _is_running(pid: object) -> bool:
    """Whether a process of this machine lives; a doubt counts as yes."""
    if not isinstance(pid, int) or pid <= 0:
        return False
    if os.name == "nt":
        return True  # os.kill would end it; the time of the last touch decides there
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
