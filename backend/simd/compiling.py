# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels are compiled and kept on disk.

Numba's own cache looks at the file of the cached function only, so a kernel would outlive a change of what it
calls (``simd``) or of a constant that it took from elsewhere. And its index of a function's files is read and
written without a lock, before what it names: of two processes that compile at once, or of one that is killed
or finds the disk full, it may name a file that has other code. Here there is no index. A file's name says of
which sources and for which arguments it is, so that nothing else can be found under it, and it is there whole
or not at all.
"""

import functools
import hashlib
import os
import pickle
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

from ...bridge.atomic import atomic_path
from ...bridge.errors import OutputError

_HERE = Path(__file__).parent
_BACKEND = _HERE.parent
_BRIDGE = _BACKEND.parent / "bridge"

#: What kernels are made of: where they stand, and where constants come from that become part of them.
SOURCES = (
    _HERE,
    _BACKEND / "kernels",
    _BACKEND / "rasterize" / "cpu",
    _BACKEND / "rasterize" / "contract.py",
    _BACKEND / "start" / "merged_brackets.py",
    _BRIDGE / "splatting.py",
    _BRIDGE / "spherical_harmonics.py",
)
#: Bytes of the check sum that a file begins with.
_DIGEST = hashlib.sha256().digest_size


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for several threads (without Python's lock), keep the result on disk, divide as numpy does.

    Where no folder can be written nothing is kept, with a warning.
    """
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    try:
        compiled._cache = _Cache(function)
    except RuntimeError:  # Numba finds no folder that can be written
        _warn()
    return compiled


def kept_on_disk(compiled: Any) -> list[Path] | None:
    """The files that have what was compiled of a kernel's sources as they are; None: nothing can be kept."""
    cache = compiled._cache
    return list(cache.files.ours()) if isinstance(cache, _Cache) else None


def source_files() -> list[Path]:
    """The files of ``SOURCES``."""
    return [f for source in SOURCES for f in (sorted(source.glob("*.py")) if source.is_dir() else [source])]


class _Cache(FunctionCache):
    """Numba's cache of a function, in our files. Raises ``RuntimeError`` where no folder can be written."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self.files = _Files(Path(self._cache_path), self._impl.filename_base)
        self._cache_file: Any = self.files

    def save_overload(self, sig: Any, data: Any) -> None:
        # It is compiled, and this process can go on with it.
        try:
            super().save_overload(sig, data)
        except (OSError, OutputError):
            _warn()


class _Files:
    """What was compiled of a kernel, a file for each kind of processor and types of arguments (a ``key``).

    ``base``: Numba's name of the function, ``module.function-line.python``.
    """

    def __init__(self, folder: Path, base: str) -> None:
        self._folder = folder
        self._base = f"{base}.{_fingerprint()[:16]}"
        # In other sources the function may stand in another line; and there are files of Numba's own cache.
        name, python = base.rpartition("-")[0], base.rpartition(".")[2]
        self._of_any_sources = f"{name}-*.{python}.*"

    def ours(self) -> Iterator[Path]:
        """Those of the sources as they are."""
        return self._folder.glob(f"{self._base}.*.nbc")

    def load(self, key: object) -> Any:
        """What was saved under the key; None if nothing was, or if it is damaged."""
        try:
            content = self._path(key).read_bytes()
        except OSError:
            return None
        told, packed = content[:_DIGEST], content[_DIGEST:]
        if hashlib.sha256(packed).digest() != told:  # a computer that lost power may leave an empty file
            return None
        saved, data = pickle.loads(packed)
        return data if saved == key else None

    def save(self, key: object, data: object) -> None:
        """Raises ``OutputError``. What was compiled from other sources goes."""
        with atomic_path(self._path(key), sync_name=False) as temporary:
            packed = dumps((key, data))
            temporary.write_bytes(hashlib.sha256(packed).digest() + packed)
        for path in set(self._folder.glob(self._of_any_sources)) - set(self.ours()):
            with suppress(OSError):  # another process was faster, or has it open
                path.unlink()

    def flush(self) -> None:
        """Remove all that is kept of the sources as they are."""
        for path in self.ours():
            path.unlink(missing_ok=True)

    def _path(self, key: object) -> Path:
        return self._folder / f"{self._base}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


@functools.cache
def _fingerprint() -> str:
    """Of the sources, and of what compiles them."""
    contents = [numba.__version__.encode(), *(f.read_bytes() for f in source_files())]
    return hashlib.sha256(b"".join(contents)).hexdigest()


@functools.cache  # once
def _warn() -> None:
    folder = os.environ.get("NUMBA_CACHE_DIR") or "the user's cache folder"
    warnings.warn(
        f"compiled kernels cannot be kept in {folder}: they are compiled anew at each start, which takes "
        "half a minute; set NUMBA_CACHE_DIR to a folder that can be written, on a disk with space",
        stacklevel=2,
    )
