# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting and killing other programs, on every system that Blender runs on. No bpy."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

#: What a child would inherit of Blender's Python, and what would break another one.
FOREIGN_VARIABLES = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "PYTHONUSERBASE", "VIRTUAL_ENV")

#: Of Windows' kernel32: the right to wait for a process, the error of one that is another user's, and what
#: waiting says of one that runs.
SYNCHRONIZE, ERROR_ACCESS_DENIED, WAIT_TIMEOUT = 0x00100000, 5, 0x102
#: What Windows' taskkill ends with where there is no such process.
NO_SUCH_PROCESS = 128


def clean_environment(**extra: str) -> dict[str, str]:
    """This process's environment without what belongs to its own Python.

    What a child tells is UTF-8, as ``spawn`` reads it, and whatever a path's name is, telling it never fails:
    on Windows a Python would write the system's code page into a pipe, which lacks most letters.
    """
    kept = {key: value for key, value in os.environ.items() if key not in FOREIGN_VARIABLES}
    ours = {"PYTHONNOUSERSITE": "1", "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8:backslashreplace"}
    return {**kept, **ours, **extra}


def spawn(
    command: list[str],
    output: int | IO[Any],
    environment: dict[str, str],
    stdin: int = subprocess.DEVNULL,
) -> "subprocess.Popen[str]":
    """Start a program in a process group of its own, so that CTRL-C in Blender's terminal is not its concern.

    Its stdout and stderr go to ``output``. Raises ``OSError``.
    """
    group: dict[str, Any] = {"start_new_session": True} if os.name != "nt" else {}
    return subprocess.Popen(
        command,
        stdin=stdin,
        stdout=output,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        errors="replace",
        env=environment,
        **group,
        **unseen(),
    )


def unseen() -> dict[str, Any]:
    """For ``subprocess``: on Windows a child has a console of its own that nobody sees, beside Blender's."""
    if sys.platform == "win32":  # written out here and below, for pyright to see
        return {"creationflags": subprocess.CREATE_NO_WINDOW}
    return {}


def open_log(path: Path, mode: str) -> IO[str]:
    """A log for its owner alone (0600), whether it is made now or was there; raises ``OSError``."""

    def opened(name: str, flags: int) -> int:
        # The mode is given at creation: there is no moment at which others could open it.
        return os.open(name, flags, 0o600)

    file = open(path, mode, encoding="utf-8", errors="replace", opener=opened)  # noqa: SIM115 (the caller's)
    with suppress(OSError):  # a disk without modes
        path.chmod(0o600)
    return file


def kill(pid: int) -> None:
    """End a program at once, and its children where it leads a group of its own, as those of ``spawn`` do.

    One that is gone already is no error. Raises ``OSError`` where the system refuses.
    """
    if sys.platform == "win32":
        _kill_on_windows(pid)
        return
    with suppress(ProcessLookupError):
        # What a user's shell started may be in the group of that shell, or of Blender.
        if os.getpgid(pid) == pid:
            os.killpg(pid, signal.SIGKILL)
        else:
            os.kill(pid, signal.SIGKILL)


def ask_to_end(pid: int) -> None:
    """Let a program end in its own way, by SIGTERM: a backend saves. On Windows nothing asks: it is ended.

    Errors as ``kill``.
    """
    if sys.platform == "win32":
        _kill_on_windows(pid)
        return
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGTERM)


def _kill_on_windows(pid: int) -> None:
    command = ["taskkill", "/PID", str(pid), "/T", "/F"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False, **unseen())
    if done.returncode not in (0, NO_SUCH_PROCESS):
        raise OSError(done.stderr.strip() or f"taskkill ended with status {done.returncode}")


def is_alive(pid: int) -> bool:
    """Whether there is such a process (of anybody's; it may be another program by now)."""
    if sys.platform == "win32":
        return _is_alive_on_windows(pid)
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (ProcessLookupError, OverflowError):
        return False
    return True


def _is_alive_on_windows(pid: int) -> bool:
    """By the process's handle, which costs nothing: ``os.kill`` would end it whatever the signal."""
    import ctypes
    from ctypes import wintypes

    kernel = ctypes.WinDLL("kernel32", use_last_error=True)  # pyright: ignore[reportAttributeAccessIssue]
    kernel.OpenProcess.argtypes = (wintypes.DWORD, wintypes.BOOL, wintypes.DWORD)
    kernel.OpenProcess.restype = wintypes.HANDLE
    kernel.WaitForSingleObject.argtypes = (wintypes.HANDLE, wintypes.DWORD)
    kernel.WaitForSingleObject.restype = wintypes.DWORD
    kernel.CloseHandle.argtypes = (wintypes.HANDLE,)
    handle = kernel.OpenProcess(SYNCHRONIZE, False, pid)
    if not handle:
        error = ctypes.get_last_error()  # pyright: ignore[reportAttributeAccessIssue]
        return error == ERROR_ACCESS_DENIED
    try:
        # Whoever holds a handle keeps what is left of a process that has ended: that it can be opened is not
        # enough.
        return kernel.WaitForSingleObject(handle, 0) == WAIT_TIMEOUT
    finally:
        kernel.CloseHandle(handle)
