# SPDX-License-Identifier: GPL-3.0-or-later
"""More processes for one data set: each renders pictures that nobody else has claimed (``bridge.lock``).

Small pictures keep only part of a processor busy (synchronising the scene and denoising are partly serial),
so one process for each core is faster than one with all of them; lab/performance.md has the figures.
"""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..bridge.cores import usable_cores
from . import scripts
from .errors import OptionError
from .options import CURRENT
from .progress import Report

SCRIPT = Path(__file__).resolve().parent / "make_scene.py"
#: Seconds that a worker has to give up when it is asked to end.
PATIENCE = 10.0


def threads_each(workers: int) -> int:
    """Threads for each of ``workers`` processes on this machine."""
    return max(1, usable_cores() // workers)


@contextmanager
def helping(count: int, arguments: Sequence[str], from_file: str | None) -> Iterator[None]:
    """``count`` more processes with the same ``arguments`` work beside us until the context ends.

    They only render; this process writes everything else. One that fails leaves its picture to the others.

    Raises:
        OptionError: the scene is open and was never saved, so that another process cannot open it.
    """
    if count and from_file == CURRENT and (not bpy.data.filepath or bpy.data.is_dirty):
        raise OptionError("--workers: save the file first, the other processes must open it")
    command = _command(from_file) if count else []
    started = [
        subprocess.Popen(
            [*command, *arguments, "--worker-of", str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for process in started:
            process.terminate()
        for process in started:
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _command(from_file: str | None) -> list[str]:
    """How this very Blender is started again on our script, up to the script's own arguments."""
    if not bpy.app.binary_path:  # the wheel: Python itself
        return [sys.executable, str(SCRIPT), "--"]
    opened = [bpy.data.filepath] if from_file == CURRENT else []
    return [bpy.app.binary_path, "--background", scripts.switch(), *opened, "--python", str(SCRIPT), "--"]


class WorkerReport(Report):
    """Says nothing: the process that started the worker does. Ends the worker when that one is gone.

    Raises:
        KeyboardInterrupt: at the next picture after the parent has died.
    """

    def __init__(self, parent: int) -> None:
        super().__init__()
        self.parent = parent

    def say(self, line: str) -> None:
        """Nothing."""

    def start(self, name: str) -> None:
        if os.name != "nt" and os.getppid() != self.parent:
            raise KeyboardInterrupt
