# SPDX-License-Identifier: GPL-3.0-or-later
"""What a number of a user's file may be: wide enough for every real scene, narrow enough that all arithmetic
on it stays finite. A reader that meets another says so, instead of training on it.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeGuard

from .errors import BadValueError


@dataclass(frozen=True)
class Bounds:
    """From ``low`` to ``high``, both allowed; ``unit`` and ``remedy`` are for the message."""

    low: float
    high: float
    unit: str
    remedy: str

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def check(self, value: float, whose: str) -> float:
        """``value``; raises ``BadValueError`` where it is outside. ``whose`` begins the message: a file."""
        if value not in self:
            raise BadValueError(f"{whose} is {value:g} {self.unit}: it must be {self}", self.remedy)
        return value

    def __str__(self) -> str:
        return f"from {self.low:g} to {self.high:g}"


#: Coordinates of cameras, points and Gaussians. Gaussians are float32, whose steps are 6 cm at 1e6 and half a
#: metre at UTM's northings (5e6): such data would train on positions that are rounded away.
FARTHEST = 1e6
COORDINATE = Bounds(
    -FARTHEST,
    FARTHEST,
    "metres",
    "Move the world's origin into the scene: subtract one vector (UTM's false origin) from all positions, "
    "of cameras and of points; scale them where they are in millimetres.",
)

#: Exposures as EV (0 is one second): what preview, export and the import in Blender take. Seconds are 2^EV,
#: from a billionth to 34 years; what a photo's exposure is at ISO 100 and f/8 lies between 1e-6 and 1e4.
EV_MAX = 30.0
EXPOSURE = Bounds(
    2.0**-EV_MAX,
    2.0**EV_MAX,
    "s",
    "An exposure must be longer than 0 s and is given in seconds: fix it.",
)

#: Lighting levels other than 0. Data sets have 1/1024 to 1024; a level enters the networks as its logarithm.
LEVEL = Bounds(
    1e-6,
    1e6,
    "times the standard light",
    "Light cannot be negative, and one that is switched off has the level 0.",
)

#: Focal lengths in pixels: a picture of 100 pixels with a focal length of 0.01 sees 179.99 degrees, which no
#: pinhole camera does; a telescope of 10 m on pixels of 3 µm has 3e6.
FOCAL_LENGTH = Bounds(0.01, 1e7, "pixels", "Give the focal length in pixels of the full-size picture.")

#: Principal points in pixels from the picture's corner; those of crops are outside of the picture.
PRINCIPAL_POINT = Bounds(-1e6, 1e6, "pixels", "Give the principal point in pixels from the top left corner.")

#: The true radiance: the sun's disc is 2e7 W/m²/sr. Sums of squares over the largest picture are then below
#: float32's end: 1e24 × 3 × 2^27 = 4e32.
RADIANCE_MAX = 1e12

#: ln radiance of a Gaussian, toward any direction: with the largest lighting level it is then below float32's
#: end, ln 3.4e38 = 88.7 = 74.9 + ln 1e6. What training reaches is far below, ln RADIANCE_MAX = 27.6 at most.
LOG_RADIANCE_MAX = 74.0

#: Pixels of a side that a camera may have; the largest sensors and scanners have a tenth.
LARGEST_SIDE = 1 << 20
#: Pixels of a picture. No picture of ours is larger; a header that claims more is damaged or hostile.
MAX_PIXELS = 1 << 27


#: Threads, or processes, that somebody may ask for. Where the system refuses another thread, native libraries
#: end the whole process (LLVM aborts) instead of raising an error.
THREADS_MAX = 256
#: Parts that the rendering of a data set is divided into.
PARTS_MAX = 10_000


def whole(name: str, value: int, least: int, most: int) -> int:
    """``value``; raises ``BadValueError`` where it is not from ``least`` to ``most``."""
    if not least <= value <= most:
        raise BadValueError(f"{name} is {value}", f"It must be from {least} to {most}.")
    return value


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value of a JSON file is a number: finite, and one that a float can hold, which not every
    integer there can. JSON's true and false are none.
    """
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_level(value: float, whose: str) -> float:
    """A lighting level; raises ``BadValueError``. ``whose`` begins the message."""
    if value == 0.0 or value in LEVEL:
        return value
    raise BadValueError(f"{whose} is {value:g}: it must be 0, or {LEVEL}", LEVEL.remedy)


def check_position(position: Iterable[float], whose: str) -> None:
    """Raises ``BadValueError`` where a coordinate is too far away; ``whose`` begins the message."""
    x, y, z = position
    farthest = max((x, y, z), key=lambda c: math.inf if math.isnan(c) else abs(c))
    if farthest not in COORDINATE:
        raise BadValueError(
            f"{whose} is at ({x:g}, {y:g}, {z:g}): coordinates must be {COORDINATE} metres", COORDINATE.remedy
        )
