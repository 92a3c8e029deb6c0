# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are there complete or not at all, also after a power cut."""

import contextlib
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from .errors import OutputError

#: A temporary file that nobody has written to for so long (seconds) is of a process that was killed.
ABANDONED_SECONDS = 3600.0
#: Stands in the name of every temporary file, before the suffix.
MARK = ".tmp"
#: The folder of files that are not all written yet, in theirs.
UNFINISHED = ".unfinished"
#: Bytes of the longest name that a file may have, on most systems.
LONGEST_NAME = 255
#: How Windows says that somebody has a file open: access denied, a sharing violation, a lock's. Antivirus
#: programs and indexers do so for moments with whatever is new, readers for as long as they read.
HELD = (5, 32, 33)
#: Seconds in which a file that is held may be given up. What would be lost otherwise took longer.
HELD_SECONDS = 10.0
REMEDY = "Check that the folder can be written and that the disk has space, or choose another path."


@contextlib.contextmanager
def atomic_path(
    path: Path,
    *,
    remedy: str = REMEDY,
    mode: int = 0o666,
    check: Callable[[Path], None] | None = None,
    sync_name: bool = True,
) -> Iterator[Path]:
    """A temporary path beside ``path`` that becomes ``path`` only if the block ends without an error.

    The temporary file is this call's own, so that any number of processes may write to ``path`` at once: the
    last one to end wins, whole. It is there, empty, when the block begins, with the suffix of ``path`` if
    that has one, and on the disk before it gets its name. Creates the folder.

    ``mode``: the file's, less what the process's umask takes away, from its creation on. ``check``: called
    with ``path`` at the last moment; what it raises keeps what is there. ``sync_name``: whether the name is
    on the disk, too, at the end, which takes as long again; without it a power cut may bring back what was
    there before.

    Raises ``OutputError`` with the hint ``remedy`` if the folder or the file cannot be written; what was at
    ``path`` is then untouched.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise OutputError(f"cannot write {path}: a folder is there", "Choose another file name.")
        remove_leftovers(path, ABANDONED_SECONDS)
        temporary, given = _created(path, mode)
        yield temporary
        # A library that writes by a rename of its own has put a file of its own mode here.
        temporary.chmod(given)
        sync(temporary)
        if check is not None:
            check(path)
        patiently(partial(temporary.replace, path))
        temporary = None
        if sync_name:
            with contextlib.suppress(OSError):  # Windows cannot, and some disks refuse it
                sync(path.parent)
    except OSError as error:
        if _is_held(error) and os.path.exists(path):
            remedy = f"Close the program that has it open, or choose another path. Else: {remedy}"
        raise OutputError(f"cannot write {path}: {error.strerror or error}", remedy) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def all_at_once(folder: Path) -> Iterator[Path]:
    """A new folder in ``folder``, whose files take their places in that if the block ends without an error.

    Else what was there stays whole: files that belong together are no mixture of old and new. Raises
    ``OutputError`` where a file cannot take its place; those before it have taken theirs.
    """
    unfinished = folder / UNFINISHED
    shutil.rmtree(unfinished, ignore_errors=True)  # of one that was killed
    try:
        yield unfinished
        for written in sorted(path for path in unfinished.rglob("*") if path.is_file()):
            path = folder / written.relative_to(unfinished)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                patiently(partial(written.replace, path))
            except OSError as error:
                raise OutputError(f"cannot write {path}: {error.strerror or error}", REMEDY) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def patiently(move: Callable[[], object]) -> None:
    """Rename or replace a file or a folder by ``move``, as soon as nobody has it, or what is in it, open.

    Waits ``HELD_SECONDS`` at most, on Windows alone: elsewhere that hinders nobody. Raises ``OSError``.
    """
    until, pause = time.monotonic() + HELD_SECONDS, 0.01
    while True:
        try:
            move()
            return
        except OSError as error:
            if not _is_held(error) or time.monotonic() > until:
                raise
        time.sleep(pause)
        pause = min(2.0 * pause, 0.5)


def _is_held(error: OSError) -> bool:
    """Whether the error is Windows' for a file that somebody has open; other systems replace such files."""
    return getattr(error, "winerror", None) in HELD


def temporary_name(path: Path) -> Path:
    """A name beside ``path`` that no file has, with its suffix; ``remove_leftovers`` knows it again."""
    return path.with_name(f".{_stem(path)}-{secrets.token_hex(4)}{MARK}{path.suffix}")


def remove_leftovers(path: Path, older_than: float = 0.0) -> None:
    """Remove temporary files that processes which were killed left behind when they wrote ``path``.

    Only those that nobody has touched for ``older_than`` seconds; with 0 the caller must know that nobody
    writes ``path`` now.
    """
    begin, end, mark = (re.escape(each) for each in (f".{_stem(path)}-", path.suffix, MARK))
    ours = re.compile(f"{begin}[a-f0-9]{{8}}{mark}{end}")
    with contextlib.suppress(OSError):  # a folder that cannot be listed has nothing to tidy
        for entry in os.scandir(path.parent):
            if ours.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(OSError):  # another process was faster
                    if time.time() - entry.stat().st_mtime >= older_than:
                        os.unlink(entry.path)


def sync(path: Path) -> None:
    """Wait until the file, or the names in the folder, are on the disk; raises ``OSError``."""
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _created(path: Path, mode: int) -> tuple[Path, int]:
    """A new empty temporary file for ``path``, and the mode that it was given; raises ``OSError``."""
    temporary = temporary_name(path)
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        return temporary, stat.S_IMODE(os.fstat(descriptor).st_mode)
    finally:
        os.close(descriptor)


def _stem(path: Path) -> str:
    """The stem, shortened where a temporary name would be too long though the name itself is not."""
    room = LONGEST_NAME - len(f".-12345678{MARK}".encode()) - len(os.fsencode(path.suffix))
    stem = path.stem
    while stem and len(os.fsencode(stem)) > room:
        stem = stem[:-1]
    return stem
