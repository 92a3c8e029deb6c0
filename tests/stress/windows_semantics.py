# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows' ways with files, faked on Linux: ``pytest --as-on-windows tests/bridge …`` (``conftest.py``).

What PhysHDR's own code asks of ``os`` is refused as Windows refuses it; tests and libraries are let alone:

* a file that this process or a child has open or mapped is neither replaced, renamed nor removed, nor is a
  folder that holds one (Python opens without FILE_SHARE_DELETE); nor is a file that is read-only;
* a rename does not replace, and no folder is opened or brought to the disk;
* links need a right that users lack; names have no ``< > : " | ? *``, no dot or blank at their end, and are
  none of the reserved ones. Names are also checked after each test, in its folder, for what libraries and
  children made, and for two that differ by their case alone;
* a text is opened with its encoding named: the default would be cp1252.

What ``os`` and ``signal`` lack there, pyright says (``make lint``). What neither can show: paths are still
Linux's (no drives, no backslashes, no 260 characters), ``sys.platform`` is, libraries do with a name what
they do here, and of Windows' own calls, the console, antivirus programs and cards there is nothing.
"""

import builtins
import errno
import io
import os
import shutil
import stat
import sys
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import filelock
import pytest

ROOT = Path(__file__).resolve().parents[2]
OURS = tuple(f"{ROOT / room}{os.sep}" for room in ("addon", "backend", "bridge", "lab", "synth"))
#: Whose frames are passed over when it is asked who calls.
LIBRARY = (sysconfig.get_path("stdlib") + os.sep, "<frozen ", __file__)
INSTALLED = sysconfig.get_path("purelib") + os.sep
#: Characters that no name on Windows has, and names that are devices.
FORBIDDEN = set('<>:"|?*\\') | {chr(code) for code in range(32)}
RESERVED = {"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))}

#: Tests of what Windows does in another way, and why.
OTHERWISE = {
    "test_it_is_on_the_disk_before_it_has_its_name": "folders are not brought to the disk there",
    "test_a_run_of_one_kind_of_plan_is_never_taken_for_one_of_the_other": "a plan that tunes needs links",
    "test_writing_replaces_a_file_that_is_being_read": "it is refused there, after a while",
}


def is_ours() -> bool:
    """Whether PhysHDR's own code calls, maybe over the standard library."""
    frame = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(INSTALLED) or not name.startswith(LIBRARY):
            return name.startswith(OURS)
        frame = frame.f_back
    return False


def refused(code: int, path: object, winerror: int) -> OSError:
    error = OSError(code, os.strerror(code), str(path))
    vars(error)["winerror"] = winerror  # what Windows' own errors have, for who looks at it
    return error


def fault_of(name: str) -> str:
    """Why a file cannot have that name; "" if it can."""
    if wrong := sorted(FORBIDDEN & set(name)):
        return f"has {''.join(wrong)!r}"
    if name not in (".", "..") and name[-1:] in (".", " "):
        return "ends with a dot or a blank"
    return "is a device" if name.split(".")[0].strip().upper() in RESERVED else ""


def held_by() -> Iterator[tuple[Path, int, int]]:
    """What this process and its children have open or mapped: the path, the device and the number of each."""
    me = os.getpid()
    children = []
    for task in Path(f"/proc/{me}/task").iterdir():
        with suppress(OSError):
            children += (task / "children").read_text(encoding="ascii").split()
    for pid in (me, *children):
        with suppress(OSError):
            for link in os.scandir(f"/proc/{pid}/fd"):
                with suppress(OSError):
                    found = os.stat(link.path)
                    if stat.S_ISREG(found.st_mode):
                        yield Path(os.readlink(link.path)), found.st_dev, found.st_ino
            for line in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines():
                parts = line.split(maxsplit=5)
                if len(parts) == 6 and parts[5].startswith("/"):
                    path = Path(parts[5])
                    with suppress(OSError):
                        found = path.stat()
                        if found.st_ino == int(parts[4]):
                            yield path, found.st_dev, found.st_ino


def refuse_if_held(path: Any) -> None:
    """As Windows does if a file, or one within a folder, is open or read-only."""
    try:
        found = os.lstat(path)
    except OSError:
        return
    if stat.S_ISREG(found.st_mode):
        if not found.st_mode & stat.S_IWUSR:
            raise refused(errno.EACCES, path, 5)
        if any((device, number) == (found.st_dev, found.st_ino) for _, device, number in held_by()):
            raise refused(errno.EACCES, path, 32)
    elif stat.S_ISDIR(found.st_mode):
        whole = Path(os.fspath(path)).resolve()
        if any(each.is_relative_to(whole) for each, _, _ in held_by()) or Path.cwd().is_relative_to(whole):
            raise refused(errno.EACCES, path, 32)


def refuse_name(path: Any) -> None:
    if isinstance(path, int):
        return
    path = os.path.normpath(os.fsdecode(path))
    if path.startswith(("/proc/", "/sys/", "/dev/")):
        return
    for name in path.split(os.sep):
        if fault := fault_of(name):
            raise refused(errno.EINVAL, f"{path}: {name!r} {fault}", 123)


