# SPDX-License-Identifier: GPL-3.0-or-later
"""Options for the light: ``--lighting-level 0.5``, ``--lighting-levels ambient=4 lamp=2``."""

from collections.abc import Sequence

from ...bridge.errors import BadValueError
from ...bridge.lights import as_levels, named_levels


def requested_levels(
    level: float | None, named: Sequence[str], lights: Sequence[str], standard: Sequence[float]
) -> tuple[float, ...]:
    """The level of each of ``lights``: ``level`` for the first one, ``named`` (``NAME=VALUE``) by name.

    Others are as in the ``standard`` photographs (a level each). A light named ``-key`` would be read as an
    option: put a space before it, which no name starts with. Raises ``BadValueError`` for an unknown light
    (listing the known ones), an invalid level, or a light named twice.
    """
    found: dict[str, float] = {}
    if level is not None:
        as_levels(level, lights)
        found[lights[0]] = level
    for text in named:
        name, equals, value = text.rpartition("=")
        name = name.strip()
        try:
            if not equals:
                raise ValueError
            number = float(value)
        except ValueError:
            raise BadValueError(
                f"--lighting-levels: '{text}' is not NAME=VALUE", f"The lights are: {', '.join(lights)}."
            ) from None
        if name in found:
            raise BadValueError(
                f"--lighting-levels: {name} is given twice", f"--lighting-level is that of {lights[0]}."
            )
        found[name] = number
    return named_levels(dict(zip(lights, standard, strict=True)) | found, lights, "--lighting-levels")
