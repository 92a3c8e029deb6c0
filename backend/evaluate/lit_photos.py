# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos under other light that were left out for testing: relit renders, and what scaling could do instead.

Whoever has no relighting makes a picture of the usual light brighter or darker. So each photo is also
compared with the model's own render under the standard light, and with the photo under the standard light
from the same place (where there is one), both at the exposure that fits best.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from ..scene.scene import Scene, View
from .photos import Falloff
from .pictures import Pair, pairs
from .renderer import Renderer
from .results import LitRow

#: Exposures that are tried, stops, and how often the step is halved around the best.
STOPS, HALVINGS = np.arange(-5.0, 5.1, 1.0), 6
#: Photos are of one place if their cameras are so near (share of all cameras' spread), and turned so little.
NEAR, TURNED = 0.02, math.radians(2.0)


def can_be_compared(renderer: Renderer, scene: Scene) -> bool:
    """Whether the model has a level for each light that differs in the photos left out."""
    known = all(None not in view.lighting_levels for view in scene.lit_test)
    return known and renderer.can_relight and renderer.lights == scene.lights


@torch.no_grad()
def lit_rows(
    renderer: Renderer, scene: Scene, falloff: Falloff | None, step: Callable[[str], None]
) -> list[LitRow]:
    """A row for each photo of ``scene.lit_test``; calls ``step`` for each view. Raises as ``pairs``."""
    rows = []
    for view in scene.lit_test:
        step(f"lit {view.name}")
        effect = None if falloff is None else falloff(view.camera)
        usual = _usual(view, [*scene.test, *scene.train])
        for k, pair in enumerate(pairs(renderer, view, effect=effect)):
            if pair.mask is not None and not pair.mask.any():
                continue
            photo = None if usual is None else _scaled_photo(renderer, view, k, usual, pair)
            ours = _scaled_render(renderer, view, k, effect)
            where = view.group, view.name, view.index, view.bracket[k], view.exposures[k]
            rows.append(LitRow(*where, ours=pair.psnr(), scaled_ours=ours, scaled_photo=photo))
    return rows


def _best(score: Callable[[float], float]) -> float:
    """The highest ``score`` of a number of stops."""
    tried = {float(stops): score(float(stops)) for stops in STOPS}
    width = float(STOPS[1] - STOPS[0])
    for _ in range(HALVINGS):
        width /= 2.0
        middle = max(tried, key=lambda stops: tried[stops])
        tried |= {stops: score(stops) for stops in (middle - width, middle + width) if stops not in tried}
    return max(tried.values())


def _scaled_render(renderer: Renderer, view: View, k: int, effect: torch.Tensor | None) -> float:
    """PSNR of the render under the standard light at the exposure that fits best."""
    usual = replace(view, lighting_levels=view.standard_levels)

    def score(stops: float) -> float:
        exposures = tuple(seconds * 2.0**stops for seconds in view.exposures)
        (pair,) = pairs(renderer, replace(usual, exposures=exposures), [k], effect=effect)
        return pair.psnr()

    return _best(score)


def _usual(view: View, standard: Sequence[View]) -> View | None:
    """The one of the ``standard`` views that is of the same place, and looks the same way; None: none is."""
    positions = np.array([each.camera.position for each in standard])
    spread = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())

    def is_there(other: View) -> bool:
        here, there = view.camera, other.camera
        cosine = float(np.dot(here.camera_to_world[:3, 2], there.camera_to_world[:3, 2]))
        near = float(np.linalg.norm(here.position - there.position)) <= NEAR * spread
        same_size = (here.width, here.height) == (there.width, there.height)
        return near and same_size and cosine >= math.cos(TURNED)

    return next((other for other in standard if is_there(other)), None)


def _scaled_photo(renderer: Renderer, view: View, k: int, usual: View, pair: Pair) -> float | None:
    """PSNR of a photo under the standard light, at the exposure that fits best; None without a response."""
    curve = renderer.response_curve()
    if curve is None:
        return None
    far = [abs(math.log(seconds / view.exposures[k])) for seconds in usual.exposures]
    place = far.index(min(far))
    x, y = (part.double().cpu().numpy() for part in curve)
    values = usual.values(place)
    rising = [np.maximum.accumulate(y[:, channel]) for channel in range(3)]
    exposed = [np.interp(values[..., channel], rising[channel], x) for channel in range(3)]

    def score(stops: float) -> float:
        moved = [np.interp(exposed[c] + stops * math.log(2.0), x, rising[c]) for c in range(3)]
        return replace(pair, picture=torch.from_numpy(np.stack(moved))).psnr()

    return _best(score)
