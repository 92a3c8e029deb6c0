# SPDX-License-Identifier: GPL-3.0-or-later
"""Which places outside the open .blend may be looked at: those that the user has chosen since it was opened.

A .blend may be a stranger's, and even asking whether ``\\\\server\\share`` exists sends credentials there. So
whatever follows a path of the file without a click asks here first. A place is chosen by being set in the
interface, given to an operator, or used by a button that is about it. Nothing of this is saved.
"""

import os
from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..bridge.errors import BadValueError
from .blender import path_properties
from .paths import absolute

#: The operator that chooses them (``operators.outside``).
LOOK = "physhdr.outside_look"
QUESTION = "This file names places outside it. Nothing there is read before you look"
#: Chosen places, as ``_key`` spells them; those beside a .blend that is not saved yet as they were chosen.
_chosen: set[str] = set()


def choose(path: str) -> str:
    """The user has chosen this place, or pressed a button that is about it; returns ``path``."""
    if path:
        whole = absolute(path)
        _chosen.add(_key(whole) if whole else path)
    return path


def may_look(path: str | Path) -> bool:
    """Whether the user has chosen a place (a whole path), or a folder that it is in."""
    key = _key(str(path))
    return any(key == each or key.startswith(each.rstrip(os.sep) + os.sep) for each in _chosen)


def chosen(path: str) -> str:
    """A path of the file's settings as a whole one; empty where the user has not chosen it."""
    whole = absolute(path)
    if whole and path in _chosen:  # chosen before the .blend was saved
        _chosen.discard(path)
        choose(whole)
    return whole if whole and may_look(whole) else ""


def not_chosen(*groups: bpy.types.PropertyGroup) -> tuple[str, ...]:
    """Whole paths that settings name and the user has not chosen, each once."""
    named = [
        getattr(group, name)
        for group in groups
        for name in path_properties(group)
        if not group.bl_rna.properties[name].is_hidden
    ]
    return tuple(dict.fromkeys(absolute(each) for each in named if absolute(each) and not chosen(each)))


def is_network(path: str | Path) -> bool:
    """Whether a whole path names another computer (``\\\\server\\share``)."""
    return str(path).replace("/", "\\").startswith("\\\\")


def may_follow(path: str | Path) -> bool:
    """Whether a click on something else may look at a place that a file names: not in a network by chance."""
    return not is_network(path) or may_look(path)


def followed(path: str) -> str:
    """``path``, where a click on something else leads; ``BadValueError`` where not ``may_follow``."""
    if not may_follow(path):
        remedy = "Look at it in the panel, choose another place, or leave that empty."
        raise BadValueError(f"this file names {path} on another computer, which you have not chosen", remedy)
    return path


def is_folder(path: Path) -> bool:
    """Whether there is a folder, as far as one may look."""
    return may_follow(path) and path.is_dir()


def is_file(path: Path) -> bool:
    """Whether there is a file, as far as one may look."""
    return may_follow(path) and path.is_file()


def draw(layout: bpy.types.UILayout, paths: tuple[str, ...], shown: Callable[[str], str] = str) -> None:
    """The places that are not chosen, a button for those on this computer, and one for each in a network."""
    for path in paths:
        row = layout.row(align=True)
        row.label(text=shown(path), icon="URL" if is_network(path) else "FILE_FOLDER")
        if is_network(path):
            row.operator(LOOK, text="", icon="HIDE_OFF").path = path
    if not all(map(is_network, paths)):
        layout.operator(LOOK, icon="HIDE_OFF").path = ""


def _key(path: str) -> str:
    return os.path.normcase(os.path.normpath(path))


@persistent
def _file_opened(*_: object) -> None:
    _chosen.clear()


def register() -> None:
    bpy.app.handlers.load_post.append(_file_opened)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_file_opened)
    _chosen.clear()
