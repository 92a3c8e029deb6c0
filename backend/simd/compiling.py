# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels are compiled and cached on disk.

Numba's own cache looks at the file of the cached function only, so a kernel would outlive a change of what it
calls (``simd``) or of a constant that it took from elsewhere. And its index of a function's files is read and
written without a lock, before what it names: of two processes that compile at once, or of one that is killed
or finds the disk full, it may name a file that has other code. Here there is no index. A file's path says of
which sources and for which arguments it is, so that nothing else can be found under it, and it is there whole
or not at all. Copies of the same sources share their kernels, wherever they are installed.
"""

import functools
import hashlib
import inspect
import pickle
import shutil
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numba
from numba import njit
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.core.serialize import dumps

from ...bridge.atomic import atomic_path
from ...bridge.errors import OutputError
from ...bridge.user_cache import user_cache

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
#: How many folders of other sources stay beside one that is new: of other versions, or of other copies.
OTHERS_KEPT = 4
#: Bytes of the check sum that a file begins with.
_DIGEST = hashlib.sha256().digest_size


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for several threads (without Python's lock), cache the result on disk, divide as numpy does.

    Where the folder cannot be written nothing is cached, with a warning.
    """
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    try:
        compiled._cache = _Cache(function)
    except RuntimeError:  # the folder cannot be written
        _warn()
    return compiled


def cached_files(compiled: Any) -> list[Path] | None:
    """The files of what was compiled from a kernel's sources as they are; None: nothing can be cached."""
    cache = compiled._cache
    return list(cache.files.ours()) if isinstance(cache, _Cache) else None


def source_files() -> list[Path]:
    """The files of ``SOURCES``."""
    return [f for source in SOURCES for f in (sorted(source.glob("*.py")) if source.is_dir() else [source])]


def _cache_root() -> Path:
    """Has a folder for each state of the sources."""
    chosen = config.CACHE_DIR  # pyright: ignore[reportAttributeAccessIssue]
    return Path(chosen or user_cache() / "kernels")


class _Locator(UserProvidedCacheLocator):
    """The folder of the sources as they are, made where it is missing."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(_cache_root() / _fingerprint()[:16])

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "_Locator | None":
        located = cls(py_func, py_file)
        new = not Path(located.get_cache_path()).exists()
        try:
            located.ensure_cache_path()
        except OSError:
            return None
        if new:
            _remove_oldest(Path(located.get_cache_path()))
        return located


def _remove_oldest(new: Path) -> None:
    """Of the folders beside the new one only ``OTHERS_KEPT`` stay: those that last changed."""
    others = [folder for folder in new.parent.glob("[0-9a-f]" * 16) if folder != new]
    with suppress(OSError):  # another process was faster
        others.sort(key=lambda folder: folder.stat().st_mtime)
    for folder in others[:-OTHERS_KEPT]:
        shutil.rmtree(folder, ignore_errors=True)


class _Implementation(CompileResultCacheImpl):
    _locator_classes: ClassVar[list[type]] = [_Locator]


class _Cache(FunctionCache):
    """Numba's cache of a function, in our files. Raises ``RuntimeError`` where they cannot be written."""

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        # Numba names the last part of the module alone, and several folders have a module of that name.
        name = f"{function.__module__}.{self._impl.filename_base.partition('.')[2]}"
        base = f"{name}.{_digest_of(inspect.getfile(function))[:8]}"
        self.files = _Files(Path(self._cache_path), base)
        self._cache_file: Any = self.files

    def save_overload(self, sig: Any, data: Any) -> None:
        # It is compiled, and this process can go on with it.
        try:
            super().save_overload(sig, data)
        except (OSError, OutputError):
            _warn()


class _Files:
    """What was compiled of a kernel, a file for each kind of processor and types of arguments (a ``key``).

    ``folder``: of the sources as they are. ``base``: the function and the file that has it, which need not be
    one of the sources, ``module.function-line.python.digest``.
    """

    def __init__(self, folder: Path, base: str) -> None:
        self._folder = folder
        self._base = base

    def ours(self) -> Iterator[Path]:
        """All that there are."""
        return self._folder.glob(f"{self._base}.*.nbc")

    def load(self, key: object) -> Any:
        """What was saved under the key; None if nothing was, or if it is damaged."""
        try:
            content = self._path(key).read_bytes()
        except OSError:
            return None
        digest, packed = content[:_DIGEST], content[_DIGEST:]
        if hashlib.sha256(packed).digest() != digest:  # a computer that lost power may leave an empty file
            return None
        saved, data = pickle.loads(packed)
        return data if saved == key else None

    def save(self, key: object, data: object) -> None:
        """Raises ``OutputError``."""
        with atomic_path(self._path(key), sync_name=False) as temporary:
            packed = dumps((key, data))
            temporary.write_bytes(hashlib.sha256(packed).digest() + packed)

    def flush(self) -> None:
        """Remove all of them."""
        for path in self.ours():
            path.unlink(missing_ok=True)

    def _path(self, key: object) -> Path:
        return self._folder / f"{self._base}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


@functools.cache
def _digest_of(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


@functools.cache
def _fingerprint() -> str:
    """Of the sources, and of what compiles them."""
    contents = [numba.__version__.encode(), *(f.read_bytes() for f in source_files())]
    return hashlib.sha256(b"".join(contents)).hexdigest()


@functools.cache  # once
def _warn() -> None:
    warnings.warn(
        f"compiled kernels cannot be written to {_cache_root()}: they are compiled anew at each start, "
        "which takes half a minute; set NUMBA_CACHE_DIR to a writable folder, on a disk with space",
        stacklevel=2,
    )
