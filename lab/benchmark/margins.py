# SPDX-License-Identifier: GPL-3.0-or-later
"""Margins between methods: differences of runs on the same scene with the same seed.

Claims generalise over scenes, while seeds are chance. So a scene's differences are first averaged over its
seeds, and the interval is Student's over the scenes, which includes both kinds of spread. Several scenes of
one room say little more about other rooms than one of them: they are averaged too, and the interval is over
the rooms.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtrit

from ...backend.evaluate.comparison import Column, ComparedRun, column

#: Metrics that methods are compared by.
JUDGED = ("LDR-OE.psnr", "LDR-NE.psnr", "HDR.psnr", "HDR-aligned.psnr", "LDR-OE.lpips", "relit.psnr")
#: The probability that an interval contains the mean difference.
CONFIDENCE = 0.95

Standing = Literal["ahead", "behind", "undecided", "one run"]


@dataclass(frozen=True)
class Margin:
    """Paired differences, one for each (scene, seed) that both methods have.

    ``mean``: over rooms, of means over scenes, of means over seeds. ``interval``: of that mean, over the
    rooms if there are two, else over the only room's scenes, else over its seeds; None for one pair.
    ``spread``: the standard deviation over the seeds of a scene, pooled over the scenes (differences between
    scenes are not noise); None if no scene has two seeds.
    """

    mean: float
    interval: tuple[float, float] | None
    spread: float | None
    pairs: int
    scenes: int
    rooms: int
    lower_is_better: bool = False

    @property
    def standing(self) -> Standing:
        """*ahead* if all of the interval is on the better side of 0; *undecided* if it contains 0."""
        if self.interval is None:
            return "one run"
        low, high = (-self.interval[1], -self.interval[0]) if self.lower_is_better else self.interval
        return "ahead" if low > 0.0 else "behind" if high < 0.0 else "undecided"


def margin(entries: Sequence[ComparedRun], method: str, other: str, key: str) -> Margin | None:
    """``method`` − ``other`` in the column ``key`` (``LDR-OE.psnr``); None if no runs can be paired."""
    each = column(key)
    ours, theirs = _by_run(entries, method, each), _by_run(entries, other, each)
    of_scene: dict[str, list[float]] = {}
    for run in ours.keys() & theirs.keys():
        of_scene.setdefault(run[0], []).append(ours[run] - theirs[run])
    if not of_scene:
        return None
    room_of = {entry.scene: entry.room for entry in entries}
    of_room: dict[str, list[float]] = {}
    for scene, seeds in of_scene.items():
        of_room.setdefault(room_of[scene], []).append(statistics.fmean(seeds))
    rooms = [statistics.fmean(scenes) for scenes in of_room.values()]
    levels = (rooms, *of_room.values(), *of_scene.values())  # with one room or scene, the next level decides
    interval = _interval(next((values for values in levels if len(values) > 1), rooms))
    return Margin(
        mean=statistics.fmean(rooms),
        interval=interval,
        spread=_spread(of_scene),
        pairs=sum(map(len, of_scene.values())),
        scenes=len(of_scene),
        rooms=len(rooms),
        lower_is_better=each.better == "lower",
    )


def _interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Student's interval of the mean of ``values``; None for a single one."""
    if len(values) < 2:
        return None
    quantile = float(stdtrit(len(values) - 1, 0.5 + 0.5 * CONFIDENCE))
    reach = quantile * statistics.stdev(values) / math.sqrt(len(values))
    mean = statistics.fmean(values)
    return mean - reach, mean + reach


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
