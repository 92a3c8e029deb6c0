# SPDX-License-Identifier: GPL-3.0-or-later
"""The files in a run's folder: whether it holds a run or other files, and removing a replaced run."""

import json
import os
import re
from contextlib import suppress
from pathlib import Path

from ...bridge.atomic import patiently, remove_leftovers, temporary_name
from ...bridge.errors import DataMismatchError, OutputError
from ...bridge.run_folder import CHECKPOINT_FILE, VIEWS_FILE, WEB_FOLDER
from ..evaluate import report
from ..evaluate.confidence import CALIBRATION_FILES
from ..export import FILES as EXPORTED
from ..export.web_page import remove_web_page
from ..train.config import CONFIG_FILE

#: Names of files that the safetensors library is still writing.
UNFINISHED = re.compile(r"\.tmp[A-Za-z0-9]{6}")


def refuse_a_run(folder: Path) -> None:
    """Raises ``DataMismatchError`` if the folder holds a run already."""
    if (folder / CHECKPOINT_FILE).exists():
        raise DataMismatchError(
            f"{folder} already holds a run",
            "Go on with it by --resume, replace it by --overwrite, or choose another --out.",
        )


def holds_a_run(folder: Path) -> bool:
    """Whether a training wrote the folder's configuration, complete or not.

    Raises ``DataMismatchError`` if a file of other origin has the name of one that would be written.
    """
    path = folder / CONFIG_FILE
    if not path.exists():
        if (folder / CHECKPOINT_FILE).exists():
            raise DataMismatchError(
                f"{folder / CHECKPOINT_FILE} has no configuration and would be replaced",
                "Choose another --out, or move that file away.",
            )
        return False
    content = None
    with suppress(OSError, ValueError, RecursionError):
        if path.is_file():
            content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or not {"config", "data", "preset"} <= content.keys():
        raise DataMismatchError(
            f"{path} is not a run's configuration and would be replaced",
            "Choose another --out, or move that file away.",
        )
    return True


def remove_results(folder: Path) -> None:
    """Remove the files of a replaced run: weights, figures, exports, its page, unfinished files.

    They would be taken for the new run's. The caller has locked the folder, which must hold a run: elsewhere,
    files of these names are the user's own. Raises ``OutputError``.
    """
    for name in (
        CHECKPOINT_FILE,
        VIEWS_FILE,
        *report.FILES,
        *CALIBRATION_FILES,
        *EXPORTED,
    ):  # the weights first, because all else was made from them
        try:
            (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot remove {folder / name}: {error.strerror or error}",
                "Close the program that has it open, or choose another --out.",
            ) from error
    remove_web_page(folder / WEB_FOLDER)
    remove_unfinished(folder)


def remove_unfinished(folder: Path) -> None:
    """Remove unfinished files of killed trainings; the caller has locked the folder."""
    for name in (CONFIG_FILE, CHECKPOINT_FILE, VIEWS_FILE):
        remove_leftovers(folder / name)
    for path in folder.iterdir():
        if UNFINISHED.fullmatch(path.name) and path.is_file():
            with suppress(OSError):  # harmless
                path.unlink()


def writable_folder(path: Path) -> Path:
    """Make the folder and check that files can be created in it; raises ``OutputError``."""
    remedy = "Choose another --out, or make it writable."
    try:
        path.mkdir(parents=True, exist_ok=True)
        # Not by tempfile: on Windows it tries two billion names where permissions refuse every one
        # (github.com/python/cpython/issues/66305).
        probe = temporary_name(path / "write-probe")
        probe.write_bytes(b"")
        patiently(probe.unlink)
    except OSError as error:
        raise OutputError(f"cannot write to {path}: {error.strerror or error}", remedy) from error
    if not os.access(path, os.W_OK):  # root may write anywhere, whatever the permissions say
        raise OutputError(f"cannot write to {path}: it is read-only", remedy)
    return path
