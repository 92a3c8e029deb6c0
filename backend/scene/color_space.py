# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour spaces of pictures that hold radiance, and the way from them to Linear Rec.709, in which we train.

Primaries and white points: ITU-R BT.709 and BT.2020, SMPTE ST 2065-1 (ACES2065-1) and the Academy's
S-2014-004 (ACEScg). White is adapted by Bradford's matrix, as ICC profiles and OpenColorIO's ACES have it.
"""

from dataclasses import dataclass

import numpy as np

from ...bridge.errors import BadValueError

#: Of cones, by Bradford (Lam 1985; ICC.1:2022, annex E): XYZ → what is scaled.
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True)
class Chromaticities:
    """x and y of red, green, blue and white, as an EXR's attribute ``chromaticities`` has them."""

    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    white: tuple[float, float]

    def to_xyz(self) -> np.ndarray:
        """``[3, 3]``: linear values of these primaries → XYZ, white at Y = 1. Raises ``BadValueError``."""
        primaries = np.array([self.red, self.green, self.blue, self.white], np.float64)
        columns = np.stack([primaries[:, 0], primaries[:, 1], 1.0 - primaries.sum(axis=1)])
        believable = np.isfinite(primaries).all() and (np.abs(primaries) < 10.0).all()
        if not (believable and abs(np.linalg.det(columns[:, :3])) > 1e-4 and primaries[3, 1] > 1e-3):
            raise BadValueError(
                f"the chromaticities {primaries.tolist()} describe no colour space",
                f"Name it by --color-space, one of {', '.join(NAMES)}.",
            )
        white = columns[:, 3] / primaries[3, 1]
        return columns[:, :3] * np.linalg.solve(columns[:, :3], white)

    def to_rec709(self) -> np.ndarray:
        """``[3, 3]``: linear values of these primaries → Linear Rec.709, white to white."""
        ours = SPACES["rec709"]
        if self == ours:
            return np.eye(3)
        here, there = (BRADFORD @ space.to_xyz() @ np.ones(3) for space in (self, ours))
        adapted = np.linalg.inv(BRADFORD) @ np.diag(there / here) @ BRADFORD
        return np.linalg.inv(ours.to_xyz()) @ adapted @ self.to_xyz()


D65, ACES_WHITE = (0.3127, 0.3290), (0.32168, 0.33767)
#: By the names of ``--color-space``; all of them are linear.
SPACES = {
    "rec709": Chromaticities((0.640, 0.330), (0.300, 0.600), (0.150, 0.060), D65),
    "rec2020": Chromaticities((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
    "acescg": Chromaticities((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), ACES_WHITE),
    "aces2065-1": Chromaticities((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), ACES_WHITE),
}
NAMES = tuple(SPACES)
#: Chromaticities that differ by less are the same: files have them as float32, rounded in many ways.
ALIKE = 6e-4


def space_named(name: str) -> Chromaticities:
    """The space of that name; raises ``BadValueError``, naming those there are."""
    if name not in SPACES:
        raise BadValueError(
            f"there is no colour space '{name:.40}'", f"Choose from {', '.join(NAMES)}: all are linear."
        )
    return SPACES[name]


def known(chromaticities: Chromaticities) -> tuple[Chromaticities, str]:
    """The space that a file's chromaticities are of, exactly where they are rounded, and its name or ""."""
    stated = np.array([chromaticities.red, chromaticities.green, chromaticities.blue, chromaticities.white])
    for name, space in SPACES.items():
        exact = np.array([space.red, space.green, space.blue, space.white])
        if np.abs(stated - exact).max() < ALIKE:
            return space, name
    return chromaticities, ""
