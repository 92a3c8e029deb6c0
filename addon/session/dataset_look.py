# SPDX-License-Identifier: GPL-3.0-or-later
"""A look at a data set's folder that Blender does not wait for. No bpy.

Each picture is opened: on a network drive that takes its time.
"""

import threading
from pathlib import Path

from ...bridge.errors import PhysHDRError
from ..layouts.summary import summarise
from .state import Dataset, Problem


class DatasetLook:
    """Looks at ``folder`` in a thread of its own, which a drive that hangs keeps and nobody else."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._found: Dataset | None = None
        self._thread = threading.Thread(target=self._look, name=f"physhdr {folder}", daemon=True)
        self._thread.start()

    def take(self, patience: float = 0.0) -> Dataset | None:
        """What is in the folder; ``None`` where that is not known after ``patience`` seconds."""
        self._thread.join(patience)
        goes_on = self._thread.is_alive()
        if self._found is None and not goes_on:  # a fault of ours
            problem = Problem(f"{self.folder} could not be looked at", "Report it, with Blender's console.")
            return Dataset(self.folder, problem=problem)
        return self._found

    def _look(self) -> None:
        self._found = looked_at(self.folder)


def looked_at(folder: str) -> Dataset:
    """What is in a data set's folder, or what is wrong with it."""
    try:
        summary = summarise(Path(folder))
    except PhysHDRError as error:
        return Dataset(folder, problem=Problem(error.message, error.hint))
    except OSError as error:  # the system will not have the path, be it too long
        problem = Problem(f"{folder}: {error.strerror or error}", "Choose another folder.")
        return Dataset(folder, problem=problem)
    return Dataset(folder, tuple(summary.lines), tuple(summary.warnings))
