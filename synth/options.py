# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked for: the options of a data set, their defaults and their limits."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from .device import DEVICES
from .errors import OptionError, UnknownNameError
from .rig import PATH, RIGS
from .scenes import SCENES

DEFAULT_EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)  # EV −3, −1, 1, 3, 5
LARGEST_SIDE = 8192
LARGEST_LEVEL = 1024.0
LARGEST_ELEVATION = 85.0
"""Degrees: nearer to the zenith the direction of 'up' is lost."""
FOLLOW = 0
"""The height of a resolution that follows the aspect of the user's scene."""
CURRENT = "current"
"""The value of ``from_file`` that means the file that is open."""


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
    device: str = "CPU"
    from_file: str | None = None
    """A .blend file, or ``CURRENT``: the data set is made of the user's scene in it instead of ``scene``."""
    scene_name: str = ""
    """The scene in that file; its active one if empty."""
    rig_distance: float | None = None
    """Metres from the user's camera to what the rig looks at; found by itself if ``None``."""
    rig_extent: tuple[float, float] | None = None
    """Width and height of the grid in metres; a share of the distance if ``None``."""
    rig_arc: float | None = None
    """Degrees of azimuth of orbit and hemisphere."""
    rig_elevation: tuple[float, float] | None = None
    """Lowest and highest degrees above the horizon of the hemisphere."""

    def check(self) -> None:
        """Raise ``OptionError`` or ``UnknownNameError`` for the first option that cannot be."""
        rigs = [*RIGS, PATH] if self.from_file else list(RIGS)
        if not self.from_file and self.scene not in SCENES:
            raise UnknownNameError("scene", self.scene, list(SCENES))
        if self.camera_rig not in rigs:
            raise UnknownNameError("camera rig", self.camera_rig, rigs)
        if self.device not in DEVICES:
            raise UnknownNameError("device", self.device, list(DEVICES))
        for side in self.resolution:
            if side != FOLLOW or not self.from_file:
                _within("--resolution", side, 8, LARGEST_SIDE)
        _within("--samples", self.samples, 1, 2**20)
        _within("--views", self.views, 2, 10_000)
        _within("--seed", self.seed, 0, 2**31 - 1)
        _within("--lit-views", self.lit_views, 0, 10_000)
        _within("--relit-views", self.relit_views, 0, self.views // 2)
        self._check_rig()
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

    def _check_rig(self) -> None:
        numbers = {
            "--rig-distance": self.rig_distance,
            "--rig-extent": self.rig_extent,
            "--rig-arc": self.rig_arc,
            "--rig-elevation": self.rig_elevation,
        }
        given = [name for name, value in numbers.items() if value is not None]
        if given and not self.from_file:
            raise OptionError(f"{given[0]} is for --from-file: the built-in scenes bring their own rig")
        if self.rig_distance is not None:
            _within("--rig-distance (metres)", self.rig_distance, 1e-3, 1e6)
        for side in self.rig_extent or ():
            _within("--rig-extent (metres)", side, 0.0, 1e6)
        if self.rig_arc is not None:
            _within("--rig-arc (degrees)", self.rig_arc, 0.1, 360.0)
        for angle in self.rig_elevation or ():
            _within("--rig-elevation (degrees)", angle, -LARGEST_ELEVATION, LARGEST_ELEVATION)
        if self.rig_elevation and self.rig_elevation[0] > self.rig_elevation[1]:
            raise OptionError(f"--rig-elevation {_join(self.rig_elevation)}: the lower one first")

    def as_json(self) -> dict[str, Any]:
        """What a resumed run must have in common with the first; where the file lies is no part of it."""
        values = {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}
        if not self.from_file:
            del values["from_file"], values["scene_name"]
        else:
            values["from_file"] = True
        # Options that came later are left out where they are not used: older data sets have none.
        later = ("rig_distance", "rig_extent", "rig_arc", "rig_elevation")
        values = {key: value for key, value in values.items() if key not in later or value is not None}
        if self.device == Options.device:
            del values["device"]
        return values


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


def parse_pair(name: str, text: str) -> tuple[float, float]:
    """``"1.5x0.8"`` or ``"-5,40"`` → two numbers.

    Raises:
        OptionError
    """
    values = parse_numbers(name, text.lower().replace("x", " "))
    if len(values) != 2:
        raise OptionError(f"{name} '{text}': two numbers are needed, such as 1.5,0.8")
    return values[0], values[1]


def parse_resolution(text: str, follow: bool = False) -> tuple[int, int]:
    """``"200"`` → (200, 200), ``"320x240"`` → (320, 240); ``follow``: ``"200"`` → (200, ``FOLLOW``).

    Raises:
        OptionError
    """
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.strip().isdigit() for part in parts):
        raise OptionError(f"--resolution '{text}': write 200 or 320x240")
    if follow and len(parts) == 1:
        return int(parts[0]), FOLLOW
    return int(parts[0]), int(parts[-1])
