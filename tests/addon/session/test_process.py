# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of Windows about processes, of a Windows that only answers."""

import ctypes
import os
import sys
from ctypes import wintypes
from types import SimpleNamespace

import pytest

from physhdr.addon.session import process

RUNS, ENDED, OTHERS, NONE = 8, 12, 16, 20


class Function:
    """One of a library's: what it was told of its arguments and result is kept, as ctypes does."""

    def __init__(self, answer) -> None:
        self.answer, self.argtypes, self.restype = answer, None, ctypes.c_int

    def __call__(self, *words):
        assert self.argtypes is not None and len(words) == len(self.argtypes)
        return self.answer(*words)


@pytest.fixture
def windows(monkeypatch):
    """kernel32, in which handles do not fit into an int; ``closed``: those that were given back."""
    closed, error = [], [0]

    def opened(right, inherited, pid):
        assert right == 0x00100000 and not inherited
        error[0] = {OTHERS: 5, NONE: 87}.get(pid, 0)
        return None if error[0] else (1 << 40) + pid

    kernel = SimpleNamespace(
        OpenProcess=Function(opened),
        WaitForSingleObject=Function(lambda handle, wait: 0x102 if handle == (1 << 40) + RUNS else 0),
        CloseHandle=Function(lambda handle: closed.append(handle) or 1),
        closed=closed,
    )
    monkeypatch.setattr(ctypes, "WinDLL", lambda name, use_last_error: kernel, raising=False)
    monkeypatch.setattr(ctypes, "get_last_error", lambda: error[0], raising=False)
    monkeypatch.setattr(process, "sys", SimpleNamespace(platform="win32"))
    monkeypatch.setattr(os, "kill", lambda *words: pytest.fail("os.kill ends a process there"))
    return kernel


def test_a_process_is_asked_for_by_its_handle_which_is_given_back(windows):
    assert process.is_alive(RUNS) and not process.is_alive(ENDED)
    assert windows.closed == [(1 << 40) + RUNS, (1 << 40) + ENDED]
    assert windows.OpenProcess.restype is wintypes.HANDLE  # else it would be cut to 32 bits
    assert windows.WaitForSingleObject.argtypes[0] is windows.CloseHandle.argtypes[0] is wintypes.HANDLE


def test_another_users_process_lives_and_none_does_not(windows):
    assert process.is_alive(OTHERS) and not process.is_alive(NONE) and not windows.closed


def test_no_window_comes_up_beside_blender(monkeypatch):
    if sys.platform != "win32":
        assert process.unseen() == {}
    monkeypatch.setattr(process.subprocess, "CREATE_NO_WINDOW", 0x08000000, raising=False)
    monkeypatch.setattr(process, "sys", SimpleNamespace(platform="win32"))
    assert process.unseen() == {"creationflags": 0x08000000}
