# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are there complete or not at all, also after a power cut."""

import contextlib
import os
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from .errors import OutputError

#: A temporary file that nobody has written to for so long (seconds) is of a process that was killed.
ABANDONED_SECONDS = 3600.0


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that becomes ``path`` only if the block ends without an error.

    The temporary file is this call's own, so that any number of processes may write to ``path`` at once: the
    last one to end wins, whole. It is on the disk before it gets its name. Creates the folder. Raises
    ``OutputError`` if the folder or the file cannot be written; what was at ``path`` is then untouched.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise OutputError(f"cannot write {path}: a folder is there", "Choose another file name.")
        remove_leftovers(path, ABANDONED_SECONDS)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        # mkstemp makes files that only their owner reads; give what open() would have given.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        sync(temporary)
        temporary.replace(path)
        temporary = None
        with contextlib.suppress(OSError):  # the name: Windows cannot, and some disks refuse it
            sync(path.parent)
    except OSError as error:
        raise OutputError(
            f"cannot write {path}: {error.strerror or error}",
            "Check that the folder can be written and that the disk has space, or choose another path.",
        ) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def remove_leftovers(path: Path, older_than: float = 0.0) -> None:
    """Remove temporary files that processes which were killed left behind when they wrote ``path``.

    Only those that nobody has touched for ``older_than`` seconds; with 0 the caller must know that nobody
    writes ``path`` now.
    """
    ours = re.compile(rf"\.{re.escape(path.stem)}-[a-z0-9_]{{8}}{re.escape(path.suffix)}")
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
