# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors as data: what goes wrong in the backend, as a ``Failure`` for the wire."""

from ...bridge.errors import PhysHDRError
from ...bridge.messages import Failure

OUT_OF_MEMORY = "out_of_memory"
#: What torch says on the CPU, as a plain RuntimeError.
OUT_OF_MEMORY_WORDS = ("can't allocate memory", "not enough memory", "CUDA out of memory")


class BusyError(PhysHDRError):
    """Something else is being done that the request would disturb."""


class NoModelError(PhysHDRError):
    """There is no model to render or to export."""


class NoJobError(PhysHDRError):
    """No training runs that could be paused, continued or stopped."""


def failure_of(error: BaseException, log: str = "") -> Failure:
    """What to tell of an error. ``log``: where its traceback can be read."""
    if isinstance(error, PhysHDRError):
        return Failure(code=error.code, message=error.message, hint=error.hint)
    if is_out_of_memory(error):
        return Failure(
            code=OUT_OF_MEMORY,
            message="there is not enough memory",
            hint="Close other programs, or train on smaller pictures or with fewer Gaussians. A training "
            "was saved where its state was whole: resume it when there is room.",
        )
    first = (str(error).strip().splitlines() or [""])[0]
    return Failure(
        code="internal",
        message=f"the backend failed unexpectedly: {type(error).__name__}: {first}",
        hint=f"This is a fault of PhysHDR: please report it with the log {log}." if log else "See its log.",
    )


def is_out_of_memory(error: BaseException) -> bool:
    """Whether the error is Python's, torch's or CUDA's lack of memory."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and any(words in str(error) for words in OUT_OF_MEMORY_WORDS)
    )
