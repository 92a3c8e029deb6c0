# SPDX-License-Identifier: GPL-3.0-or-later
"""The data set's folder: who it belongs to, atomic writes, and the state that a resumed run compares with.

While a run is under way ``dataset.partial.json`` holds the options (and the noise floor once measured);
it becomes ``dataset.json`` when all is there. A file under its final name is always whole.
"""

import json
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..bridge.atomic import MARK, atomic_path, temporary_name
from ..bridge.data_set import FORMAT, INFO_FILE, PARTIAL_FILE, VERSION
from ..bridge.errors import OutputError
from .errors import ConflictError, DamagedFileError, OutputFolderError

#: The option that stands for the state of a user's scene.
FINGERPRINT = "fingerprint"
LONGEST_SHOWN = 200


def scratch(path: Path) -> Path:
    """A temporary name for what Blender writes, which has to end in .exr."""
    return temporary_name(path.with_suffix(".exr"))


def write(path: Path, data: bytes) -> None:
    """Write under a temporary name, then rename: a reader never sees half a file.

    A file whose name a power cut takes is made again: waiting for a dozen names would cost a tenth of a
    second a pose, which takes about one to render.

    Raises:
        OutputFolderError: the disk is full, or not to be written.
    """
    try:
        with atomic_path(path, sync_name=False) as pending:
            pending.write_bytes(data)
    except OutputError as error:
        raise OutputFolderError(
            error.message,
            "is the disk full? Make room and give the same command again: what is there is kept",
        ) from error


def read(path: Path) -> bytes:
    """All of a file. Nothing else is opened: a pipe in the folder would be waited for for ever.

    Raises:
        DamagedFileError: not a file, or not to be read.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise DamagedFileError(f"cannot read '{path}': it is not a file: remove it")
        return path.read_bytes()
    except OSError as error:
        raise DamagedFileError(f"cannot read '{path}': {error.strerror or error}") from error


def remove_leftovers(folder: Path) -> None:
    """Remove the half-written files of runs that were killed. Only when nobody writes any more."""
    for path in folder.rglob(f".*{MARK}*"):
        with suppress(OSError):
            path.unlink()


def write_json(path: Path, content: dict[str, Any]) -> None:
    write(path, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode("utf-8"))


def read_json(path: Path) -> dict[str, Any]:
    """
    Raises:
        DamagedFileError: not a file, not JSON, or not an object.
    """
    try:
        content = json.loads(read(path).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise DamagedFileError(
            f"'{path}' is damaged ({error}): delete it, or choose another folder (--out)"
        ) from error
    if not isinstance(content, dict):
        raise DamagedFileError(
            f"'{path}' is damaged (no object): delete it, or choose another folder (--out)"
        )
    return content


def read_description(folder: Path) -> dict[str, Any]:
    """``dataset.json`` of a data set, or what stands for it while it is being made.

    Raises:
        DamagedFileError: neither is there, or it cannot be read.
    """
    whole = folder / INFO_FILE
    return read_json(whole if whole.exists() else folder / PARTIAL_FILE)


def open_folder(folder: Path, options: dict[str, Any], maker: dict[str, str]) -> dict[str, Any]:
    """Make or enter the folder; the state of an earlier run with the same options, or {} for a new one.

    ``maker``: this program and its version. Another one's pictures would not fit those of this one.

    Raises:
        OutputFolderError: cannot be made or written, or holds files of somebody else.
        ConflictError: holds a data set made with other options, or by another version.
        DamagedFileError: its dataset.json cannot be read.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = temporary_name(folder / "write-probe")
        probe.write_bytes(b"")
        probe.unlink(missing_ok=True)
        held = [entry.name for entry in folder.iterdir()]
    except OSError as error:
        raise OutputFolderError(
            f"cannot write to the output folder '{folder}': {error.strerror or error}. "
            "Choose another folder (--out)"
        ) from error
    names = [name for name in (INFO_FILE, PARTIAL_FILE) if name in held]
    if not names:
        if any(not name.startswith(".") for name in held):
            raise OutputFolderError(
                f"'{folder}' holds files but no {INFO_FILE}: "
                "choose a new or empty folder (nothing was changed)"
            )
        return {}
    state = read_json(folder / names[0])
    ours = state.get("format") == FORMAT and state.get("version") == VERSION
    if not ours or not isinstance(state.get("options"), dict):
        raise OutputFolderError(
            f"'{folder / names[0]}' is not of this program: choose another folder (--out)"
        )
    if state.get("generator") != maker:
        raise ConflictError(
            f"'{folder}' was made by {_maker_name(state.get('generator'))}, this is {_maker_name(maker)}",
            "continue with that version, or choose another folder (--out; nothing was changed)",
        )
    earlier = state["options"]
    differing = [key for key in {**options, **earlier} if earlier.get(key) != options.get(key)]
    if differing:
        differences = [
            f"{_shown(key)} is {_shown(earlier.get(key))} there, {options.get(key)} asked"
            for key in differing
        ]
        remedy = "choose another folder (--out), or delete that one (nothing was changed)"
        if differing == [FINGERPRINT]:
            differences = ["the scene, its lights or its camera have changed since"]
        raise ConflictError(
            f"'{folder}' holds a data set made with other options: {'; '.join(differences)}", remedy
        )
    return state


def _maker_name(maker: Any) -> str:
    return _shown(", ".join(map(str, maker.values()))) if isinstance(maker, dict) else "an unknown version"


def _shown(value: Any) -> str:
    """What a file says, in a message: of a sensible length, and with nothing that a terminal cannot show."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(value)[:LONGEST_SHOWN])
