# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a scene a training sees: which views, at which of their exposures, with levels of which lights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.lights import AMBIENT
from ...bridge.limits import RADIANCE_MAX
from ..kernels.activations import LOG_RADIANCE_RANGE
from ..methods.base import Responses
from ..scene.scene import Scene, View
from .config import TrainConfig

#: Streams of random numbers, so that no two purposes draw the same ones.
STREAM_VIEWS, STREAM_EXPOSURES, STREAM_GROWTH, STREAM_BATCH = range(4)


def training_views(scene: Scene, config: TrainConfig) -> list[View]:
    """Those of the standard light, and those of other light where the method knows what to make of them."""
    return [*scene.train, *(scene.lit if config.method.traits.light == "view" else [])]


def training_lights(scene: Scene, config: TrainConfig) -> tuple[str, ...]:
    """Names of the lights that the method has levels for."""
    return scene.lights if config.method.traits.light == "view" else (AMBIENT,)


def responses_of(views: Sequence[View], exposures: Sequence[tuple[int, ...]]) -> Responses:
    """What is known of the responses of ``views`` at those positions of their brackets that are trained."""
    each = zip(views, exposures, strict=True)
    known = {view.encodings[k].is_known for view, allowed in each for k in allowed}
    return "mixed" if len(known) > 1 else "known" if True in known else "learned"


def log_radiance_range(views: Sequence[View], exposures: Sequence[tuple[int, ...]]) -> tuple[float, float]:
    """Bounds of ln radiance for what ``views`` show at those positions of their brackets that are trained.

    ``LOG_RADIANCE_RANGE`` is enough for exposures of 1/40 to 32 s. Photos in the sun take 1/8000 s, where
    white is a radiance of 8000; pictures of radiance may be in any unit.
    """
    low, high = LOG_RADIANCE_RANGE
    most = math.log(RADIANCE_MAX)
    for view, allowed in zip(views, exposures, strict=True):
        for k in allowed:
            darkest, brightest = view.encodings[k].span
            low = min(low, math.log(darkest / view.exposures[k]))
            high = max(high, math.log(brightest / view.exposures[k]))
    return max(low, -most), min(high, most)


def training_exposures(view: View, config: TrainConfig) -> tuple[int, ...]:
    """Positions in the view's bracket; ``config.training_exposures`` are places in the whole one.

    Raises ``DataMismatchError`` where the view has none of them.
    """
    places = [view.place_of(k) for k in config.training_exposures]
    allowed = tuple(place for place in places if place is not None)
    if not allowed:
        raise DataMismatchError(
            f"view {view.name} has the exposures {list(view.bracket)}, training wants "
            f"{list(config.training_exposures)}",
            "Set --training-exposures to indices that the data set has.",
        )
    return allowed


def seen_exposures(views: Sequence[View], config: TrainConfig) -> list[tuple[int, ...]]:
    """For each of the training's views, positions in its bracket: all that it may see, or the one drawn.

    Raises as ``training_exposures``.
    """
    allowed = [training_exposures(view, config) for view in views]
    if config.exposure_mode != "exp1":
        return allowed
    random = (np.random.default_rng([config.seed, STREAM_EXPOSURES, index]) for index in range(len(views)))
    return [(int(rng.choice(each)),) for rng, each in zip(random, allowed, strict=True)]


@dataclass(frozen=True)
class Seen:
    """What a training may look at: ``views`` of ``scene``, at ``exposures``, their positions in each bracket.

    ``lights``: names of those that it has levels of, and these in ``standard_levels``; ``responses``: what is
    known of the pictures'; ``range``: bounds of ln radiance.
    """

    scene: Scene
    views: list[View]
    exposures: list[tuple[int, ...]]
    lights: tuple[str, ...]
    responses: Responses
    range: tuple[float, float]
    standard_levels: tuple[float, ...] = (1.0,)


def seen_by(scene: Scene, config: TrainConfig) -> Seen:
    """What a training of ``config`` sees of ``scene``; raises ``BadValueError`` where there are no views."""
    views = training_views(scene, config)
    if not views:
        raise BadValueError(f"{scene.root} has no training views")
    exposures = seen_exposures(views, config)
    return Seen(
        scene,
        views,
        exposures,
        training_lights(scene, config),
        responses_of(views, exposures),
        log_radiance_range(views, exposures),
        scene.standard_levels if config.method.traits.light == "view" else (1.0,),
    )
