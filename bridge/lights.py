# SPDX-License-Identifier: GPL-3.0-or-later
"""The lights of a scene by name, and a level for each: a factor on what that light causes, 1 as captured.

Everywhere a level is taken, a plain number is that of the first light (the ambient one, where a scene names
no others), and the others stay at 1.
"""

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import cast

from .errors import BadValueError
from .limits import check_level

#: The light that every data set has: sky, sun and fill.
AMBIENT = "ambient"

#: One level for the first light, or one for each in the order of the lights.
Levels = float | Sequence[float]


def check_lights(lights: object, whose: str) -> tuple[str, ...]:
    """``lights`` as a tuple of names; raises ``BadValueError`` where they are no list of distinct names.

    ``whose`` begins the message: a file, say. A name with ``=`` could not be given on a command line, and
    what is not printable not be shown.
    """
    names = list(lights) if isinstance(lights, list | tuple) else []
    if not names or not all(isinstance(n, str) and n.strip() == n != "" and n.isprintable() for n in names):
        raise BadValueError(f"{whose}: the lights must be a list of names, got {lights!r:.200}")
    if len(set(names)) != len(names) or any("=" in name for name in names):
        raise BadValueError(
            f"{whose}: the lights {', '.join(names):.200} have a name twice or one with '='", "Rename them."
        )
    return tuple(names)


def as_levels(level: Levels, lights: Sequence[str]) -> tuple[float, ...]:
    """One level for each of ``lights``; a plain number is the first one's, the others are then at 1.

    Raises ``BadValueError`` where there are more or fewer levels than lights, and where one is negative, NaN,
    or neither 0 nor within ``limits.LEVEL``.
    """
    if isinstance(level, Real):
        levels = (float(level), *(1.0 for _ in lights[1:]))
    else:
        levels = tuple(float(value) for value in cast(Sequence[float], level))
    if len(levels) != len(lights):
        raise BadValueError(
            f"{len(levels)} lighting levels for {len(lights)} lights",
            f"Give one for each of: {', '.join(lights)}.",
        )
    for name, value in zip(lights, levels, strict=True):
        whose = f"the lighting level of {name}" if len(lights) > 1 else "the lighting level"
        if not value >= 0.0:
            raise BadValueError(f"{whose} must be 0 or more, got {value}")
        check_level(value, whose)
    return levels


def named_levels(named: Mapping[str, float], lights: Sequence[str], whose: str = "") -> tuple[float, ...]:
    """One level for each of ``lights`` from some by name; those not named are at 1.

    Raises ``BadValueError`` where a name is none of ``lights`` and what ``as_levels`` does; ``whose`` begins
    the message.
    """
    where = f"{whose}: " if whose else ""
    unknown = [name for name in named if name not in lights]
    if unknown:
        raise BadValueError(f"{where}there is no light {unknown[0]!r:.80}", f"It has: {', '.join(lights)}.")
    try:
        return as_levels([named.get(name, 1.0) for name in lights], lights)
    except BadValueError as error:
        raise BadValueError(f"{where}{error.message}", error.hint) from error


def in_words(named: Mapping[str, float]) -> str:
    """``ambient 4 + pendant 0.25``."""
    return " + ".join(f"{name} {level:g}" for name, level in named.items())
