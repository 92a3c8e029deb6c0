# SPDX-License-Identifier: GPL-3.0-or-later
"""What is cached of compiled kernels: never code of other sources, and no start fails for want of a disk."""

import ast
import errno
import importlib.util
import os
import threading
import warnings
from pathlib import Path

import numba.core.config
import pytest
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from physhdr.backend.simd import compiling, kernel

ROOT = Path(compiling.__file__).parents[2]

#: What kernels may freeze: its file is not theirs (``sources``).
FROZEN = 1


def frozen(x):
    return x + FROZEN


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where kernels are cached that are made in a test."""
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def sources(monkeypatch):
    """Called with ``FROZEN``: the sources of an update."""

    def update(value: int) -> None:
        monkeypatch.setitem(globals(), "FROZEN", value)
        monkeypatch.setattr(compiling, "_fingerprint", lambda: 64 * str(value))

    update(1)
    return update


@pytest.fixture(autouse=True)
def nothing_was_said():
    compiling._warn.cache_clear()
    yield
    compiling._warn.cache_clear()


def started_anew():
    """The kernel as a new process would have it: nothing is loaded yet."""
    return kernel(frozen)


def cached(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.nb?"))


def hits(compiled) -> int:
    return sum(compiled.stats.cache_hits.values())


def test_a_later_start_finds_what_was_compiled_for_the_same_arguments(folder, sources):
    assert started_anew()(1) == 2
    later = started_anew()
    assert later(1) == 2 and hits(later) == 1
    assert later(1.5) == 2.5 and hits(later) == 1
    assert len(cached(folder)) == 2


def test_old_code_is_never_found_and_goes_when_there_is_much_newer_code(folder, sources):
    started_anew()(1)
    oldest = cached(folder)
    for value in range(2, compiling.OTHERS_KEPT + 3):
        sources(value)
        assert compiling.cached_files(started_anew()) == []
        assert started_anew()(1) == 1 + value
        assert (oldest[0] in cached(folder)) == (value < compiling.OTHERS_KEPT + 2)
    assert len(cached(folder)) == compiling.OTHERS_KEPT + 1


def test_a_kernel_of_a_file_that_is_none_of_the_sources_is_not_found_once_that_changes(
    folder, sources, monkeypatch
):
    started_anew()(1)
    monkeypatch.setattr(compiling, "_digest_of", lambda file: "another content")
    assert compiling.cached_files(started_anew()) == []


def test_copies_of_the_same_sources_share_their_kernels(folder, tmp_path):
    for place, found in ((tmp_path / "one", 0), (tmp_path / "other", 1)):
        place.mkdir()
        (place / "copied.py").write_text("def twice(x):\n    return 2 * x\n")
        spec = importlib.util.spec_from_file_location("copied", place / "copied.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        compiled = kernel(module.twice)
        assert compiled(2) == 4 and hits(compiled) == found


def test_code_that_the_disk_has_no_room_for_is_not_replaced_by_old_code(folder, sources, monkeypatch):
    started_anew()(1)
    sources(2)
    replace = os.replace

    def full(source, target, **more):
        if os.path.getsize(source) > 2000:  # what names the code may still fit
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target, **more)

    with monkeypatch.context() as patch, pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        patch.setattr(os, "replace", full)
        assert started_anew()(1) == 3
    assert started_anew()(1) == 3


def test_of_two_processes_that_save_at_once_neither_finds_the_others_code(folder, sources, monkeypatch):
    """One comes between the other's files: with an index, both would take its next number."""
    theirs_wait, ours_done = threading.Event(), threading.Event()
    replace, files_of_theirs = os.replace, []

    def save_theirs() -> None:
        started_anew()._cache._cache_file.save("theirs", "code of theirs" * 1000)
        theirs_wait.set()

    them = threading.Thread(target=save_theirs)

    def interrupted(source, target, **more):
        if threading.current_thread() is them:
            files_of_theirs.append(target)
            if len(files_of_theirs) == 2:
                theirs_wait.set()
                ours_done.wait(10)
        elif not them.ident:
            them.start()
            theirs_wait.wait(10)
        replace(source, target, **more)

    monkeypatch.setattr(os, "replace", interrupted)
    started_anew()._cache._cache_file.save("ours", "code of ours" * 1000)
    ours_done.set()
    them.join()
    files = started_anew()._cache._cache_file
    assert files.load("ours") == "code of ours" * 1000
    assert files.load("theirs") == "code of theirs" * 1000


@pytest.mark.parametrize("length", [0, 20, 500, -1])
def test_a_damaged_file_is_compiled_anew(folder, sources, length):
    """A computer that lost power may leave any part of a file."""
    started_anew()(1)
    (path,) = folder.rglob("*.nbc")
    path.write_bytes(path.read_bytes()[:length])
    later = started_anew()
    assert later(1) == 2 and hits(later) == 0
    assert hits(later := started_anew()) == 0 and later(1) == 2 and hits(later) == 1


def test_without_a_folder_kernels_work_and_one_warning_names_the_remedy(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr(CacheImpl, "_locator_classes", [UserProvidedCacheLocator])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        first, second = started_anew(), started_anew()
    assert first(1) == second(1) == 2
    assert [("NUMBA_CACHE_DIR" in str(each.message)) for each in said] == [True]
    assert compiling.cached_files(first) is None


def test_a_folder_that_goes_does_not_stop_a_kernel(folder, sources):
    compiled = started_anew()
    next(folder.iterdir()).rmdir()
    folder.rmdir()
    folder.touch()
    with pytest.warns(UserWarning, match="compiled anew at each start"):
        assert compiled(1) == 2


# ---- sources ---------------------------------------------------------------------------------------

#: What modules with kernels import for Python alone: errors, classes, and choices between implementations.
NOT_COMPILED = {
    "bridge/cores.py",
    "bridge/errors.py",
    "bridge/atomic.py",
    "bridge/limits.py",
    "bridge/user_cache.py",
    "backend/memory.py",
    "backend/kernels/plain.py",
    "backend/scene/camera.py",
    "backend/scene/scene.py",
}


def imported(path: Path) -> set[Path]:
    """Our own files from which the module imports when it is loaded."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            base = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for name in (alias.name for alias in node.names):
                places = [(base / name).with_suffix(".py"), base.with_suffix(".py"), base / "__init__.py"]
                found.add(next(place for place in places if place.is_file()))
    return found


def has_kernels(path: Path) -> bool:
    names = {
        alias.name
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    return bool(names & {"kernel", "njit", "intrinsic"})


def test_the_fingerprint_covers_all_that_kernels_are_made_of():
    covered = set(compiling.source_files())
    waiting = [path for path in (ROOT / "backend").rglob("*.py") if has_kernels(path)]
    assert len(waiting) > 20
    seen: set[Path] = set()
    while waiting:
        path = waiting.pop()
        name = path.relative_to(ROOT).as_posix()
        if path in seen or name in NOT_COMPILED:
            continue
        seen.add(path)
        assert path in covered, f"compiling.SOURCES lacks {name}, from which kernels are made"
        waiting += imported(path)
    assert ROOT / "bridge" / "splatting.py" in seen  # NEAR_PLANE, through the projection
