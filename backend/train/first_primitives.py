# SPDX-License-Identifier: GPL-3.0-or-later
"""The state before the first iteration: where primitives are, as bright as the photos say, and the response.

One question leads to the next. Stereo compares radiance, so brackets tell of the response before; what
points tell of the photos themselves (gains, balances, lens, and the response where no bracket did) is asked
once they are there; and their radiance is read with all of that known.
"""

import math

import numpy as np
import torch

from ..model.backbone import Start
from ..model.tone_mapper import Response, ToneMapper
from ..scene.plausible import too_near
from ..scene.points import EXACT, STRUCTURE_FROM_MOTION
from ..scene.scene import View
from ..start.far_shell import far_points
from ..start.initialise import initial_points, largest_sizes, merged_log_radiance
from ..start.photometry import NO_STOPS, NoPhotometry, Photometry
from ..start.response import bracket_response, display_response, point_response
from .clearance import clearances
from .nuisances import Nuisances
from .plan import Plan
from .state import State
from .views import Seen

#: Who told of the response at the start, in words.
BY_BRACKETS, BY_POINTS, BY_SRGB = "brackets tell it", "points tell it", "sRGB has it"


def place(state: State, nuisances: Nuisances | None) -> None:
    """Put the backbone's first primitives where the scene is, and begin with the response that is told.

    ``nuisances`` begin, too. Where a method wants its ``initial_radiance`` of the points, ln radiance is
    their colour (HDR-GS). Notes in ``state`` whence they are, and before which depths nothing is. Raises what
    ``initial_points`` raises.
    """
    plan, method, merged = state.plan, state.method, state.data.merged
    config, seen = plan.config, plan.seen
    # Only views under the standard light say how bright a point is at level 1.
    standard = [(v, e) for v, e in zip(seen.views, seen.exposures, strict=True) if v.is_standard]
    views, exposures = [v for v, _ in standard], [e for _, e in standard]
    response, by = method.first_response, ""
    if config.calibration is None:
        by = _response_without_points(method.tone_mapper, seen)
    points = initial_points(
        seen.scene,
        views,
        exposures,
        response,
        source=config.initial_points,
        random_count=config.random_points,
        budget=plan.backbone.budget,
        seed=config.seed,
    )
    message, positions = points.message, points.positions
    cameras = [view.camera for view in views]
    if not points.are_random and (warning := too_near(seen.scene.root, positions, cameras)):
        message += f", {warning.removesuffix('.')}"
    if merged is not None:
        message += f", brackets merged (noise of {merged.worst:.1f} codes of 255)"
    if plan.clears_cameras:
        state.clearance = clearances(positions, [view.camera for view in seen.views])
    if plan.far_shell:
        far = far_points(positions, views)
        positions = np.concatenate([positions, far])
        message += f", {len(far):,} far away where these leave pictures uncovered"
    told = _told_by(positions, response, seen, nuisances, asks_response=by == BY_SRGB)
    if isinstance(told, NoPhotometry):
        message += f", no photometric estimate from the points ({told.reason})"
        told = None
    if by == BY_SRGB and seen.responses == "learned":
        by = _response_by_points(method.tone_mapper, told, seen)
    if by:
        message += f", the response as {by}"
    radiance = points.colours if config.method.traits.initial_radiance == "points" else None
    if radiance is None:
        radiance = merged_log_radiance(positions, views, exposures, response, seen.range)
        radiance = radiance - _standard_log_change(seen)
    if nuisances is not None:
        radiance = radiance - nuisances.begin(positions, told)
    start = Start(
        opacity=config.initial_opacity,
        thickness=config.initial_thickness if lie_on_surfaces(plan) else 1.0,
        largest=_largest_sizes(positions, views, plan),
        seed=config.seed,
    )
    method.backbone.place(positions, radiance, start)
    state.start_message = message


def _standard_log_change(seen: Seen) -> float:
    """By how much less than at level 1 the standard light leaves in the beginning, where shares are alike."""
    share = 1.0 / (len(seen.lights) + 1)
    return math.log1p(sum(share * (level - 1.0) for level in seen.standard_levels))


def may_have_strays(plan: Plan) -> bool:
    """Whether primitives begin at points that may stand alone: those of structure from motion."""
    return plan.points_origin == STRUCTURE_FROM_MOTION


def lie_on_surfaces(plan: Plan) -> bool:
    """Whether primitives begin at points whose neighbours tell how the surface lies: exact ones."""
    return plan.points_origin == EXACT


def _largest_sizes(positions: np.ndarray, views: list[View], plan: Plan) -> np.ndarray | None:
    """``[P]`` metres that no Gaussian begins larger than; None: no bound."""
    share = plan.config.initial_size_limit
    if not (share and may_have_strays(plan)):
        return None
    return largest_sizes(positions, [view.camera for view in views], share)


def _response_without_points(mapper: Response, seen: Seen) -> str:
    """Begin with the response that brackets tell, else sRGB's; which it is, "" where it is another."""
    if not (isinstance(mapper, ToneMapper) and mapper.measures_response):
        return ""
    anchor = seen.scene.response_anchor
    found = bracket_response(seen.views, seen.exposures, anchor)
    mapper.begin_with(*(found or display_response(anchor)))
    return BY_SRGB if found is None else BY_BRACKETS


def _response_by_points(mapper: Response, told: Photometry | None, seen: Seen) -> str:
    """Begin with the response that points tell, where they do; which it is then."""
    found = point_response(told, seen.scene.response_anchor)
    if found is None:
        return BY_SRGB
    assert isinstance(mapper, ToneMapper)
    mapper.begin_with(*found)
    return BY_POINTS


def _told_by(
    points: np.ndarray, response: Response, seen: Seen, nuisances: Nuisances | None, *, asks_response: bool
) -> Photometry | NoPhotometry | None:
    """What points ``[P, 3]`` (metres) tell of the photos, or why nothing; None where nobody asks."""
    if nuisances is None and asks_response:
        # Where none are learned, none explain what photos disagree about.
        stops = NO_STOPS, NO_STOPS
        nuisances = Nuisances(seen.views, seen.exposures, torch.device("cpu"), stops=stops)
    return None if nuisances is None else nuisances.told_by(points, response)
