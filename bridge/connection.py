# SPDX-License-Identifier: GPL-3.0-or-later
"""The connection file: where a backend listens, and the secret that opens it. For its owner alone (0600).

It lies in the backend's home folder, so that a Blender that starts later finds a training that runs.
"""

import json
import os
import secrets
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from .errors import FileDamagedError, FileMissingError, OutputError

CONNECTION_FILE = "connection.json"
HOST = "127.0.0.1"
#: 256 bits, as 64 hexadecimal digits.
TOKEN_BYTES = 32


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


def new_token() -> str:
    return secrets.token_hex(TOKEN_BYTES)


def write_connection(folder: Path, connection: Connection) -> Path:
    """Write the file in one step, readable by its owner alone; raises ``OutputError``."""
    path = folder / CONNECTION_FILE
    temporary = folder / f".{CONNECTION_FILE}.{secrets.token_hex(4)}.tmp"
    try:
        # The mode is given at creation: there is no moment at which others could read it.
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            json.dump(asdict(connection), file)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(
            f"cannot write the connection file {path}: {error.strerror or error}",
            "Choose another --home, or make that folder writable.",
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return path


def read_connection(folder: Path) -> Connection:
    """Read it; raises ``FileMissingError`` where no backend is there, ``FileDamagedError``."""
    path = folder / CONNECTION_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileMissingError(f"no backend is running: there is no {path}", "Start one.") from None
    except (OSError, ValueError) as error:
        raise FileDamagedError(f"cannot read {path}: {error}", "Delete it and start the backend.") from error
    wanted = {entry.name: entry.type for entry in fields(Connection)}
    if (
        not isinstance(content, dict)
        or set(content) != set(wanted)
        or not all(type(content[name]) is kind for name, kind in wanted.items())
    ):
        raise FileDamagedError(f"{path} is not a connection file", "Delete it and start the backend.")
    return Connection(**content)


def remove_connection(folder: Path, token: str) -> None:
    """Remove the file if it is still this backend's own."""
    with suppress(FileMissingError, FileDamagedError, OSError):
        if read_connection(folder).token == token:
            (folder / CONNECTION_FILE).unlink()
