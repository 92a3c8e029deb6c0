# SPDX-License-Identifier: GPL-3.0-or-later
"""Which poses of a capture were taken under other light, by the ``lights.json`` beside them.

Some poses of each group are for testing, as of the standard ones; nothing is ever trained from those.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...bridge.errors import DataMismatchError
from ...bridge.layouts.picture_files import split_named
from ...bridge.light_groups import FILE, LightGroup, LightGroups, read_light_groups
from ...bridge.lights import AMBIENT
from .held_out_views import EVERY
from .poses import Pose, split_somehow


@dataclass(frozen=True)
class Lighting:
    """Poses by their light. ``standard``: those of no group. ``train``, ``test``: of the groups.

    ``lights``: names of those whose levels differ, in the order of each pose's ``lighting_levels``.
    """

    standard: list[Pose]
    train: list[Pose]
    test: list[Pose]
    lights: tuple[str, ...] = (AMBIENT,)
    messages: tuple[str, ...] = ()


#: Where no file groups poses.
NO_OTHER_LIGHT = Lighting([], [], [])


def by_light(
    root: Path, folders: Sequence[Path], poses: Sequence[Pose], stated: LightGroups | None = None
) -> Lighting:
    """``poses`` as the ``lights.json`` in ``root``, else ``stated``, groups them; else all are standard.

    ``folders``: those that names of pictures may be relative to. Of each group those are for testing
    whose names say so, else as of all poses (``split_somehow``), but of fewer than ``EVERY`` none. Raises
    what ``read_light_groups`` raises, and ``DataMismatchError`` where a pose is in two groups, or all are.
    """
    groups = read_light_groups(root) or stated
    if groups is None:
        return Lighting(list(poses), [], [])
    groups = _with_unit(groups)
    standard: list[Pose] = []
    found: dict[str, list[Pose]] = {group.name: [] for group in groups.groups}
    for pose in poses:
        group = groups.group_of(pose.name, _names(pose, folders))
        lit = _under(pose, group, groups)
        (standard if group is None else found[group.name]).append(lit)
    if not standard:
        raise DataMismatchError(
            f"{root / FILE}: all pictures are in groups of other light, none is of the standard one",
            "Leave the pictures of the usual light out of all groups.",
        )
    train, test, messages = [], [], []
    for name, members in found.items():
        if not members:
            messages.append(f"{FILE}: no pose is of the group '{name}': its light is unknown")
            continue
        mine, held_out = _divided(members)
        train += mine
        test += held_out
        testing = f", {len(held_out)} of them for testing" if held_out else ""
        messages.append(f"'{name}': {len(members)} poses under other light{testing}")
    return Lighting(standard, _numbered(train), _numbered(test), groups.lights, tuple(messages))


def _with_unit(groups: LightGroups) -> LightGroups:
    """The same, with level 1 in one group for a light that is off in the standard and unknown elsewhere.

    Nothing else says what its level 1 is.
    """
    for light, level in groups.standard.items():
        named = [group for group in groups.groups if light in group.levels]
        if level > 0.0 or any(group.levels[light] for group in named):
            continue
        first = next((group for group in named if group.levels[light] is None), None)
        if first is not None:
            unit = replace(first, levels={**first.levels, light: 1.0})
            each = tuple(unit if group is first else group for group in groups.groups)
            groups = replace(groups, groups=each)
    return groups


def _names(pose: Pose, folders: Sequence[Path]) -> list[str]:
    """What a pose's pictures are called, from each of ``folders`` on."""
    each = [(picture.path, folder) for picture in pose.pictures.values() for folder in folders]
    return [path.relative_to(folder).as_posix() for path, folder in each if path.is_relative_to(folder)]


def _under(pose: Pose, group: LightGroup | None, groups: LightGroups) -> Pose:
    standard = groups.standard_levels
    levels = standard if group is None else groups.levels(group)
    name = "" if group is None else group.name
    return replace(pose, lighting_levels=levels, standard_levels=standard, group=name)


def _divided(poses: Sequence[Pose]) -> tuple[list[Pose], list[Pose]]:
    """Training and test poses of one group."""
    said = [split_named(pose.name) for pose in poses]
    if None not in said:
        return (
            [pose for pose, its in zip(poses, said, strict=True) if its == "train"],
            [pose for pose, its in zip(poses, said, strict=True) if its == "test"],
        )
    if len(poses) < EVERY:  # each place of a lamp counts
        return list(poses), []
    train, test, _ = split_somehow(poses)
    return train, test


def _numbered(poses: Sequence[Pose]) -> list[Pose]:
    """Poses by their own numbers, or by their order where two have the same: groups may count anew."""
    if len({pose.index for pose in poses}) == len(poses):
        return list(poses)
    return [replace(pose, index=order) for order, pose in enumerate(poses)]
