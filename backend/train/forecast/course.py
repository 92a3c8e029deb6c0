# SPDX-License-Identifier: GPL-3.0-or-later
"""How many Gaussians a training has from its first iteration to its last: memory and time follow from it."""

import math
from dataclasses import dataclass

from ...start.initialise import most_of_stereo
from ...start.stereo import WORK_WIDTH
from ..plan import Plan


@dataclass(frozen=True)
class Course:
    """``first`` and ``most``: at the start and at the end; they grow from ``grows_from`` to ``grows_until``.

    Iterations before ``half_until`` are at half size. ``seeks``: whether stereo seeks the first points.
    """

    iterations: int
    first: int = 0
    most: int = 0
    grows_from: int = 0
    grows_until: int = 0
    half_until: int = 0
    seeks: bool = False

    def count_at(self, iteration: int) -> float:
        """Gaussians at an iteration, growing evenly."""
        span = max(self.grows_until - self.grows_from, 1)
        share = min(max((iteration - self.grows_from) / span, 0.0), 1.0)
        return self.first + share * (self.most - self.first)


def course_of(plan: Plan) -> Course:
    """As the plan has it, without reading a picture: the most that there can be; without a bound, a guess."""
    half_until = math.ceil(plan.config.half_size_until * plan.iterations)
    if not plan.splats:
        return Course(plan.iterations, half_until=half_until)
    backbone = plan.backbone
    points, seeks = _first_points(plan)
    first = most = backbone.first_gaussians(points)
    begins, ends = backbone.growing(plan.iterations)
    if begins < ends:
        most = max(first, backbone.budget) if backbone.budget else backbone.growth_factor * first
    return Course(plan.iterations, first, most, begins, ends, half_until, seeks)


def _first_points(plan: Plan) -> tuple[int, bool]:
    """At most so many points training starts from, and whether stereo seeks them."""
    config, points = plan.config, plan.seen.scene.points
    given = 0 if points is None else len(points.positions)
    source = config.initial_points
    if source == "random":
        return config.random_points, False
    if source == "file" or (source == "auto" and given):
        return given, False
    found = min(most_of_stereo(plan.backbone.budget, given), WORK_WIDTH**2 * len(plan.seen.views))
    return given + max(found, 0 if given else config.random_points), True
