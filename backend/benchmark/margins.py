# SPDX-License-Identifier: GPL-3.0-or-later
"""By how much one method is ahead of another: differences of runs on the same scene with the same seed."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from ..evaluate.comparison import Column, ComparedRun, column

#: What a method is judged by, and the paper's margins over GaussHDR on its synthetic scenes, in dB (Ours† −
#: GaussHDR†, exp3: 44.26 − 43.87, 43.19 − 42.74, 39.21 − 39.08).
PAPER_MARGINS = {"LDR-OE.psnr": 0.39, "LDR-NE.psnr": 0.45, "HDR.psnr": 0.13}


@dataclass(frozen=True)
class Margin:
    """Paired differences, one for each (scene, seed) that both methods have.

    ``spread``: their standard deviation over the seeds of a scene, pooled over the scenes (that scenes differ
    is no noise); None where no scene has two seeds.
    """

    mean: float
    spread: float | None
    least: float
    pairs: int

    @property
    def is_ahead(self) -> bool | None:
        """Whether the mean is above 0 by more than the spread; None where no spread is known."""
        return None if self.spread is None else self.mean > self.spread


def margin(entries: Sequence[ComparedRun], method: str, other: str, key: str) -> Margin | None:
    """``method`` − ``other`` in the column ``key`` (``LDR-OE.psnr``); None where no run can be paired."""
    each = column(key)
    ours, theirs = _by_run(entries, method, each), _by_run(entries, other, each)
    of_scene: dict[str, list[float]] = {}
    for run in ours.keys() & theirs.keys():
        of_scene.setdefault(run[0], []).append(ours[run] - theirs[run])
    if not of_scene:
        return None
    differences = [difference for scene in of_scene.values() for difference in scene]
    return Margin(statistics.fmean(differences), _spread(of_scene), min(differences), len(differences))


def _spread(of_scene: dict[str, list[float]]) -> float | None:
    repeated = [scene for scene in of_scene.values() if len(scene) > 1]
    if not repeated:
        return None
    squares = sum(statistics.variance(scene) * (len(scene) - 1) for scene in repeated)
    return math.sqrt(squares / sum(len(scene) - 1 for scene in repeated))


def _by_run(entries: Sequence[ComparedRun], method: str, each: Column) -> dict[tuple[str, int | None], float]:
    values = {
        (entry.scene, entry.seed): each.value(entry)
        for entry in entries
        if entry.method == method and not entry.published
    }
    return {run: value for run, value in values.items() if value is not None}
