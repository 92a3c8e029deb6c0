# SPDX-License-Identifier: GPL-3.0-or-later
"""A fixed held-out view, measured while training. What it sees is shown and logged, never learned from."""

import math
from collections.abc import Callable

from ...bridge.data_set import TEST, VALIDATION
from ...bridge.errors import PhysHDRError
from ..evaluate.metrics import scale_ratio
from ..evaluate.pictures import compared_everywhere, pairs
from ..evaluate.truth import hdr_truth
from ..methods.base import Method
from ..scene import Scene
from ..train.trainer import Monitor
from .terminal import aside


def view_monitor(scene: Scene, report: Callable[[str], object] = aside.print) -> Monitor | None:
    """PSNR of a middle view at its middle exposure and, where the truth is there, the HDR scale.

    It is a validation view where there are any, so that watching a training tells nothing of the test views,
    else a test view. ``None`` where the data set has neither. Where it cannot be measured, be its picture
    damaged, ``report`` is told so once, and nothing is measured from then on: training does not need it.
    What is no number, as where all of the view is masked or black, is left out.
    """
    split = VALIDATION if scene.validation else TEST
    views = scene.splits[split]
    if not views:
        return None
    view = views[len(views) // 2]
    k = len(view.exposures) // 2
    try:
        truth = hdr_truth(scene.root, split, view.index)
    except PhysHDRError:
        truth = None  # shown only if it is there; evaluation says what is wrong with it

    def measure(method: Method) -> dict[str, float]:
        (pair,) = pairs(method, view, [k], rounded=False)
        measured = {"PSNR": pair.psnr()}
        if truth is not None:
            drawn = method.hdr(view.camera, view.lighting_level).cpu()
            measured["HDR scale"] = scale_ratio(drawn, truth, compared_everywhere(view))
        return {name: value for name, value in measured.items() if math.isfinite(value)}

    has_failed = False

    def measure_while_possible(method: Method) -> dict[str, float]:
        nonlocal has_failed
        if has_failed:
            return {}
        try:
            return measure(method)
        except PhysHDRError as error:
            has_failed = True
            report(f"training goes on, but view {view.name} is not measured any more: {error}")
            return {}

    return measure_while_possible
