# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of photos under other light than the rest: what ``--light`` names, and what names itself so.

A folder is one group of ``lights.json``: ``pendant off/``, or ``--light pendant=FOLDER:off``.
"""

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ....bridge.errors import BadValueError, DataMismatchError, FileMissingError
from ....bridge.light_groups import LightGroup, LightGroups
from ....bridge.light_words import WORDS, LightChange, changes_in_name, light_change
from ....bridge.lights import AMBIENT, check_lights
from ....bridge.regular import resolved
from .photos import MASKS, holds_photos

#: ``--light none``: folders whose names alone say a light are not used.
NONE = "none"
FORM = "Write --light pendant=FOLDER:off, or give a folder that is called so: 'pendant off'."


@dataclass(frozen=True)
class LightFolder:
    """A folder of photos, and which lights differ there from the other photos.

    ``is_named``: its name alone says so, no option does.
    """

    folder: Path
    changes: tuple[LightChange, ...]
    is_named: bool = False

    @property
    def name(self) -> str:
        """The group's: ``pendant off``, ``pendant off + daylight evening``."""
        return " + ".join(map(str, self.changes))


def light_folders(photos: Path, options: Sequence[str]) -> list[LightFolder]:
    """The folders that ``--light`` names, then those in or beside ``photos`` whose names say a light.

    Raises ``BadValueError`` for options that say nothing or contradict each other, ``FileMissingError`` for
    a folder that does not exist, ``DataMismatchError`` for two of one light.
    """
    found = _asked(photos, [option for option in options if option != NONE])
    if NONE not in options:
        asked = {resolved(each.folder) for each in found}
        for folder in _around(photos):
            changes = changes_in_name(folder.name)
            if changes and resolved(folder) not in asked and holds_photos(folder):
                found.append(LightFolder(folder, changes, is_named=True))
    found = _in_one_spelling(found)
    _require_distinct(found)
    groups_of(found)  # raises where lights contradict each other
    return found


def ignored_folders(photos: Path, used: Collection[LightFolder]) -> list[str]:
    """The names of the folders in ``photos`` that hold photos and are not used."""
    ours = {resolved(each.folder) for each in used}
    return [path.name for path in _inside(photos) if resolved(path) not in ours and holds_photos(path)]


def groups_of(folders: Sequence[LightFolder]) -> LightGroups:
    """What ``lights.json`` says of ``folders``, but for the pictures, whose names are not known yet.

    The first light is the ambient one: all that no folder names. Raises ``BadValueError`` where a group is
    under the same light as the photos of no group.
    """
    changes = [change for each in folders for change in each.changes]
    lights = dict.fromkeys((AMBIENT, *(change.light for change in changes)))
    standard = {change.light: 0.0 for change in changes if change.is_alone}
    for each in folders:
        if all(change.level == standard.get(change.light, 1.0) for change in each.changes):
            _refuse_standard(each, [change.light for change in changes if change.is_alone])
    groups = tuple(
        LightGroup(each.name, {change.light: change.level for change in each.changes}, ()) for each in folders
    )
    return LightGroups(tuple(lights), groups, standard)


def _refuse_standard(group: LightFolder, alone: Collection[str]) -> None:
    off = next((change.light for change in group.changes if change.light in alone), None)
    if off is None:
        why = "which is the light of the other photos, too"
        remedy = "Move these photos to the others, or say by which factor the light differs."
    else:
        why = f"but {off} is off in the other photos already, because another folder says that it is on there"
        remedy = f"Say '{off} off' if the other photos are with it, or '{off} on' if they are without it."
    raise BadValueError(f"{group.folder} says '{group.name}', {why}", remedy)


def _asked(photos: Path, options: Sequence[str]) -> list[LightFolder]:
    folders: dict[Path, tuple[Path, list[LightChange]]] = {}
    for option in options:
        folder, changes = _parsed(option)
        if not folder.is_dir():
            raise FileMissingError(f"--light {option}: the folder {folder} does not exist", FORM)
        place = resolved(folder)
        if place == resolved(photos):
            raise BadValueError(
                f"--light {option}: that is the folder of the standard light",
                "Move the photos under other light to a folder of their own.",
            )
        folders.setdefault(place, (folder, []))[1].extend(changes)
    return [LightFolder(folder, tuple(changes)) for folder, changes in folders.values()]


def _parsed(option: str) -> tuple[Path, tuple[LightChange, ...]]:
    """The folder and the lights of ``pendant=FOLDER:off``, or of a folder whose name says them."""
    light, equals, rest = option.partition("=")
    if not equals or Path(option).is_dir():
        changes = changes_in_name(Path(option).name)
        if not changes:
            raise BadValueError(
                f"--light {option}: the folder's name does not say which light", f"{FORM} {WORDS}"
            )
        return Path(option), changes
    folder, colon, word = rest.rpartition(":")
    if not colon or not folder or "/" in word or "\\" in word:
        raise BadValueError(
            f"--light {option} does not say what {light} does in the folder", f"{FORM} {WORDS}"
        )
    return Path(folder), (light_change(light, word),)


def _around(photos: Path) -> list[Path]:
    """The folders in that of the photos and beside it, by name."""
    return [
        *_inside(photos),
        *(path for path in _inside(_parent(photos)) if resolved(path) != resolved(photos)),
    ]


def _parent(folder: Path) -> Path:
    return Path(os.path.abspath(folder)).parent  # "." has no parent


def _inside(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    try:
        below = [path for path in folder.iterdir() if path.is_dir()]
    except PermissionError:  # beside the photos there may be what is not the user's
        return []
    return sorted(path for path in below if path.name != MASKS and not path.name.startswith("."))


def _in_one_spelling(folders: Sequence[LightFolder]) -> list[LightFolder]:
    """Lights whose names differ in case alone are one, as it is first written."""
    spelling: dict[str, str] = {AMBIENT: AMBIENT}
    for each in folders:
        for change in each.changes:
            spelling.setdefault(change.light.casefold(), change.light)
    return [
        replace(each, changes=tuple(LightChange(spelling[c.light.casefold()], c.word) for c in each.changes))
        for each in folders
    ]


def _require_distinct(folders: Sequence[LightFolder]) -> None:
    """Each folder says one thing of each light, and no two say the same."""
    for each in folders:
        check_lights([AMBIENT, *{change.light for change in each.changes} - {AMBIENT}], str(each.folder))
        for change in each.changes:
            other = next((o for o in each.changes if o.light == change.light and o is not change), None)
            if other is not None:
                raise BadValueError(
                    f"{each.folder} is given for '{change}' and for '{other}'",
                    "Give one word for each light of a folder, and other photos in a folder of their own.",
                )
    for number, each in enumerate(folders):
        for other in folders[:number]:
            if {*map(str, each.changes)} == {*map(str, other.changes)}:
                raise DataMismatchError(
                    f"two folders are '{each.name}': {other.folder} and {each.folder}",
                    "Put their photos into one, or, if the light differs, use another word: dim, dark.",
                )
