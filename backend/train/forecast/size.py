# SPDX-License-Identifier: GPL-3.0-or-later
"""How large a training is: what follows from the data set's pixels, views and points (docs/performance.md).

A preset's numbers are those of 200×200 pixels and few views, at which they were chosen. Larger pictures show
more, which more Gaussians have to hold; these want more iterations, of which more can be at half the size;
and every view wants its turns. What is found is written into the run's configuration as plain numbers, so
that the run does not depend on this rule. What somebody has set by hand stays.
"""

import dataclasses
import math
import statistics
from collections.abc import Collection
from typing import Any

from ...evaluate.published import keeps_exposures_for_testing
from ...evaluate.results import OBSERVED, OBSERVED_EXPOSURES, part_of
from ...scene.points import with_points_file
from ...scene.scene import Scene, View
from ..config import TrainConfig
from ..settings import with_settings
from ..views import training_views

#: Pixels of a view for which the presets' numbers are; fewer change nothing.
REFERENCE_PIXELS = 200 * 200
#: The budget of Gaussians grows with the pixels of a view to this power, iterations to that.
BUDGET_POWER, ITERATIONS_POWER = 0.4, 0.3
#: Turns that each view gets at least.
TURNS = 40
#: Of its points a data set keeps all, and growth can add half as many.
ROOM_ABOVE_POINTS = 1.5
#: So much larger a share of the training is at half size for every doubling of the sides, up to the most.
HALF_SIZE_STEP, HALF_SIZE_MOST = 0.1, 0.4


@dataclasses.dataclass(frozen=True)
class Extent:
    """What sizes follow from: ``pixels`` of the view in the middle, training ``views``, given ``points``.

    ``exposures``: places in the bracket that training is to see: all of a real camera's brackets, which are
    as they were taken. Empty where the benchmark's convention stands, of renders and of data that are laid
    out as a published benchmark, which measures the exposures between; of more than five it goes on, 0 2 4 6.
    """

    pixels: int
    views: int
    points: int
    exposures: tuple[int, ...]

    @property
    def detail(self) -> float:
        """How many times the reference's pixels a view has, 1 at least."""
        return max(1.0, self.pixels / REFERENCE_PIXELS)


def extent_of(scene: Scene, config: TrainConfig) -> Extent:
    """The extent of what ``config`` sees of ``scene``, without reading a picture.

    Points are those of its ``points_file``, where it names one; raises what reading that raises.
    """
    scene = with_points_file(scene, config.points_file)
    views: list[View] = training_views(scene, config)
    pixels = statistics.median_low(view.camera.width * view.camera.height for view in views) if views else 0
    return Extent(
        pixels=pixels,
        views=len(views),
        points=0 if scene.points is None else len(scene.points.positions),
        exposures=_exposures(scene, views, config),
    )


def _exposures(scene: Scene, views: list[View], config: TrainConfig) -> tuple[int, ...]:
    """The places in the bracket that training is to see; empty where it is not for us to choose."""
    there = sorted({k for view in views for k in view.bracket})
    held_back = keeps_exposures_for_testing(scene) and all(
        set(view.bracket).intersection(config.training_exposures) for view in views
    )
    if scene.photographs and not held_back:
        return tuple(there)
    observed = tuple(k for k in there if part_of(k) == OBSERVED)
    return observed if set(observed) > set(OBSERVED_EXPOSURES) else ()


def found_sizes(extent: Extent, config: TrainConfig, typed: Collection[str] = ()) -> TrainConfig:
    """``config``, a preset with what was ``typed``, at the size that the data call for.

    ``typed``: settings that somebody has set, as ``backbone.budget`` is written; these stay. Published
    presets, whose number of Gaussians has no bound, and methods without Gaussians keep their schedule.
    """
    changes: dict[str, Any] = {}
    if extent.exposures:
        changes["training_exposures"] = extent.exposures
    if budget := config.budget:
        changes["backbone.budget"] = _budget(extent, config, budget)
        iterations = _iterations(extent, config)
        changes["iterations"] = iterations
        # Whatever number of iterations is typed: one that is larger is what rates fall in.
        changes["optimiser.rates_for"] = _whole(config.optimiser.rates_for * _times_longer(extent), 100)
        if config.half_size_until > 0.0:
            changes["half_size_until"] = _half_size_until(extent, config)
        if "iterations" not in typed and not config.schedule_for:
            longer = iterations / config.iterations
            changes["sh_degree_every"] = round(config.sh_degree_every * longer)
        if extent.detail > 1.0:
            more = changes["backbone.budget"] / budget
            changes["random_points"] = _whole(config.random_points * more, 1000)
    return with_settings(config, {name: value for name, value in changes.items() if name not in typed})


def sized(scene: Scene, config: TrainConfig, typed: Collection[str] = ()) -> tuple[TrainConfig, str]:
    """``found_sizes`` of what ``config`` sees of ``scene``, and what was found in words."""
    extent = extent_of(scene, config)
    found = found_sizes(extent, config, typed)
    return found, sizes_in_words(extent, config, found)


def sizes_in_words(extent: Extent, before: TrainConfig, found: TrainConfig) -> str:
    """What was found, as a line for people; empty where nothing differs from the preset."""
    parts = []
    if found.iterations != before.iterations:
        parts.append(f"{found.iterations:,} iterations")
    if found.budget != before.budget:
        parts.append(f"up to {found.budget:,} Gaussians")
    if found.half_size_until != before.half_size_until:
        parts.append(f"the first {found.half_size_until:.0%} at half size")
    if found.training_exposures != before.training_exposures:
        every = found.training_exposures
        is_all = every == tuple(range(len(every)))
        parts.append(f"all {len(every)} exposures" if is_all else f"exposures {', '.join(map(str, every))}")
    if not parts:
        return ""
    return f"for {extent.views} views of {extent.pixels / 1e6:.2g} megapixels: {', '.join(parts)}"


# -- the rule ------------------------------------------------------------------------------------------------


def _budget(extent: Extent, config: TrainConfig, budget: int) -> int:
    points = extent.points if config.backbone.keeps_points else 0
    found = max(budget * extent.detail**BUDGET_POWER, ROOM_ABOVE_POINTS * points)
    return budget if found <= budget else _whole(found, 1000)


def _times_longer(extent: Extent) -> float:
    """How many times a preset's own iterations the data call for, 1 at least.

    A preset that is twice as long gives a view twice as many turns, so this is the same for each.
    """
    return max(1.0, extent.detail**ITERATIONS_POWER, TURNS * extent.views / TrainConfig.iterations)


def _iterations(extent: Extent, config: TrainConfig) -> int:
    longer = _times_longer(extent)
    return config.iterations if longer == 1.0 else _whole(config.iterations * longer, 100)


def _half_size_until(extent: Extent, config: TrainConfig) -> float:
    doublings = 0.5 * math.log2(extent.detail)
    most = max(HALF_SIZE_MOST, config.half_size_until)
    return round(min(config.half_size_until + HALF_SIZE_STEP * doublings, most), 2)


def _whole(value: float, step: int) -> int:
    return step * round(value / step)
