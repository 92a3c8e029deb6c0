# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set without its test views: all that the processes of a plan that tunes are told of it.

So no reader, monitor or evaluation needs a rule of its own, and none can forget it.
"""

import contextlib
import os
import secrets
from pathlib import Path

from ...bridge import data_set
from ...bridge.errors import OutputError

#: All that such a folder has of a data set: its description, its points, and each split but the test's.
NAMES = (
    data_set.INFO_FILE,
    data_set.POINTS_FILE,
    *(
        name(split)
        for split in data_set.SPLITS
        if split != data_set.TEST
        for name in (data_set.transforms_file, data_set.exposure_file, str, data_set.truth_folder)
    ),
)


def link_without_test(data: Path, folder: Path) -> Path:
    """Make ``folder`` the data set ``data`` without test views, by links; returns it.

    What is linked already stays, so that several commands may do this at once. Raises ``OutputError``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in NAMES:
            target, link = data.resolve() / name, folder / name
            if not target.exists():
                link.unlink(missing_ok=True)
            elif not link.is_symlink() or Path(os.readlink(link)) != target:
                _replace(link, target)
    except OSError as error:
        raise OutputError(
            f"cannot link the data set {data} into {folder}: {error.strerror or error}",
            "A plan that tunes gives its runs a folder of links without test views: put --out where links "
            "can be made.",
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
