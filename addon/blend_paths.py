# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that lie beside the .blend (``//…``) lead where they led, in whatever folder it is saved.

Blender sees to its own paths so, and leaves those of an extension's properties as they are. It is done before
the file is written, so that they are right in it; and again after an undo, which brings back what they were.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from .blender import add_handlers, path_properties, remove_handlers
from .dataset.dataset_settings import DATASET
from .settings import SETTINGS, respelling

#: Numbers of folders are below this: what an integer of Blender's holds.
KEYS = 2**31
#: Folders that the open file has been in, "" before it was saved, each by a number drawn for it. A scene's
#: settings keep that of the folder which they are beside: one of another session, or of a file that a scene
#: was appended from, is not here.
_folders: dict[int, str] = {}
#: What was rewritten for the file that is being written: settings, a property's name, its former value.
_former: list[tuple[bpy.types.PropertyGroup, str, str]] = []


def _settle(folder: str) -> None:
    """Let the paths of all scenes be beside a .blend in ``folder``."""
    for scene in _own_scenes():
        chosen = getattr(scene, SETTINGS)
        former = _folders.get(chosen.folder_key, folder)
        if former and folder and former != folder:
            with respelling():
                for group in (chosen, *chosen.photos_lights, getattr(scene, DATASET)):
                    _rewrite(group, former, folder)
    _mark(folder)


def _mark(folder: str) -> None:
    """Note that the paths of all scenes are beside a .blend in ``folder``."""
    key = next((key for key, each in _folders.items() if each == folder), None)
    if key is None:
        key = secrets.randbelow(KEYS)
        _folders[key] = folder
    for scene in _own_scenes():
        chosen = getattr(scene, SETTINGS)
        if chosen.folder_key != key:
            chosen.folder_key = key


def _own_scenes() -> Iterator[bpy.types.Scene]:
    """All but those that are linked, whose paths are their own file's."""
    return (scene for scene in bpy.data.scenes if scene.is_editable)


def _rewrite(group: bpy.types.PropertyGroup, former: str, folder: str) -> None:
    for name, path in list(_beside(group)):
        _former.append((group, name, path))
        setattr(group, name, moved(path, former, folder))


def _beside(group: bpy.types.PropertyGroup) -> Iterator[tuple[str, str]]:
    """Names and values of the paths among some settings that are relative to the .blend."""
    for name in path_properties(group):
        path = getattr(group, name)
        if path.startswith("//"):
            yield name, path


def moved(path: str, former: str, folder: str) -> str:
    """A path beside a .blend in folder ``former``, for one in ``folder``: whole where that is on another
    drive."""
    whole = os.path.normpath(bpy.path.abspath(path, start=former))
    with suppress(ValueError):  # Windows: no way leads from one drive to another
        return f"//{os.path.relpath(whole, folder)}"
    return whole


def _folder_of(path: str) -> str:
    return str(Path(path).absolute().parent) if path else ""


@persistent
def _file_opened(*_: object) -> None:
    _folders.clear()
    _settle(_folder_of(bpy.data.filepath))


@persistent
def _before_saving(path: str, *_: object) -> None:
    _settle(_folder_of(bpy.data.filepath))
    _former.clear()
    if path:  # not the file that Blender starts with
        _settle(_folder_of(path))


@persistent
def _after_saving(path: str, *_: object) -> None:
    """Where that was a copy, or failed, the open file is where it was, and so are its paths."""
    folder = _folder_of(bpy.data.filepath)
    if path and folder != _folder_of(path):
        with respelling():
            for group, name, value in _former:
                setattr(group, name, value)
        _mark(folder)
    _former.clear()


@persistent
def _undone(*_: object) -> None:
    _settle(_folder_of(bpy.data.filepath))
    _former.clear()


_HANDLERS = (
    ("load_post", _file_opened),
    ("save_pre", _before_saving),
    ("save_post", _after_saving),
    ("save_post_fail", _after_saving),
    ("undo_post", _undone),
    ("redo_post", _undone),
)


def register() -> None:
    add_handlers(_HANDLERS)


def unregister() -> None:
    remove_handlers(_HANDLERS)
    _folders.clear()
    _former.clear()
