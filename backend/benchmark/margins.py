# SPDX-License-Identifier: GPL-3.0-or-later
"""By how much one method is ahead of another: differences of runs on the same scene with the same seed."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from ..evaluate.comparison import Column, Entry, column

#: What a method is judged by, and the paper's margins over GaussHDR on its synthetic scenes, in dB (Ours† −
#: GaussHDR†, exp3: 44.26 − 43.87, 43.19 − 42.74, 39.21 − 39.08).
PAPER_MARGINS = {"LDR-OE.psnr": 0.39, "LDR-NE.psnr": 0.45, "HDR.psnr": 0.13}


@dataclass(frozen=True)
class Margin:
    """Paired differences, one for each (scene, seed) that both methods have.

    ``spread``: their sample standard deviation, None for fewer than two.
    """

    mean: float
    spread: float | None
    least: float
    pairs: int

    @property
    def is_ahead(self) -> bool | None:
        """Whether the mean is above 0 by more than the spread; None where no spread is known."""
        return None if self.spread is None else self.mean > self.spread


def margin(entries: Sequence[Entry], method: str, other: str, key: str) -> Margin | None:
    """``method`` − ``other`` in the column ``key`` (``LDR-OE.psnr``); None where no run can be paired."""
    each = column(key)
    ours, theirs = _by_run(entries, method, each), _by_run(entries, other, each)
    differences = [ours[run] - theirs[run] for run in ours if run in theirs]
    if not differences:
        return None
    spread = statistics.stdev(differences) if len(differences) > 1 else None
    return Margin(statistics.fmean(differences), spread, min(differences), len(differences))


def _by_run(entries: Sequence[Entry], method: str, each: Column) -> dict[tuple[str, int | None], float]:
    values = {
        (entry.scene, entry.seed): each.value(entry)
        for entry in entries
        if entry.method == method and not entry.published
    }
    return {run: value for run, value in values.items() if value is not None}
