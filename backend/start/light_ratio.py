# SPDX-License-Identifier: GPL-3.0-or-later
"""How much brighter points are in photos under other light than in the standard ones.

With a share s of a point's radiance that one light causes, at level l instead of 1, the ratio is
1 + s (l − 1). A point that this light alone lights has the ratio l; all others are nearer to 1. So the
darkest ratio (the brightest, where the light was turned up) is the level, if a point is lit by nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ..model.camera_effects import widest
from ..model.morton import morton_order
from ..model.tone_mapper import Response
from ..scene.scene import View
from .observations import Observations, observations

#: So many points are used, all over the scene, and so many must be seen under both lights.
POINTS, FEWEST = 6000, 10
#: The shares of points beyond which a ratio is taken for an error: of the extreme, and of what is usual.
EXTREME, TAIL = 0.03, 0.05

#: A view, and positions in its bracket.
Taken = tuple[View, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class LightRatio:
    """``log_ratio`` ``[M]``: ln(radiance in the group / in the standard photos), of points and channels."""

    log_ratio: np.ndarray

    @property
    def median(self) -> float:
        """The middle factor."""
        return float(np.exp(np.median(self.log_ratio)))

    @property
    def darkest(self) -> float:
        """The factor where it is darkest, errors aside."""
        return float(np.exp(np.quantile(self.log_ratio, EXTREME)))

    @property
    def brightest(self) -> float:
        """The factor where it is brightest, errors aside."""
        return float(np.exp(np.quantile(self.log_ratio, 1.0 - EXTREME)))

    @property
    def tails(self) -> tuple[float, float]:
        """How far ratios reach below and above none, ln: errors reach as far to both sides."""
        low, high = np.quantile(self.log_ratio, [TAIL, 1.0 - TAIL])
        return max(-float(low), 0.0), max(float(high), 0.0)


def light_ratio(
    points: np.ndarray, standard: Sequence[Taken], group: Sequence[Taken], response: Response
) -> LightRatio | None:
    """What points ``[P, 3]`` (metres) have; None where too few are seen under both lights.

    Raises what reading pictures raises.
    """
    chosen = np.zeros(len(points), bool)
    along = morton_order(torch.as_tensor(points)).numpy()
    chosen[along[np.linspace(0, len(along) - 1, min(POINTS, len(along))).astype(int)]] = True
    here, there = (_log_radiance(points, chosen, taken, response) for taken in (group, standard))
    both = np.isfinite(here) & np.isfinite(there)
    return LightRatio((here - there)[both]) if np.count_nonzero(both) >= FEWEST else None


def _log_radiance(
    points: np.ndarray, chosen: np.ndarray, taken: Sequence[Taken], response: Response
) -> np.ndarray:
    """The mean ln radiance of ``chosen`` points over photos, ``[P, 3]``; NaN where it is unknown."""
    views, exposures = [view for view, _ in taken], [indices for _, indices in taken]
    reach = [widest(view.camera) for view in views]
    seen, _ = observations(points, chosen, views, exposures, range(len(views)), reach)
    total, count = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    np.add.at(total, (seen.point, seen.channel), _log_exposed(seen, response) - seen.log_time)
    np.add.at(count, (seen.point, seen.channel), 1.0)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def _log_exposed(seen: Observations, response: Response) -> np.ndarray:
    """ln(exposure × radiance) of each observation ``[N]``."""
    count = len(seen.code)
    if not count:
        return seen.known
    codes = torch.from_numpy(np.broadcast_to(seen.code, (3, count)).copy())
    inverse = response.inverse(codes).cpu().numpy()[seen.channel, np.arange(count)]
    return np.where(np.isnan(seen.known), inverse, seen.known)
