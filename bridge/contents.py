# SPDX-License-Identifier: GPL-3.0-or-later
"""What is counted and measured in a data set by all who look into its folder.

The panel's summary looks at JSON and headers alone, because it has to be done at once. ``physhdr inspect``
decodes every picture, of any layout. Who renders a data set judges it before it is described. Each has words
of its own for its own reader; the facts come from here.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .data_set import number_of, plain_name, stem_and_place, stem_of
from .lights import AMBIENT
from .limits import EXPOSURE, is_number

#: Of linear Rec.709 (https://www.itu.int/rec/R-REC-BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: Share of the training pixels without a usable exposure from which on the user is warned.
LOST = 0.05


@dataclass(frozen=True)
class Frame:
    """One pose of our own layout. ``index``: its number, by which its truth is found.

    ``levels``: of the lights that the frame names, unchecked. ``seconds``: its exposures by their places.
    """

    stem: str
    index: int
    levels: dict[str, Any]
    seconds: dict[int, float]


@dataclass(frozen=True)
class SplitContents:
    """A split's two files, as far as they can be understood.

    ``pictures``: name, without ``./``, to seconds. ``wrong``: name, as it is written, to what is no exposure.
    """

    frames: list[Frame]
    pictures: dict[str, float]
    wrong: dict[str, Any]


def split_contents(transforms: dict[str, Any], exposures: dict[str, Any]) -> SplitContents:
    """The contents of a ``transforms_*.json`` and its ``exposure_*.json``.

    Frames without a file's name are left out, and what is no exposure is marked; nothing is raised: the
    trainer's reader refuses what it must, in ``backend/scene``.
    """
    pictures, wrong = {}, {}
    brackets: dict[str, dict[int, float]] = {}
    for name, seconds in exposures.items():
        if not is_number(seconds) or seconds not in EXPOSURE:
            wrong[name] = seconds
            continue
        pictures[plain_name(name)] = float(seconds)
        if parts := stem_and_place(name):
            stem, place = parts
            brackets.setdefault(stem, {})[place] = float(seconds)
    frames = []
    listed = transforms.get("frames")
    for ordinal, entry in enumerate(listed if isinstance(listed, list) else []):
        if isinstance(entry, dict) and isinstance(entry.get("file_path"), str):
            stem = stem_of(entry["file_path"])
            number = number_of(stem)
            index = ordinal if number is None else number
            frames.append(Frame(stem, index, _levels(entry), brackets.get(stem, {})))
    return SplitContents(frames, pictures, wrong)


def _levels(entry: dict[str, Any]) -> dict[str, Any]:
    """``lighting_levels`` names lights; ``lighting_level``, of older data sets, is the ambient one's."""
    named = entry.get("lighting_levels")
    if isinstance(named, dict) and named:
        return named
    return {AMBIENT: entry["lighting_level"]} if "lighting_level" in entry else {}


def stops_between(low: float, high: float) -> float | None:
    """The dynamic range of the training views: from the 1st percentile of their luminance to its maximum.

    None where the former is black, as where more than one pixel in a hundred is.
    """
    return round(math.log2(high / low), 2) if low > 0 else None


def lost_at_the_ends(white: float | None, black: float | None) -> Iterator[tuple[str, str]]:
    """What of the training pixels is lost at both ends of the bracket, and which exposures would show it.

    ``white``: their share that is white even at the shortest exposure, ``black``: that is black even at the
    longest; None where nobody has looked. Up to ``LOST`` nothing is reported.
    """
    for share, what, which, other in (
        (white, "white", "shortest", "shorter"),
        (black, "black", "longest", "longer"),
    ):
        if share is not None and share > LOST:
            yield f"{share:.0%} of the training pixels are {what} even at the {which} exposure", other
