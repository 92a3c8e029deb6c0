# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set without its test views, for the processes of a tuning plan.

No reader, monitor or evaluation needs a rule of its own, and none can forget it.
"""

import contextlib
import os
import secrets
from pathlib import Path

from ...bridge import data_set
from ...bridge.errors import OutputError
from ...bridge.regular import resolved

#: Names in such a folder, apart from files of points: the description, and each split but the test's.
_NAMES = (
    data_set.INFO_FILE,
    *(
        name(split)
        for split in data_set.SPLITS
        if split != data_set.TEST
        for name in (data_set.transforms_file, data_set.exposure_file, str, data_set.truth_folder)
    ),
)


def names_without_test(data: Path) -> list[str]:
    """The files and folders in a data set that a tuning plan may open, sorted; opens nothing."""
    points = [path.name for path in data.glob("*.ply") if not path.name.startswith(".")]
    return sorted([*(name for name in _NAMES if (data / name).exists()), *points])


def link_without_test(data: Path, folder: Path) -> Path:
    """Link the data set ``data`` without test views into ``folder``; returns it.

    Existing links stay, so that several commands may do this at once. Raises ``OutputError``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = names_without_test(data)
        for path in folder.iterdir():
            if path.name not in names and not path.name.startswith("."):
                path.unlink(missing_ok=True)
        for name in names:
            target, link = resolved(data) / name, folder / name
            # Both resolved, because Windows spells a link's target differently.
            if not link.is_symlink() or resolved(link) != resolved(target):
                _replace(link, target)
    except OSError as error:
        raise OutputError(
            f"cannot link the data set {data} into {folder}: {error.strerror or error}",
            "A tuning plan gives its runs a folder of links without test views: choose an --out where links "
            "can be made (on Windows in Developer Mode).",
        ) from error
    return folder


def _replace(link: Path, target: Path) -> None:
    temporary = link.with_name(f".{link.name}-{secrets.token_hex(4)}")
    temporary.symlink_to(target, target_is_directory=target.is_dir())
    try:
        os.replace(temporary, link)
    finally:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
