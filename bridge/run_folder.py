# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a run's folder, and what it says of the data set that it was trained on: where that was, and
what it looked like.

The trainer writes ``config.json`` and ``views.json`` (docs/formats.md); Blender asks here whether the data
set is still where it was, and whether another folder is the same one.
"""

import os
from contextlib import suppress
from pathlib import Path

from .errors import PhysHDRError
from .regular import read_json_object

CONFIG_FILE = "config.json"
CHECKPOINT_FILE = "checkpoint.safetensors"
MODEL_FILE = "model.safetensors"
#: Beside an exported model: the cameras that it was trained from (``camera_list``).
CAMERAS_FILE = "cameras.json"
#: What an evaluation leaves there: figures for programs, the same for people, and pictures side by side.
EVALUATION_FILE, REPORT_FILE, SHEET_FILE = "evaluation.json", "evaluation.md", "comparison.png"
#: The web page of the model, where nobody says another place: one file, or the page in this folder.
WEB_FILE, WEB_FOLDER, WEB_INDEX = "web.html", "web", "index.html"
#: Cameras, exposures and lights of the data set, so that a run can be looked at without it.
VIEWS_FILE = "views.json"
VIEWS_FORMAT = "physhdr-views"
VIEWS_VERSION = 1
#: So many of the pictures' names are looked for: enough to tell one data set from another.
ASKED = 8


def data_of(folder: Path) -> Path | None:
    """The data set that the run in ``folder`` was trained on, be it there or not; None where it says none."""
    with suppress(PhysHDRError, OSError):
        data = read_json_object(folder / CONFIG_FILE).get("data")
        if isinstance(data, str) and data:
            return Path(data)
    return None


def same_folder(one: str | Path, other: str | Path) -> bool:
    """Whether two paths lead to one folder, be it there or not.

    The trainer writes a data set's own path, Blender has the one that was chosen: through a link, a mapped
    drive, or on Windows in other letters' case.
    """
    if same_spelling(one, other):
        return True
    with suppress(OSError, ValueError):
        return len({os.path.normcase(os.path.realpath(each)) for each in (one, other)}) == 1
    return False


def same_spelling(one: str | Path, other: str | Path) -> bool:
    """Whether two paths are one without a look at the disk."""
    return len({os.path.normcase(os.path.normpath(each)) for each in (one, other)}) == 1


def picture_names(folder: Path) -> list[str]:
    """Names, within the data set, of pictures that the run in ``folder`` was trained on; [] where unknown."""
    with suppress(PhysHDRError, OSError):
        splits = read_json_object(folder / VIEWS_FILE).get("splits")
        views = splits.get("train") if isinstance(splits, dict) else None
        named = [view.get("pictures") for view in views or () if isinstance(view, dict)]
        return [name for names in named if isinstance(names, list) for name in names if _is_name(name)]
    return []


def may_be_of(folder: Path, data: Path) -> bool:
    """Whether ``data`` can be the data set of the run in ``folder``: its first and last pictures exist."""
    names = picture_names(folder)
    asked = dict.fromkeys([*names[: ASKED // 2], *names[-ASKED // 2 :]])
    try:
        return all((data / name).is_file() for name in asked)
    except (OSError, ValueError):
        return False


def _is_name(name: object) -> bool:
    return isinstance(name, str) and bool(name)