class Faked:
    """The functions of ``os`` and ``open`` in whose place there are others; ``close`` puts them back."""

    def __init__(self) -> None:
        self._former: list[tuple[Any, str, Any]] = []
        for name in ("replace", "rename"):
            self._wrap(os, name, getattr(self, f"_{name}"))
        for name in ("unlink", "remove"):
            self._wrap(os, name, self._unlink)
        self._wrap(os, "mkdir", self._mkdir)
        for name in ("symlink", "link"):
            self._wrap(os, name, getattr(self, f"_{name}"))
        self._wrap(os, "open", self._open)
        self._wrap(os, "fsync", self._fsync)
        self._wrap(io, "open", self._open_file)
        self._put(builtins, "open", io.open)
        # By the paths of what it removes, as on Windows.
        self._put(shutil, "_use_fd_functions", False)
        self._put(filelock.FileLock, "_release", self._released(filelock.FileLock._release))

    def close(self) -> None:
        for where, name, former in reversed(self._former):
            setattr(where, name, former)

    def _put(self, where: Any, name: str, now: Any) -> None:
        self._former.append((where, name, getattr(where, name)))
        setattr(where, name, now)

    def _wrap(self, where: Any, name: str, refuse: Callable[..., None]) -> None:
        former = getattr(where, name)

        def faked(*words: Any, **options: Any) -> Any:
            if is_ours():
                refuse(*words, **options)
            return former(*words, **options)

        self._put(where, name, faked)

    @staticmethod
    def _released(former: Callable[[Any], None]) -> Callable[[Any], None]:
        """The library removes a lock's file there as soon as it is closed."""

        def released(lock: Any) -> None:
            former(lock)
            if not any(path == Path(lock.lock_file) for path, _, _ in held_by()):
                Path(lock.lock_file).unlink(missing_ok=True)

        return released

    def _replace(self, source: Any, target: Any, **_: Any) -> None:
        refuse_name(target)
        if os.path.isdir(target):
            raise refused(errno.EACCES, target, 5)
        refuse_if_held(source)
        refuse_if_held(target)

    def _rename(self, source: Any, target: Any, **_: Any) -> None:
        refuse_name(target)
        if os.path.lexists(target) and not os.path.samefile(source, target):
            raise refused(errno.EEXIST, target, 183)
        refuse_if_held(source)

    def _unlink(self, path: Any, **_: Any) -> None:
        refuse_if_held(path)

    def _mkdir(self, path: Any, *_: Any, **__: Any) -> None:
        refuse_name(path)

    def _symlink(self, source: Any, target: Any, *_: Any, **__: Any) -> None:
        raise refused(errno.EINVAL, target, 1314)

    def _link(self, source: Any, target: Any, **_: Any) -> None:
        refuse_name(target)

    def _open(self, path: Any, flags: int, *_: Any, **__: Any) -> None:
        if os.path.isdir(path) and flags & os.O_TMPFILE != os.O_TMPFILE:  # tempfile's own way, on Linux
            raise refused(errno.EACCES, path, 5)
        if flags & os.O_CREAT:
            refuse_name(path)

    def _open_file(self, path: Any, mode: str = "r", *words: Any, **options: Any) -> None:
        if isinstance(path, int):
            return
        if os.path.isdir(path) and not options.get("opener"):
            raise refused(errno.EACCES, path, 5)
        if set(mode) & set("wax+"):
            refuse_name(path)
        if "b" not in mode and (words[1:2] or (options.get("encoding"),))[0] is None:
            raise AssertionError(f"{path} is opened as text without an encoding: it would be cp1252")

    def _fsync(self, descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise refused(errno.EBADF, descriptor, 6)


def faults_in(folder: Path) -> list[str]:
    """Names of files and folders in ``folder`` that Windows could not have."""
    found = []
    for place, folders, files in os.walk(folder):
        seen: dict[str, str] = {}
        for name in sorted((*folders, *files)):
            if fault := fault_of(name):
                found.append(f"{Path(place) / name} {fault}")
            if (other := seen.setdefault(name.casefold(), name)) != name:
                found.append(f"{Path(place) / name} is {other} there")
    return found


class Plugin:
    """What ``conftest.py`` registers for ``--as-on-windows``."""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            if why := OTHERWISE.get(item.name.partition("[")[0]):
                item.add_marker(pytest.mark.skip(reason=why))

    def pytest_sessionstart(self) -> None:
        self._faked = Faked()

    def pytest_sessionfinish(self) -> None:
        self._faked.close()

    @pytest.fixture(autouse=True)
    def names_as_on_windows(self, request: pytest.FixtureRequest) -> Iterator[None]:
        folder = request.getfixturevalue("tmp_path") if "tmp_path" in request.fixturenames else None
        yield
        if folder is not None and (faults := faults_in(folder)):
            pytest.fail("\n".join(faults))
