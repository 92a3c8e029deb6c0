# SPDX-License-Identifier: GPL-3.0-or-later
"""``lights.json`` of a capture: which pictures were taken under other light, and at which level of each lamp.

A *group* is a set of pictures taken under one light: the pendant off, the daylight of the evening. Pictures
of no group are the standard. A level is a factor on what one light causes, 1 as it is photographed: 0 is off;
``null`` is a level that nobody measured, which training finds. A lamp that was on in its group alone is at 0
in ``standard``. docs/formats.md specifies the file.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Any

from .atomic import atomic_path
from .errors import BadValueError, DataMismatchError
from .lights import AMBIENT, check_lights
from .limits import check_level, is_number
from .regular import read_json_object

FILE, FORMAT, VERSION = "lights.json", "physhdr-lights", 1
REMEDY = "Fix lights.json, or remove it: then all pictures are of one light."


@dataclass(frozen=True)
class LightGroup:
    """Pictures under one light. ``levels`` by light, None where unknown; others are as in the standard.

    ``pictures``: names of poses, or of pictures with or without suffix, relative to the folder of pictures;
    ``*`` and ``?`` stand for any letters (``evening/*``).
    """

    name: str
    levels: Mapping[str, float | None]
    pictures: tuple[str, ...]

    def has(self, *names: str) -> bool:
        """Whether a picture that goes by any of ``names`` belongs to the group."""
        patterns = [pattern.replace("[", "[[]") for pattern in self.pictures]
        return any(fnmatchcase(name, pattern) for pattern in patterns for name in names)


@dataclass(frozen=True)
class LightGroups:
    """All that ``lights.json`` says. ``lights``: in the order of a trained model's levels.

    ``standard``: levels of the pictures of no group, by light; those not named are at 1.
    """

    lights: tuple[str, ...]
    groups: tuple[LightGroup, ...]
    standard: Mapping[str, float] = field(default_factory=dict)

    @property
    def standard_levels(self) -> tuple[float, ...]:
        """One for each of ``lights``."""
        return tuple(self.standard.get(light, 1.0) for light in self.lights)

    def levels(self, group: LightGroup) -> tuple[float | None, ...]:
        """One for each of ``lights``; None where training finds it."""
        return tuple(group.levels.get(light, self.standard.get(light, 1.0)) for light in self.lights)

    def of_pictures(self, pictures: Mapping[str, Sequence[str]]) -> "LightGroups | None":
        """The same with ``pictures`` by group, without groups that have none and lights that only they name.

        None where no group is left.
        """
        groups = tuple(
            replace(group, pictures=tuple(sorted(pictures[group.name])))
            for group in self.groups
            if pictures.get(group.name)
        )
        if not groups:
            return None
        named = {AMBIENT, *(light for group in groups for light in group.levels)}
        lights = tuple(light for light in self.lights if light in named)
        return LightGroups(lights, groups, {k: v for k, v in self.standard.items() if k in named})

    def group_of(self, pose: str, pictures: Iterable[str] = ()) -> LightGroup | None:
        """The group of a pose, which may go by its pictures' names too; None: the standard.

        Raises ``DataMismatchError`` where it is in several.
        """
        names = {
            name for given in (pose, *pictures) for name in (given, str(PurePosixPath(given).with_suffix("")))
        }
        found = [group for group in self.groups if group.has(*names)]
        if len(found) > 1:
            raise DataMismatchError(
                f"{FILE}: the picture '{pose:.80}' is in two groups, '{found[0].name}' and '{found[1].name}'",
                "Name it in one of them.",
            )
        return found[0] if found else None


def read_light_groups(root: Path) -> LightGroups | None:
    """What the ``lights.json`` in ``root`` says; None where there is none.

    Raises ``FileDamagedError`` and ``BadValueError``, each naming the file, the entry and the remedy.
    """
    path = root / FILE
    if not path.exists():
        return None
    content = read_json_object(path, REMEDY)
    if (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise BadValueError(f"{path} is not of the format {FORMAT}, version {VERSION}", REMEDY)
    return groups_of(content, path)


def groups_of(content: Mapping[str, Any], path: Path) -> LightGroups:
    """The groups that ``content`` of the file at ``path`` states; raises ``BadValueError``."""
    lights = check_lights(content.get("lights"), str(path))
    standard = {
        name: _known(value, f"{path}: standard: {name}")
        for name, value in _levels(content, "standard", path, lights)
    }
    entries = content.get("groups")
    if not isinstance(entries, list) or not entries:
        raise BadValueError(f"{path}: 'groups' must be a list of at least one group", REMEDY)
    groups = tuple(_group(entry, path, lights) for entry in entries)
    twice = next(
        (group.name for group in groups if sum(group.name == other.name for other in groups) > 1), None
    )
    if twice is not None:
        raise BadValueError(f"{path}: two groups are named '{twice:.80}'", "Rename one of them.")
    return LightGroups(lights, groups, standard)


def write_light_groups(root: Path, groups: LightGroups) -> None:
    """Write ``lights.json`` into ``root``; raises ``OutputError``."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "lights": list(groups.lights),
        "standard": dict(groups.standard),
        "groups": [
            {"name": group.name, "levels": dict(group.levels), "pictures": list(group.pictures)}
            for group in groups.groups
        ],
    }
    with atomic_path(root / FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _group(entry: Any, path: Path, lights: Sequence[str]) -> LightGroup:
    name = entry.get("name") if isinstance(entry, dict) else None
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise BadValueError(f"{path}: a group has no name: {entry!r:.80}", REMEDY)
    where = f"{path}: group '{name:.80}'"
    levels = {
        light: None if value is None else _known(value, f"{where}: {light}")
        for light, value in _levels(entry, "levels", path, lights)
    }
    if not levels:
        raise BadValueError(f"{where} names no light", 'Give it levels, as {"pendant": 0}.')
    pictures = entry.get("pictures")
    if not isinstance(pictures, list) or not pictures or not all(isinstance(each, str) for each in pictures):
        raise BadValueError(f"{where}: 'pictures' must be a list of names", 'Write ["evening/*"] and so on.')
    return LightGroup(name, levels, tuple(pictures))


def _levels(entry: Mapping[str, Any], key: str, path: Path, lights: Sequence[str]) -> list[tuple[str, Any]]:
    named = entry.get(key, {})
    if not isinstance(named, dict):
        raise BadValueError(f"{path}: '{key}' is {named!r:.80}, not an object", 'Write it as {"pendant": 0}.')
    unknown = next((light for light in named if light not in lights), None)
    if unknown is not None:
        raise BadValueError(
            f"{path}: there is no light {unknown!r:.80}", f"'lights' has: {', '.join(lights)}."
        )
    return list(named.items())


def _known(value: Any, whose: str) -> float:
    if not is_number(value) or value < 0:
        raise BadValueError(
            f"{whose} has the level {value!r:.80}", "Give 0 or more, or null where it is unknown."
        )
    check_level(float(value), whose)
    return float(value)
