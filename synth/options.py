# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked for: the options of a data set, their defaults and their limits."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from .errors import OptionError, UnknownNameError
from .rig import RIGS
from .scenes import SCENES

DEFAULT_EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)  # EV −3, −1, 1, 3, 5
LARGEST_SIDE = 8192
LARGEST_LEVEL = 1024.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """Everything that changes what is in the folder. Two runs with equal options make the same data set."""

    scene: str = "interior"
    resolution: tuple[int, int] = (200, 200)
    samples: int = 32
    views: int = 35
    exposures: tuple[float, ...] = DEFAULT_EXPOSURES
    crf: str = "reinhard-gamma"
    seed: int = 0
    ambient_levels: tuple[float, ...] = (0.25, 0.5, 2.0, 4.0)
    relit_views: int = 4
    lit_levels: tuple[float, ...] = (0.25, 4.0)
    lit_views: int = 12
    camera_rig: str = "grid"
    denoise: bool = True

    def check(self) -> None:
        """Raise ``OptionError`` or ``UnknownNameError`` for the first option that cannot be."""
        if self.scene not in SCENES:
            raise UnknownNameError("scene", self.scene, list(SCENES))
        if self.camera_rig not in RIGS:
            raise UnknownNameError("camera rig", self.camera_rig, list(RIGS))
        for side in self.resolution:
            _within("--resolution", side, 8, LARGEST_SIDE)
        _within("--samples", self.samples, 1, 2**20)
        _within("--views", self.views, 2, 10_000)
        _within("--seed", self.seed, 0, 2**31 - 1)
        _within("--lit-views", self.lit_views, 0, 10_000)
        _within("--relit-views", self.relit_views, 0, self.views // 2)
        if not self.exposures:
            raise OptionError("--exposures: at least one is needed")
        for value in self.exposures:
            _within("--exposures (seconds: EV −3 is 0.125)", value, 1e-6, 1e6)
        if any(b <= a for a, b in zip(self.exposures, self.exposures[1:], strict=False)):
            raise OptionError(f"--exposures {_join(self.exposures)}: must rise, shortest first")
        for name, levels in (("--ambient-levels", self.ambient_levels), ("--lit-levels", self.lit_levels)):
            for level in levels:
                _within(name, level, 0.0, LARGEST_LEVEL)
            if len(set(levels)) != len(levels):
                raise OptionError(f"{name} {_join(levels)}: each level once")
        if 1.0 in self.ambient_levels:
            raise OptionError("--ambient-levels: level 1 is the test split itself; leave it out")
        if self.lit_views and not self.lit_levels:
            raise OptionError("--lit-views: needs at least one of --lit-levels (or --lit-views 0)")

    def as_json(self) -> dict[str, Any]:
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # also catches NaN
        raise OptionError(f"{name}: {value:g} is not within {low:g} … {high:g}")


def _join(values: tuple[float, ...]) -> str:
    return ",".join(f"{value:g}" for value in values)


def parse_numbers(name: str, text: str) -> tuple[float, ...]:
    """``"1/4,0.5,2"`` → (0.25, 0.5, 2.0). An empty text is an empty list.

    Raises:
        OptionError: a part is no number.
    """
    values = []
    for part in text.replace(",", " ").split():
        try:
            values.append(float(Fraction(part)))
        except (ValueError, ZeroDivisionError, OverflowError):
            raise OptionError(
                f"{name} '{text}': '{part}' is not a number (write 0.125,0.5,2 or 1/4,1/2,2)"
            ) from None
    return tuple(values)


def parse_resolution(text: str) -> tuple[int, int]:
    """``"200"`` → (200, 200), ``"320x240"`` → (320, 240).

    Raises:
        OptionError
    """
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.strip().isdigit() for part in parts):
        raise OptionError(f"--resolution '{text}': write 200 or 320x240")
    width, height = int(parts[0]), int(parts[-1])
    return width, height
