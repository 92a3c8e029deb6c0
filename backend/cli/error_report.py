# SPDX-License-Identifier: GPL-3.0-or-later
"""How a command reports an error that a user can fix: to people, and as data to programs (``--json``).

Needed before any library is loaded, and when almost no memory is left: standard library only.
"""

import errno
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ...bridge.errors import OutputError, PhysHDRError
from ...bridge.run_folder import CHECKPOINT_FILE
from ..memory import address_limit, gigabytes, is_out_of_memory
from ..shell import as_word, option


@dataclass(frozen=True)
class ErrorReport:
    """``code``: the cause (docs/protocol.md); ``message``: what was wrong; ``hint``: the remedy."""

    code: str
    message: str
    hint: str

    def __str__(self) -> str:
        return f"{self.message}\n  {self.hint}" if self.hint else self.message


def describe_error(error: Exception, argv: Sequence[str] = ()) -> ErrorReport | None:
    """How to report an error of the command ``argv``; None if it is a bug of ours."""
    run = _run_in(argv)
    if is_out_of_memory(error):
        limit = address_limit()
        allowed = "" if limit is None else f": ulimit -v allows {gigabytes(limit)} of address space"
        return ErrorReport(
            "out_of_memory",
            f"there is not enough memory{allowed}",
            f"{'Close other programs' if limit is None else 'Lift the limit: ulimit -v unlimited'}"
            f"{_SMALLER if list(argv[:1]) == ['train'] else ''}.{_resumption(run)}",
        )
    if isinstance(error, PhysHDRError):
        resume = _resumption(run) if isinstance(error, OutputError) else ""
        return ErrorReport(error.code, error.message, error.hint + resume)
    if isinstance(error, ModuleNotFoundError):
        return ErrorReport("package_missing", str(error), "Install what is missing: physhdr check names it.")
    if isinstance(error, OSError):
        return ErrorReport("path", _what_failed(error), _what_helps(error, run))
    return None


#: How training needs less memory, after another remedy.
_SMALLER = (
    f", or train on smaller pictures ({option('downscale', 2)}) "
    f"or with fewer Gaussians ({option('backbone.budget', 20000)})"
)


def _what_failed(error: OSError) -> str:
    """The file, where the error names one, and the system's message."""
    said = error.strerror or str(error) or type(error).__name__
    names = " → ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
    return f"{names}: {said}" if names else said


def _what_helps(error: OSError, run: Path | None) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        where = "that disk" if error.filename is not None else f"the disk of {run or 'the output'}"
        return f"Free some space on {where}, then try again.{_resumption(run)}"
    if error.filename is not None:
        return "Check that path, its permissions, and that the disk has space."
    where = f" of {run}" if run else ""
    return f"Check the permissions and the free space{where}, then try again."


def _run_in(argv: Sequence[str]) -> Path | None:
    """The folder of the run that ``train`` was to write or resume, where the command names one."""
    if list(argv[:1]) != ["train"]:
        return None
    for word, value in zip(argv, [*argv[1:], ""], strict=True):
        name, _, assigned = word.partition("=")
        if name in ("--out", "--resume"):
            return Path(assigned or value)
    return None


def _resumption(run: Path | None) -> str:
    """How to resume a run that has a checkpoint, as a further sentence."""
    if run is None or not (run / CHECKPOINT_FILE).is_file():
        return ""
    return f" Resume from the checkpoint: physhdr train --resume {as_word(run)}"
