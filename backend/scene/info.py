# SPDX-License-Identifier: GPL-3.0-or-later
"""``dataset.json``: what our data sets say of themselves (docs/formats.md); any other layout may have one."""

from pathlib import Path
from typing import Any

from ...bridge import data_set
from ...bridge.errors import BadValueError
from ...bridge.layouts.checks import MAKE_AGAIN, number

#: The response of HDR-NeRF-Syn at exposure × radiance = 1: the constant of its unit-exposure loss.
ORIGINAL_ANCHOR = (1.0, 0.73)


def read_info(root: Path) -> dict[str, Any]:
    """``dataset.json`` as it is, checked to be ours; ``{}`` where there is none. Raises as in ``bridge``."""
    return data_set.read_info(root, MAKE_AGAIN)


def read_anchor(
    root: Path, info: dict[str, Any], otherwise: tuple[float, float] | None
) -> tuple[float, float] | None:
    """(exposure × radiance, code value); None where a ``dataset.json`` names none.

    ``otherwise``: the anchor of a folder without that file, None where it is unknown.
    """
    if not info:
        return otherwise
    response = info.get("response")
    anchor = response.get("anchor") if isinstance(response, dict) else None
    if anchor is None:
        return None
    path = root / data_set.INFO_FILE
    if not isinstance(anchor, list) or len(anchor) != 2:
        raise BadValueError(
            f"{path}: response.anchor must be [exposure × radiance, code value], got {anchor!r}",
            "Fix it, or remove it: the absolute scale of the radiance is then unknown.",
        )
    light, code = (number(path, value, "response.anchor") for value in anchor)
    if light <= 0.0 or not 0.0 < code < 1.0:
        raise BadValueError(
            f"{path}: response.anchor {anchor} is outside (0, ∞) × (0, 1)",
            "Give a point at which the response is neither black nor saturated.",
        )
    return light, code
