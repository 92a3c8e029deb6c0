# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's evaluation, and ours of relighting: what is rendered, compared and averaged.

LDR: every test view at every exposure, through 8 bit, in PSNR, SSIM and LPIPS; averaged for each exposure,
then LDR-OE over exposure indices 0, 2, 4 (those that training saw) and LDR-NE over 1, 3 (those it did not).
HDR: ``metrics.hdr_pair``, once as it is and once after dividing by the median scale ratio.
Relit: the μ-law PSNR under other ambient light, beside what scaling a picture by the level would give.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
import torch

from ...bridge.errors import BadValueError, DataMismatchError
from ..scene.camera import Camera
from ..scene.scene import Scene, View
from . import truth
from .lpips import SMALLEST_SIDE, Lpips
from .metrics import hdr_pair, psnr, quantise, resize_to, scale_ratio, ssim
from .results import Evaluation, HdrRow, LdrRow, Metrics, RelitRow


class Renderer(Protocol):
    """What is evaluated: a trained model, whichever the method."""

    def hdr(self, camera: Camera, lighting_level: float = 1.0) -> torch.Tensor:
        """``[3, H, W]`` scene-linear radiance at ambient light ``lighting_level``."""
        ...

    def ldr(self, camera: Camera, exposure: float, lighting_level: float = 1.0) -> torch.Tensor:
        """``[3, H, W]`` in 0…1: the picture that the camera would take at ``exposure`` seconds."""
        ...


@torch.no_grad()
def evaluate(
    renderer: Renderer,
    scene: Scene,
    *,
    lpips: Lpips | None = None,
    exposure_mode: str = "unknown",
    progress: Callable[[int, int, str], None] | None = None,
) -> Evaluation:
    """Render and compare the whole test split.

    ``exposure_mode``: how training chose exposures (exp1, exp3), stated beside the numbers. ``progress`` is
    called with (done, total, what is next). Parts for which the data set has no truth are left out, with a
    message. Raises ``DataMismatchError`` without test views, ``BadValueError`` if the model renders NaN, and
    what ``read_png`` and ``read_exr`` raise.
    """
    if not scene.test:
        raise DataMismatchError(
            f"{scene.root} has no test views", "Add transforms_test.json and exposure_test.json."
        )
    started = time.monotonic()
    relit = truth.relit_truth(scene.root)
    messages = _what_is_left_out(scene, lpips, relit)
    camera = scene.test[0].camera
    if min(camera.width, camera.height) < SMALLEST_SIDE:
        lpips = None
    step = _Steps(2 * len(scene.test) + len(relit), progress)

    ldr = []
    for view in scene.test:
        step(f"LDR {view.name}")
        ldr += _ldr_rows(renderer, view, lpips)
    hdr = _hdr_rows(renderer, scene, lpips, step) if truth.has_hdr_truth(scene.root, "test") else []
    relit_rows = []
    for item in relit if truth.has_hdr_truth(scene.root, "test") else []:
        step(f"relit {item.level:g} {item.path.stem}")
        relit_rows.append(_relit_row(renderer, scene, item))
    step.end()
    return Evaluation(
        scene=scene.name,
        split="test",
        exposure_mode=exposure_mode,
        resolution=(camera.width, camera.height),
        ldr=ldr,
        hdr=hdr,
        relit=relit_rows,
        messages=messages,
        seconds=time.monotonic() - started,
    )


class _Steps:
    """Counts what is done for the progress callback."""

    def __init__(self, total: int, progress: Callable[[int, int, str], None] | None) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def __call__(self, what: str) -> None:
        if self._progress is not None:
            self._progress(self._done, self._total, what)
        self._done += 1

    def end(self) -> None:
        if self._progress is not None:
            self._progress(self._total, self._total, "done")


def _what_is_left_out(scene: Scene, lpips: Lpips | None, relit: list[truth.RelitTruth]) -> list[str]:
    messages = []
    camera = scene.test[0].camera
    if lpips is None:
        messages.append("LPIPS left out: no weights were given.")
    elif min(camera.width, camera.height) < SMALLEST_SIDE:
        messages.append(f"LPIPS left out: pictures are smaller than {SMALLEST_SIDE}×{SMALLEST_SIDE}.")
    if not truth.has_hdr_truth(scene.root, "test"):
        messages.append(f"HDR and relit left out: {scene.root / 'test_hdr'} does not exist.")
    elif not relit:
        messages.append(f"Relit left out: {scene.root / 'relit'} holds no level_*/hdr_*.exr.")
    return messages


