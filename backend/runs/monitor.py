# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures a fixed held-out view during training. Results are shown and logged, never learned from."""

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
    """PSNR of a middle view at its middle exposure and, if the truth exists, the HDR scale.

    A validation view if there are any, so that watching a training reveals nothing about test views, else a
    test view; ``None`` if the data set has neither. If measuring fails, for example because its picture is
    damaged, this is reported once and measuring stops, because training does not need it. NaN, for example
    for an entirely masked or black view, is omitted.
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
        truth = None  # optional here; evaluation reports what is wrong with it

    def measure(method: Method) -> dict[str, float]:
        (pair,) = pairs(method, view, [k], rounded=False)
        measured = {"PSNR": pair.psnr()}
        if truth is not None:
            drawn = method.hdr(view.camera).cpu()
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
            report(f"no longer measuring view {view.name} during training: {error}")
            return {}

    return measure_while_possible
