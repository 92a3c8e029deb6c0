# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast a scene renders, tried before its data set begins: two pictures of it with few samples, by another
Blender in the background. The first one also makes the scene ready; the second one tells.
"""

import shutil
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

from ...bridge.errors import BadValueError
from ..session.dataset_words import in_the_dialogs_words
from ..session.task import ChildTask, TaskEnded
from . import dataset_command, render_time

TRIAL = "time trial"
#: Samples of its pictures: a share of those that are asked for, within limits.
SHARE, FEWEST, MOST = 0.25, 4, 64
#: Poses of the trial's data set, of which the first part is rendered.
VIEWS, PART = 4, "1/2"
#: Seconds between looks whether it is done.
LOOK_SECONDS = 0.25


class TimeTrial:
    """The one trial of this Blender; nothing of it is in the file."""

    def __init__(self) -> None:
        self._task: ChildTask | None = None
        self._chosen = SimpleNamespace()
        self._scene = ""
        self._folder: Path | None = None
        #: What went wrong the last time.
        self.problem = ""

    @property
    def is_running(self) -> bool:
        return self._task is not None

    def start(
        self, command: list[str], chosen: SimpleNamespace, scene: bpy.types.Scene, folder: Path, home: Path
    ) -> None:
        """Begin. ``command``: Blender's, up to make_scene.py's own arguments; ``folder``: for the pictures.

        Raises ``PhysHDRError`` where the settings cannot be.
        """
        self.end()
        samples = max(FEWEST, min(MOST, round(SHARE * chosen.samples)))
        self._chosen = SimpleNamespace(**{**vars(chosen), "samples": samples})
        trial = SimpleNamespace(**vars(self._chosen))
        trial.out, trial.views, trial.lit_views, trial.relit_views = str(folder), VIEWS, 0, 0
        self.problem, self._scene, self._folder = "", scene.name, folder
        arguments = [*dataset_command.of(trial, scene), f"--part={PART}"]
        self._task = ChildTask(TRIAL, [*command, *arguments], home / "time_trial.log")

    def look(self) -> bool:
        """Take in what has happened; False once it is over."""
        if self._task is None:
            return False
        for event in self._task.poll():
            if isinstance(event, TaskEnded):
                self._finish(event)
                return False
        return True

    def wait(self, seconds: float) -> None:
        """For scripts: until it is over. Raises ``BadValueError`` with what went wrong."""
        end = time.monotonic() + seconds
        while self.look() and time.monotonic() < end:
            time.sleep(LOOK_SECONDS / 5.0)
        if self.is_running or self.problem:
            self.end()
            raise BadValueError(self.problem or "the time trial took too long", "Render, and see.")

    def end(self) -> None:
        """Stop it if it is under way, without waiting for it, and remove its pictures."""
        if self._task is not None:
            self._task.cancel()
        self._task = None
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._folder = None

    def forget(self) -> None:
        """Stop it, and say nothing of it any more."""
        self.end()
        self.problem = ""

    def _finish(self, ended: TaskEnded) -> None:
        self._task = None
        self.end()
        scene = bpy.data.scenes.get(self._scene)
        result: Any = ended.result.get("picture_seconds")
        match result:
            case [*seconds] if ended.ok and seconds and scene is not None:
                render_time.tried(self._chosen, scene, float(min(seconds)))
            case _:
                self.problem = in_the_dialogs_words(ended.message) or "the pictures were not rendered"


_trial = TimeTrial()


def trial() -> TimeTrial:
    return _trial


def in_words() -> str:
    """What the dialog says of it; empty where there is nothing to be said."""
    if _trial.is_running:
        return "Two pictures with few samples are being rendered to tell the time …"
    return f"The time could not be tried: {_trial.problem}" if _trial.problem else ""
