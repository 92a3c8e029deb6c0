# SPDX-License-Identifier: GPL-3.0-or-later
"""Opening what a user names: only a regular file, whose bytes end, and never more of it than is sensible.

A pipe in a data set's folder would otherwise be waited for for ever, and a device read until memory is full.
"""

import errno
import json
import os
import stat
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError

#: Bytes of a text that is read whole; a transforms file of a hundred thousand frames has 60 million.
LARGEST_TEXT = 1 << 27
#: Bytes of a header before rows or tensors; that of a lossless PLY, with its networks, has some 300,000.
LONGEST_HEADER = 1 << 21

#: What a path may lead to instead of a file.
_OTHERS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def require_text(name: str) -> None:
    """Raises ``BadValueError`` where a path or a word of a command has bytes that are no UTF-8.

    Python carries them along, but no message can show them, and safetensors and JSON refuse them: a training
    would fail when it saves.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise BadValueError(
            f"{name!a} has bytes that are not UTF-8", "Rename the file or folder, or give another path."
        ) from None


def resolved(path: Path) -> Path:
    """``path``, absolute and without links; of links that lead to each other as far as they lead.

    ``Path.resolve`` raises ``RuntimeError`` of such, before Python 3.13.
    """
    return Path(os.path.realpath(path))


def regular_file(path: Path, remedy: str = "") -> Path:
    """``path``, which leads to a regular file, maybe over links; nothing is opened.

    ``remedy`` is the errors' hint. Raises ``FileMissingError`` where nothing or a folder is there,
    ``FileDamagedError`` where it is a pipe, a socket or a device, or cannot be read.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR):
            raise FileMissingError(f"{path} is missing", remedy) from error
        shown = f"{path!s:.400}…" if error.errno == errno.ENAMETOOLONG else str(path)
        raise FileDamagedError(f"{shown} cannot be read: {error.strerror or error}", remedy) from error
    except ValueError as error:  # a zero byte, or what no file's name can be spelled with
        raise FileMissingError(f"{str(path)!r} cannot be the name of a file", remedy) from error
    if stat.S_ISDIR(mode):
        raise FileMissingError(f"{path} is a folder, not a file", remedy)
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in _OTHERS if test(mode)), "something else")
        raise FileDamagedError(f"{path} is {kind}, not a file", remedy)
    return path


@contextmanager
def damaged_where_it_fails(what: str, remedy: str = "") -> Iterator[None]:
    """Any failure of a library on a file's bytes as ``FileDamagedError``: "``what`` (its message)".

    Few libraries say which errors their readers raise, and none keeps to it on damaged bytes; some repeat
    these at any length. Only the library's call belongs inside.
    """
    try:
        yield
    except PhysHDRError:
        raise
    except Exception as error:
        raise FileDamagedError(f"{what} ({_first_words(error)})", remedy) from error


def _first_words(error: Exception) -> str:
    """What an error says, in one line, or its kind where it says nothing; OpenUSD's cannot be said where a
    file's bytes that it repeats are no UTF-8.
    """
    try:
        return " ".join(str(error).split())[:200] or type(error).__name__
    except UnicodeError:
        return type(error).__name__


def without_waiting(path: str, flags: int) -> int:
    """An ``opener`` for ``open`` on what may be a pipe, which it would wait for until somebody writes."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_bytes(path: Path, remedy: str = "", limit: int = LARGEST_TEXT) -> bytes:
    """All of a file.

    Raises what ``regular_file`` raises, ``FileDamagedError`` where it has more than ``limit`` bytes or cannot
    be read.
    """
    regular_file(path, remedy)
    try:
        size = path.stat().st_size
        if size > limit:
            raise FileDamagedError(f"{path} has {size} bytes: no such file has more than {limit}", remedy)
        return path.read_bytes()
    except OSError as error:
        raise FileDamagedError(f"{path} cannot be read: {error.strerror or error}", remedy) from error


def read_text(path: Path, remedy: str = "", limit: int = LARGEST_TEXT) -> str:
    """A text file in UTF-8, with or without a byte order mark; raises what ``read_bytes`` raises, and
    ``FileDamagedError`` where it is not UTF-8.
    """
    try:
        return read_bytes(path, remedy, limit).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileDamagedError(f"{path} cannot be read as text: {error}", remedy) from error


def read_json(path: Path, remedy: str = "", limit: int = LARGEST_TEXT) -> Any:
    """What a JSON file holds, as ``parse_json`` has it.

    Raises what ``read_bytes`` raises, ``FileDamagedError`` where it is no JSON.
    """
    raw = read_bytes(path, remedy, limit)
    try:
        return parse_json(raw.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise FileDamagedError(
            f"{path} is not valid JSON: line {error.lineno}, column {error.colno}: {error.msg}",
            f"Fix that line. {remedy}".rstrip(),
        ) from error
    except (ValueError, RecursionError) as error:  # not UTF-8, thousands of digits, thousands of brackets
        raise FileDamagedError(f"{path} cannot be read as JSON: {error}", remedy) from error


def parse_json(text: str) -> Any:
    """What a JSON text says; raises ``ValueError`` and ``RecursionError``.

    Refused, too, is what Python's reader lets pass: a name that stands twice in an object, of which only the
    last would count, and halves of characters, which no terminal or file can show.
    """
    content = json.loads(text, object_pairs_hook=unique_names)
    if "\\ud" in text or "\\uD" in text:
        json.dumps(content, ensure_ascii=False).encode("utf-8")
    return content


def read_json_object(path: Path, remedy: str = "", limit: int = LARGEST_TEXT) -> dict[str, Any]:
    """The object in a JSON file; raises what ``read_json`` raises, ``FileDamagedError`` for other values."""
    content = read_json(path, remedy, limit)
    if not isinstance(content, dict):
        raise FileDamagedError(f"{path} holds a {type(content).__name__}, not an object", remedy)
    return content


def unique_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object's names and values; raises ``ValueError`` for a name that is there twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        ((twice, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"{twice!r:.80} stands twice in one object")
    return found
