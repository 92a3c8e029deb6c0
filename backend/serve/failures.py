# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors as data: failures of the backend as ``Failure`` messages."""

import errno
import os

from ...bridge.errors import PhysHDRError
from ...bridge.messages import Failure
from ..memory import is_out_of_memory

OUT_OF_MEMORY = "out_of_memory"
#: The system refuses a path, or writing to it.
PATH = "path"
FREE_SPACE = "Free some space, or choose a folder on another disk; training resumes from its last checkpoint."
ANOTHER_DISK = "Check that the disk is connected and works, or choose a folder on another one."
#: Errors of a disk; when reading or writing, the system does not name the file.
OF_THE_DISK = {
    errno.ENOSPC: FREE_SPACE,
    errno.EDQUOT: FREE_SPACE,
    errno.EFBIG: "The disk does not take files of that size: choose a folder on another one.",
    errno.EROFS: "Nothing can be written there: choose a folder on another disk.",
    errno.EIO: ANOTHER_DISK,
    errno.ESTALE: ANOTHER_DISK,
}
#: Remedies for errors of a path.
OF_A_PATH = {
    errno.ENAMETOOLONG: "Choose a shorter path; most disks take names of up to 255 bytes.",
    errno.ENOENT: "Check that it still exists, or choose another path.",
    errno.ENOTDIR: "A file is where a folder is needed: choose another path.",
    errno.EACCES: "Change its permissions, or choose another path.",
    errno.EPERM: "Change its permissions, or choose another path.",
    errno.ELOOP: "Its links lead in a circle: fix them, or choose another path.",
    errno.EMFILE: "Too many files are open at once: end the backend and start it again.",
}


class BusyError(PhysHDRError):
    """The request would disturb other work."""


class PackageMissingError(PhysHDRError):
    """A package that the backend needs is not installed, or cannot be loaded."""


class NoModelError(PhysHDRError):
    """There is no model to render or to export."""


class NoJobError(PhysHDRError):
    """There is no training to pause, continue or stop."""


def failure_of(error: BaseException, log: str = "", place: str = "") -> Failure:
    """The message for an error.

    ``log``: the file with its traceback. ``place``: the folder in use, named if a disk fails and the system
    does not name the file.
    """
    if isinstance(error, PhysHDRError):
        return Failure(code=error.code, message=error.message, hint=error.hint)
    if is_out_of_memory(error):
        return Failure(
            code=OUT_OF_MEMORY,
            message="there is not enough memory",
            hint="Close other programs, or train on smaller pictures or with fewer Gaussians. Training "
            "was saved if its state was complete: resume it when there is enough memory.",
        )
    if isinstance(error, OSError) and (refused := _refused_path(error, place)):
        return refused
    first = (str(error).strip().splitlines() or [""])[0]
    return Failure(
        code="internal",
        message=f"the backend failed unexpectedly: {type(error).__name__}: {first}",
        hint=f"This is a bug in PhysHDR: please report it with the log {log}." if log else "See its log.",
    )


def _refused_path(error: OSError, place: str) -> Failure | None:
    """The failure if the system refuses a path or a disk refuses data; else ``None``."""
    # When renaming fails, the second name is the one that a user chose.
    named = error.filename2 or error.filename
    if isinstance(named, bytes | str) and named:
        path = os.fsdecode(named)
    elif error.errno in OF_THE_DISK:
        path = f"a file in {place}" if place else "a file"
    else:
        return None  # of a connection or a process, not a path
    remedy = (OF_THE_DISK | OF_A_PATH).get(
        error.errno or 0, "Check that path and its permissions, or choose another one."
    )
    # Surrogates stand for bytes that are not UTF-8 and cannot be displayed.
    words = f"the system refuses {path}: {error.strerror or error}".encode("utf-8", "replace").decode("utf-8")
    return Failure(code=PATH, message=words, hint=remedy)