def _require_finite(picture: torch.Tensor, what: str) -> torch.Tensor:
    """The picture on the CPU; raises ``BadValueError`` on NaN or infinity, which would pass as black."""
    picture = picture.detach().cpu()
    if not bool(torch.isfinite(picture).all()):
        raise BadValueError(
            f"the model renders NaN or infinity: {what}", "Train again, or use a checkpoint before."
        )
    return picture


def _compare(picture: torch.Tensor, reference: torch.Tensor, lpips: Lpips | None) -> Metrics:
    return Metrics(
        psnr(picture, reference),
        ssim(picture, reference),
        lpips(picture, reference) if lpips else None,
        lpips.unscaled(picture, reference) if lpips else None,
    )


def _ldr_rows(renderer: Renderer, view: View, lpips: Lpips | None) -> list[LdrRow]:
    rows = []
    for k, exposure in enumerate(view.exposures):
        picture = renderer.ldr(view.camera, exposure, view.lighting_level)
        picture = quantise(_require_finite(picture, f"{view.name} at {exposure:g} s"))
        # A copy: the cached picture is read-only, which torch cannot represent.
        reference = torch.from_numpy(view.image(k).copy()).permute(2, 0, 1).double() / 255.0
        rows.append(LdrRow(view.name, view.index, k, exposure, _compare(picture, reference, lpips)))
    return rows


def _hdr_rows(renderer: Renderer, scene: Scene, lpips: Lpips | None, step: _Steps) -> list[HdrRow]:
    predictions, truths, ratios = [], [], []
    for view in scene.test:
        step(f"HDR {view.name}")
        prediction = renderer.hdr(view.camera, view.lighting_level)
        predictions.append(_require_finite(prediction, f"{view.name}, HDR"))
        truths.append(truth.hdr_truth(scene.root, "test", view.index))
        ratios.append(scale_ratio(predictions[-1], truths[-1]))
    # One scale for all views: aligning each view by itself would hide that views disagree.
    common = float(np.median(ratios))
    rows = []
    for view, prediction, reference, ratio in zip(scene.test, predictions, truths, ratios, strict=True):
        pair = hdr_pair(prediction, reference)
        metrics = _compare(pair.prediction, pair.truth, lpips)
        usable = math.isfinite(common) and common > 0.0
        aligned = hdr_pair(prediction / common if usable else prediction, reference)
        aligned_metrics = _compare(aligned.prediction, aligned.truth, lpips)
        rows.append(HdrRow(view.name, view.index, pair.normaliser, ratio, metrics, aligned_metrics))
    return rows


def _relit_row(renderer: Renderer, scene: Scene, item: truth.RelitTruth) -> RelitRow:
    view = scene.find("test", item.index)
    relit = item.radiance()
    ours = _require_finite(renderer.hdr(view.camera, item.level), f"{view.name} at level {item.level:g}")
    ours_standard = _require_finite(renderer.hdr(view.camera, 1.0), f"{view.name}, HDR")
    height, width = ours.shape[1:]
    truth_standard = resize_to(truth.hdr_truth(scene.root, "test", item.index), height, width)

    def score(prediction: torch.Tensor) -> float:
        pair = hdr_pair(prediction, relit)
        return psnr(pair.prediction, pair.truth)

    return RelitRow(
        level=item.level,
        view=view.name,
        index=view.index,
        normaliser=hdr_pair(ours, relit).normaliser,
        scale_ratio=scale_ratio(ours, relit),
        ours=score(ours),
        scaled_truth=score(item.level * truth_standard),
        scaled_ours=score(item.level * ours_standard),
    )


def lpips_from(path: Path | str | None) -> Lpips | None:
    """LPIPS with the weights at ``path``; None, and so left out, without one."""
    return None if path is None else Lpips.from_file(Path(path))
