# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection file: where a backend listens, and the secret that opens it. For its owner alone (0600).

It lies in the backend's home folder, so that a Blender that starts later finds a training that runs. The
home, too, is its owner's alone (0700): who could write there could have a Blender talk to another backend,
or start another Python; who could read there could hold the lock that keeps a second backend out.
"""

import json
import os
import re
import secrets
import stat
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from .atomic import atomic_path
from .errors import FileDamagedError, FileMissingError, OutputError
from .lock import Lock, LocksRefusedError
from .regular import parse_json, resolved, without_waiting

CONNECTION_FILE = "connection.json"
#: Locked by the backend from before it writes the connection file until after it has removed it.
LOCK_FILE = "backend.lock"
HOST = "127.0.0.1"
#: 256 bits, as 64 hexadecimal digits.
TOKEN_BYTES = 32
#: Characters of a connection file; one of ours has a few hundred, most of them the log's path.
FILE_CHARACTERS_MAX = 1 << 16
#: The largest port; and the largest process number that the system's calls take.
PORT_MAX, PID_MAX = (1 << 16) - 1, (1 << 31) - 1


@dataclass(frozen=True)
class Connection:
    """How to reach a backend. ``log``: its log file, for people."""

    protocol: int
    port: int
    token: str
    pid: int
    version: str
    log: str

    @property
    def address(self) -> str:
        return f"ws://{HOST}:{self.port}"


def private_home(folder: Path) -> None:
    """Make the home folder for its owner alone; one that is there is made so, with what is in it unchanged.

    Raises ``OutputError`` where that cannot be, where the folder or something in it belongs to another user,
    and where it is open to others because it is not a backend's alone: one that all users write to, as
    ``/tmp``, and the user's own folder and those around it. On Windows it is only made: it is closed to
    others where the folder around it is, as the user's own are.
    """
    try:
        # On Windows 0700 is for the account that owns what this process makes: of one that runs as the
        # administrator these are the administrators, and the user could not open the home later.
        folder.mkdir(mode=0o777 if os.name == "nt" else 0o700, parents=True, exist_ok=True)
        found = folder.stat()
        if is_of_another(found):
            raise OutputError(
                f"{folder} belongs to another user, who could read and replace what the backend keeps there",
                "Choose a home folder of your own.",
            )
        if os.name != "nt" and stat.S_IMODE(found.st_mode) & 0o077:
            _close_to_others(folder, found)
        for entry in folder.iterdir():
            with suppress(FileNotFoundError):  # of a backend that runs there: it comes and goes
                if is_of_another(entry.lstat()):
                    raise OutputError(
                        f"{entry} belongs to another user, who put it there while {folder} was open",
                        "Delete it, or choose another home folder.",
                    )
    except OSError as error:
        raise OutputError(
            f"cannot use {folder} as the backend's home: {error.strerror or error}",
            "Choose another home folder, or make that one yours and writable.",
        ) from error


def _close_to_others(folder: Path, found: os.stat_result) -> None:
    own = resolved(Path(os.path.expanduser("~")))
    if found.st_mode & stat.S_ISVTX or resolved(folder) in (own, *own.parents):
        raise OutputError(
            f"{folder} is open to other users, and closing it to them would close more than a backend's",
            f"Choose a folder in it as the home, say {folder / 'physhdr'}.",
        )
    folder.chmod(0o700)


def is_of_another(found: os.stat_result) -> bool:
    """Whether a file belongs to another user than this process's and root; never on Windows."""
    return os.name != "nt" and found.st_uid not in (0, os.geteuid())


def new_token() -> str:
    return secrets.token_hex(TOKEN_BYTES)


def write_connection(folder: Path, connection: Connection) -> Path:
    """Write the file in one step, readable by its owner alone; raises ``OutputError``."""
    path = folder / CONNECTION_FILE
    remedy = "Choose another --home, or make that folder writable."
    try:
        if not folder.is_dir():
            raise OutputError(f"cannot write {path}: there is no folder {folder}")
        with atomic_path(path, mode=0o600) as temporary:
            temporary.write_text(json.dumps(asdict(connection)), encoding="utf-8")
    except OutputError as error:
        message = error.message.replace("cannot write", "cannot write the connection file", 1)
        raise OutputError(message, remedy) from error
    return path


def read_connection(folder: Path) -> Connection:
    """Read it; raises ``FileMissingError`` where no backend is there, ``FileDamagedError``.

    The latter also where another user wrote it, whose backend that would be, and where its numbers cannot be
    a port and a process or its token is none of ``new_token``: all are used as they are.
    """
    path = folder / CONNECTION_FILE
    try:
        with open(path, encoding="utf-8", opener=without_waiting) as file:
            found = os.fstat(file.fileno())
            if is_of_another(found):
                raise FileDamagedError(f"{path} belongs to another user", "Choose another home folder.")
            if not stat.S_ISREG(found.st_mode):
                raise FileDamagedError(f"{path} is a pipe or a device", "Delete it and start the backend.")
            content = parse_json(file.read(FILE_CHARACTERS_MAX))
    except FileNotFoundError:
        raise FileMissingError(f"no backend is running: there is no {path}", "Start one.") from None
    except (OSError, ValueError, RecursionError) as error:
        raise FileDamagedError(f"cannot read {path}: {error}", "Delete it and start the backend.") from error
    wanted = {entry.name: entry.type for entry in fields(Connection)}
    if (
        not isinstance(content, dict)
        or set(content) != set(wanted)
        or not all(type(content[name]) is kind for name, kind in wanted.items())
        or not (0 < content["port"] <= PORT_MAX and 0 < content["pid"] <= PID_MAX)
        or not re.fullmatch(rf"[0-9a-f]{{{2 * TOKEN_BYTES}}}", content["token"])
    ):
        raise FileDamagedError(f"{path} is not a connection file", "Delete it and start the backend.")
    return Connection(**content)


def live_connection(folder: Path) -> Connection:
    """As ``read_connection``, of a backend that lives: who holds the home's lock.

    Raises ``FileMissingError`` also where the file was left behind, as by a power cut: its process number and
    its port may be any other program's by now, which must neither be ended nor learn the token.
    """
    connection = read_connection(folder)
    if not _is_served(folder):
        raise FileMissingError(
            f"no backend is running: {folder / CONNECTION_FILE} was left behind by one that is gone",
            "Start one.",
        )
    return connection


def _is_served(folder: Path) -> bool:
    """Whether a process holds the home's lock. Where nothing can be locked, no backend serves."""
    lock = Lock(folder / LOCK_FILE)
    if not lock.path.exists():
        return False
    try:
        is_free = lock.take()
    except (LocksRefusedError, OutputError):
        return False
    lock.release()
    return not is_free


def remove_connection(folder: Path, token: str) -> None:
    """Remove the file if it is still this backend's own."""
    with suppress(FileMissingError, FileDamagedError, OSError):
        if read_connection(folder).token == token:
            (folder / CONNECTION_FILE).unlink()
