# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep freed memory for the next iteration.

An iteration allocates and frees the same few dozen arrays of some MB. glibc returns such blocks to the
kernel at once and gets them back as pages that must be zeroed and mapped again, one fault for every 4 KiB.
Told to, it keeps them. One setting covers torch's tensors and numpy's arrays alike, which workspaces of our
own would not; what it gains is in lab/performance.md.

What is kept lies in pieces between what is in use. Where arrays become larger or more, the pieces no longer
fit and new ones are made beside them: a training of large pictures then holds half as much again as it needs
(lab/performance.md). Given back now and then, they are pages again that any array may have.
"""

import ctypes
import sys

# <malloc.h>
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4
_NEVER = 2**31 - 1


def keep_freed_memory() -> bool:
    """Tell glibc; False where the C library is another one (its own ways are left alone)."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return bool(mallopt and mallopt(_M_MMAP_MAX, 0) and mallopt(_M_TRIM_THRESHOLD, _NEVER))


def give_back_freed_memory() -> None:
    """Return to the system what is freed, wherever in the heap; elsewhere than in glibc nothing was kept."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim:
            trim(0)
