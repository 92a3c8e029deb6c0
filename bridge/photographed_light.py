# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that a model's photographs were taken under, as an entry of its metadata.

It travels with every form of a model: the model file, a point cloud in Blender, ``lossless.ply``. The
standard light comes first: a model looks like its standard photographs under that, and everything begins
there. Then come the groups of ``light_groups``. docs/formats.md specifies the entry.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from .errors import BadValueError
from .limits import check_level, is_number
from .regular import parse_json

#: The metadata's entry, and the name of its first light.
PHOTOGRAPHED_LIGHT, STANDARD = "photographed_light", "standard"
#: How training found a level that nobody stated: where another level of the light is known, or by a guess
#: that is right where the light alone lights some surface.
Found = Literal["measured", "estimated"]
_REMEDY = "Export the model again (physhdr export)."


@dataclass(frozen=True)
class PhotographedLight:
    """Light of some photographs. ``levels`` by light, 1 where missing; ``found``: those of them that training
    found, and how."""

    name: str
    levels: Mapping[str, float]
    found: Mapping[str, Found] = field(default_factory=dict)

    def of(self, lights: Sequence[str]) -> tuple[float, ...]:
        """A level for each of ``lights``."""
        return tuple(self.levels.get(light, 1.0) for light in lights)


def photographed_light_text(photographed: Sequence[PhotographedLight]) -> str:
    """The metadata's entry; empty where all is at level 1, which needs none."""
    if all(level == 1.0 for each in photographed for level in each.levels.values()):
        return ""
    return json.dumps(
        [
            {
                "name": each.name,
                "levels": {light: level for light, level in each.levels.items() if level != 1.0},
                **({"found": dict(each.found)} if each.found else {}),
            }
            for each in photographed
        ]
    )


def photographed_light(metadata: Mapping[str, str]) -> tuple[PhotographedLight, ...]:
    """What a model's ``metadata`` say, the standard light first; it alone, at level 1, where they are silent.

    Raises ``BadValueError``.
    """
    text = metadata.get(PHOTOGRAPHED_LIGHT)
    if text is None:
        return (PhotographedLight(STANDARD, {}),)
    try:
        entries = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise BadValueError(f"{PHOTOGRAPHED_LIGHT} is not JSON: {error!s:.200}", _REMEDY) from error
    if not isinstance(entries, list) or not entries:
        raise BadValueError(f"{PHOTOGRAPHED_LIGHT} is {text:.80}, not a list of lights", _REMEDY)
    return tuple(map(_photographed, entries))


def standard_levels(metadata: Mapping[str, str], lights: Sequence[str]) -> tuple[float, ...]:
    """The level of each of ``lights`` under the standard light; raises ``BadValueError``."""
    return photographed_light(metadata)[0].of(lights)


def _photographed(entry: Any) -> PhotographedLight:
    match entry:
        case {"name": str(name), "levels": dict(levels)} if name.isprintable() and all(
            is_number(level) and level >= 0.0 for level in levels.values()
        ):
            found = entry.get("found", {})
        case _:
            raise BadValueError(f"{PHOTOGRAPHED_LIGHT} has the entry {entry!r:.80}", _REMEDY)
    if not isinstance(found, dict) or not all(how in ("measured", "estimated") for how in found.values()):
        raise BadValueError(f"{PHOTOGRAPHED_LIGHT}: {name:.80}: found is {found!r:.80}", _REMEDY)
    for light, level in levels.items():
        check_level(float(level), f"{PHOTOGRAPHED_LIGHT}: {name:.80}: {light:.80}")
    return PhotographedLight(name, {light: float(level) for light, level in levels.items()}, found)
