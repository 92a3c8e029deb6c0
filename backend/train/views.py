# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a scene a training sees: which views, at which of their exposures, with levels of which lights."""

from collections.abc import Sequence

from ...bridge.errors import DataMismatchError
from ...bridge.lights import AMBIENT
from ..methods.base import Responses
from ..scene.scene import Scene, View
from .config import TrainConfig


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


def may_merge_brackets(config: TrainConfig) -> bool:
    """Whether training pictures may be merged with their brackets; a published method sees them as taken."""
    wanted = config.merged_brackets
    return wanted == "on" or (wanted == "auto" and config.method.traits.effects)


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
