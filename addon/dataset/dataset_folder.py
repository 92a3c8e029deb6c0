# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder that a data set of the open scene is rendered into: which is proposed, and what is in it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import bpy

from ...bridge.data_set import INFO_FILE, PARTIAL_FILE
from ...bridge.errors import BadValueError, OutputError
from .. import outside
from ..paths import first_free, user_folder, whole
from .dataset_settings import PHYSHDR_DatasetSettings

SUFFIX = "_dataset"


def propose(settings: PHYSHDR_DatasetSettings) -> None:
    """Fill in a folder where none is chosen, or where one was proposed for another file than this is now."""
    if settings.out and (settings.out != settings.proposed or settings.proposed_for == bpy.data.filepath):
        return
    settings.out = settings.proposed = proposed()
    settings.proposed_for = bpy.data.filepath


def proposed() -> str:
    """A folder that is not there yet: beside the file, else in the user's documents."""
    file = Path(bpy.data.filepath)
    if bpy.data.filepath and os.access(file.parent, os.W_OK):
        return f"//{first_free(file.parent / f'{file.stem}{SUFFIX}').name}"
    return str(first_free(_documents() / "PhysHDR" / f"{file.stem or 'untitled'}{SUFFIX}"))


def _documents() -> Path:
    """Where a user keeps things: a folder that can be written to."""
    home = Path.home()
    for folder in (home / "Documents", home):
        if folder.is_dir() and os.access(folder, os.W_OK):
            return folder
    return user_folder()


def chosen_folder(text: str) -> Path:
    """The folder that was given, from the root on; it need not be there yet.

    Raises ``BadValueError`` where none is given, or one in a network that the user has not chosen;
    ``OutputError`` where the system refuses the path: it is too long, or of a computer that does not answer.
    """
    if not text.strip():
        raise BadValueError("no folder is chosen for the data set", "Choose a new or empty one.")
    folder = Path(outside.followed(whole(text)))
    with _refusals_in_words(folder), suppress(FileNotFoundError, NotADirectoryError):
        folder.stat()
    return folder


@contextmanager
def _refusals_in_words(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{folder} cannot be opened: {error.strerror or error}", "Choose another folder."
        ) from error


def check(out: Path) -> str:
    """What becomes of a folder, in words; raises ``OutputError`` where nothing can be written there."""
    with _refusals_in_words(out):
        return _becomes(out)


def _becomes(out: Path) -> str:
    if (out / INFO_FILE).is_file():
        return "It holds a data set: what has the same settings is kept, and nothing is overwritten"
    if (out / PARTIAL_FILE).is_file():
        return "It holds a part of a data set: with the same settings the rest is rendered"
    if out.is_dir():
        if any(not name.startswith(".") for name in os.listdir(out)):
            raise OutputError(f"{out} holds files but no data set", "Choose a new or empty folder.")
        parent = out
    elif out.exists():
        raise OutputError(f"{out} is a file", "Choose a new or empty folder.")
    else:
        parent = next((each for each in out.parents if each.exists()), out.parent)
    if not os.access(parent, os.W_OK):
        raise OutputError(f"nothing can be written in {parent}", "Choose another folder.")
    return "A new folder"
