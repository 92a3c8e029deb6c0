# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run's folder says of the data set that it was trained on: where that was, and what it looked like.

The trainer writes ``config.json`` and ``views.json`` (docs/formats.md); Blender asks here whether the data
set is still where it was, and whether another folder is the same one.
"""

from contextlib import suppress
from pathlib import Path

from .errors import PhysHDRError
from .regular import read_json_object

CONFIG_FILE = "config.json"
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


def picture_names(folder: Path) -> list[str]:
    """Names, within the data set, of pictures that the run in ``folder`` was trained on; [] where unknown."""
    with suppress(PhysHDRError, OSError):
        splits = read_json_object(folder / VIEWS_FILE).get("splits")
        views = splits.get("train") if isinstance(splits, dict) else None
        named = [view.get("pictures") for view in views or () if isinstance(view, dict)]
        return [name for names in named if isinstance(names, list) for name in names if _is_name(name)]
    return []


def may_be_of(folder: Path, data: Path) -> bool:
    """Whether ``data`` can be the data set of the run in ``folder``: its first and last pictures are there.

    True as well where the run, an earlier version's, does not say what they are called.
    """
    names = picture_names(folder)
    asked = dict.fromkeys([*names[: ASKED // 2], *names[-ASKED // 2 :]])
    try:
        return all((data / name).is_file() for name in asked)
    except (OSError, ValueError):
        return False


def _is_name(name: object) -> bool:
    return isinstance(name, str) and bool(name)
