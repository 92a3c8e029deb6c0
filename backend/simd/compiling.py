# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels are compiled and cached.

Numba's on-disk cache looks at the file of the cached function only, so a kernel would outlive a change of
what it calls (``simd``) or of a constant that it took from elsewhere. Here the cache also asks whether any
source of the kernels has changed.
"""

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

_HERE = Path(__file__).parent
_RASTERIZE = _HERE.parent / "rasterize"
_SOURCES = (_HERE, _HERE.parent / "kernels", _RASTERIZE / "cpu", _RASTERIZE / "contract.py")


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for several threads (without Python's lock), keep the result on disk, divide as numpy does."""
    compiled: Any = njit(nogil=True, cache=True, error_model="numpy")(function)
    file: Any = getattr(compiled._cache, "_cache_file", None)
    if hasattr(file, "_source_stamp"):
        file._source_stamp = (file._source_stamp, _fingerprint())
    return compiled


@functools.cache
def _fingerprint() -> str:
    files = [f for source in _SOURCES for f in (sorted(source.glob("*.py")) if source.is_dir() else [source])]
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()
