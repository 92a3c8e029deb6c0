# SPDX-License-Identifier: GPL-3.0-or-later
"""What another process has made is taken into the scene once it is there, as a step of undo of its own."""

import time
from collections.abc import Callable
from typing import Any

import bpy

from ..runtime import session

#: Seconds between looks whether a task has ended.
LOOK_SECONDS = 0.5
#: Seconds that one who is in the middle of something is waited for; some add-ons are so all the time.
MODAL_SECONDS = 20.0


def take_when_ended(task: str, take: Callable[[], bool], message: str, in_any_file: bool = False) -> None:
    """Call ``take`` once the session's ``task`` has ended; where it says that it took something, ``message``
    names the step of undo.

    ``in_any_file``: also where another file has been opened by then, since ``take`` touches none. Else
    Blender removes the timer when a file is opened; saving this one, by whatever name, changes nothing.
    """
    latest = 0.0  # when it is taken whatever one is in the middle of

    def look() -> float | None:
        nonlocal latest
        if not hasattr(bpy.types.Scene, "physhdr"):
            return None
        if session().state.task(task):
            return LOOK_SECONDS
        latest = latest or time.monotonic() + MODAL_SECONDS
        # What one is in the middle of, such as dragging, is not to be cut in two by a step of undo.
        is_busy = in_the_middle()
        if is_busy and time.monotonic() < latest:
            return LOOK_SECONDS
        if take() and not is_busy:
            push_undo(message)
        return None

    bpy.app.timers.register(look, first_interval=LOOK_SECONDS, persistent=in_any_file)


def scene_of(uid: int) -> bpy.types.Scene | None:
    """The scene of that ``session_uid``, whatever its name is by now; None where it is gone."""
    return next((each for each in bpy.data.scenes if each.session_uid == uid), None)


def in_the_middle() -> bool:
    """Whether an operator is under way in any window."""
    return any(len(each.modal_operators) for each in bpy.context.window_manager.windows)


def is_modal(operator: str) -> bool:
    """Whether an operator of this class's name is under way in any window."""
    windows = bpy.context.window_manager.windows
    return any(each.bl_idname == operator for window in windows for each in window.modal_operators)


def push_undo(message: str) -> None:
    """A step of undo: else undoing what comes next would take away what was taken into the scene."""
    windows = bpy.context.window_manager.windows
    if windows and not bpy.app.background:
        override: Any = bpy.context.temp_override(window=windows[0])  # a context manager, which stubs miss
        with override:
            bpy.ops.ed.undo_push(message=message)
