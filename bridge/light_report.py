# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights of a capture can be turned afterwards, in sentences for people."""

from collections.abc import Mapping

import numpy as np

from .light_groups import LightGroup, LightGroups
from .lights import AMBIENT
from .words import counted

#: A level that nobody measured differs from all others: any number that comes once does for that.
UNKNOWN_RATIO = 0.6180339887
#: Of a unit vector: less is rounding.
NOTHING = 1e-6


def light_report(
    groups: LightGroups, counts: Mapping[str, int], what: str = "place"
) -> tuple[list[str], list[str]]:
    """A line for each light that can be turned, and warnings.

    ``counts``: from how many places (or ``what`` is counted) each group was photographed, by its name.
    """
    apart = never_apart(groups)
    confused = {light for lights in apart for light in lights}
    lines = []
    for light in groups.lights:
        seen = [
            f"{_in_words(group.levels[light])} from {counted(counts.get(group.name, 0), what)}"
            for group in groups.groups
            if light in group.levels
        ]
        if seen and light not in confused:
            lines.append(f"{light} can be turned afterwards: {', '.join(seen)}")
    return lines, [_warning(lights) for lights in apart]


def never_apart(groups: LightGroups) -> list[tuple[str, ...]]:
    """The lights whose sum alone can be known, together: none in an ordinary capture.

    Each picture is a sum of lights times their levels: what tells them apart are the levels of the groups
    and of the standard as linear equations. Of two that change to unknown levels in one group nobody can say
    which did what: they count as one level there.
    """
    rows = [groups.standard_levels, *map(groups.levels, groups.groups)]
    unknown = [1.0 + (UNKNOWN_RATIO * number) % 1.0 for number in range(len(rows))]
    levels = np.array(
        [[u if level is None else level for level in row] for u, row in zip(unknown, rows, strict=True)]
    )
    _, strengths, right = np.linalg.svd(levels)
    free = right[np.count_nonzero(strengths > NOTHING * strengths[0]) :]
    together = np.abs(free.T @ free) > NOTHING
    found: list[tuple[str, ...]] = []
    for place in np.flatnonzero(together.any(axis=1)):
        lights = tuple(groups.lights[k] for k in np.flatnonzero(together[place]))
        if lights not in found:
            found.append(lights)
    return found


def _warning(lights: tuple[str, ...]) -> str:
    changing = [light for light in lights if light != AMBIENT]
    if len(changing) == 1:
        return (
            f"{changing[0]} never changes: it cannot be turned; take photos with it off, or at another level"
        )
    return (
        f"{', '.join(lights[:-1])} and {lights[-1]} always change together: they cannot be turned one by "
        "one; "
        "take photos with one of them changed"
    )


def _in_words(level: float | None) -> str:
    if level is None:
        return "at a level to be found"
    return {0.0: "off", 1.0: "on"}.get(level, f"at {level:g}")


def group_words(group: LightGroup) -> str:
    """``pendant off, daylight at a level to be found``."""
    return ", ".join(f"{light} {_in_words(level)}" for light, level in group.levels.items())
