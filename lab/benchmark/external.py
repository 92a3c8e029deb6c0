# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that another program made for a run of the plan: their digest and cost."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...backend.evaluate.report import FILES
from ...bridge import data_set
from ...bridge.errors import BadValueError
from ...bridge.layouts.picture_files import SUFFIXES
from ...bridge.limits import is_number
from ...bridge.regular import read_json_object
from .plan import TUNE

COST_FILE = "cost.json"
#: Its fields and those of a ``Record``: CPU seconds and wall-clock seconds of the training, peak memory.
FIELDS: dict[str, tuple[str, Callable[[float], float]]] = {
    "cpu_seconds": ("cpu_seconds", float),
    "seconds": ("seconds", float),
    "iterations": ("iterations", int),
    "gaussians": ("gaussians", int),
    "memory_MB": ("peak_memory", lambda megabytes: int(1e6 * megabytes)),
}
REMEDY = "Each is a number, 0 or more, and any may be missing (lab/compare.md)."


def read_cost(folder: Path) -> dict[str, Any]:
    """The fields of a ``Record`` in the ``cost.json`` of a folder of pictures; {} if there is none.

    Raises ``FileDamagedError``, and ``BadValueError`` for an unknown name or invalid value.
    """
    path, fields = folder / COST_FILE, {}
    content = read_json_object(path, REMEDY) if path.exists() else {}
    for name, value in content.items():
        if name not in FIELDS:
            raise BadValueError(f"{path} has {name!r:.80}, but may say {', '.join(FIELDS)}", REMEDY)
        if value is None:
            continue
        if not is_number(value) or value < 0.0:
            raise BadValueError(f"{path}: {name} is {value!r:.80}", REMEDY)
        field, convert = FIELDS[name]
        fields[field] = convert(value)
    return fields


def pictures_digest(folder: Path, kind: str) -> str:
    """SHA-256 of every picture in the folder, its name, and ``cost.json``, without an evaluation's files.

    For a tuning plan only of the validation views: nothing else is opened.
    """
    tops = [folder]
    if kind == TUNE:
        tops = [folder / data_set.VALIDATION, folder / data_set.truth_folder(data_set.VALIDATION)]
    found = [folder / COST_FILE] if (folder / COST_FILE).is_file() else []
    for top in tops:
        for place, folders, names in os.walk(top, followlinks=True):
            folders[:] = [name for name in folders if not name.startswith(".")]
            paths = [Path(place) / name for name in names if name.lower().endswith(SUFFIXES)]
            found += [path for path in paths if not (path.parent == folder and path.name in FILES)]
    digest = hashlib.sha256()
    for path in sorted(path for path in found if path.is_file()):
        own = hashlib.sha256(path.read_bytes()).hexdigest()
        digest.update(f"{path.relative_to(folder).as_posix()}\n{own}\n".encode())
    return digest.hexdigest()
