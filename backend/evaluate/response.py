# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares a learned camera response with the true one: numbers and a figure.

A response maps exposure × radiance (absolute: seconds × scene-linear radiance) to a code value in 0…1. If a
data set has true radiance, its pictures show the true response, whatever its formula: the codes of pixels of
equal exposure × radiance. A shift of the learned curve along its logarithmic axis is an error of the
radiance's absolute scale.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.data_set import TEST
from ...bridge.errors import BadValueError
from ...bridge.srgb import to_srgb
from ..optional import needed
from ..scene.encoding import eight_bits
from ..scene.scene import Scene
from . import truth
from .linearity import Linearity
from .metrics import averaged_to
from .renderer import Renderer
from .results import VIEWS_OF, ResponseCheck

#: Pixels are collected in bins of this many stops between these ends; a bin needs this many values.
BIN_STOPS, BIN_ENDS, BIN_VALUES = 0.25, (-16.0, 16.0), 50
#: Range of informative codes: below is noise and black, above white.
TELLING = (0.02, 0.98)
#: A fall smaller than this (of 1) is rounding: a thousandth of a step of 8 bit.
FALL_TOLERANCE = 1e-3 / 255.0
#: Names and colours of the channels in the figure.
CHANNELS = {"red": "#c8372d", "green": "#2c8c3c", "blue": "#2b5fc0"}


@dataclass(frozen=True, eq=False)
class Curve:
    """``exposure`` ``[M]``, rising: exposure × radiance. ``code`` ``[M, 3]``: 0…1, NaN where unknown."""

    exposure: np.ndarray
    code: np.ndarray


def learned_response(method: Renderer) -> Curve | None:
    """The curve of ``method.response_curve()``, (ln(exposure × radiance) ``[M]``, LDR ``[M, 3]``).

    None if the method has none, or did not learn it.
    Raises ``BadValueError`` for other shapes, NaN, or falling exposures.
    """
    curve = method.response_curve() if method.learns_response else None
    if curve is None:
        return None
    log_exposure, code = (part.detach().cpu().double().numpy() for part in curve)
    sound = code.shape == (len(log_exposure), 3) and len(code) > 1 and (np.diff(log_exposure) > 0).all()
    if not sound or not (np.isfinite(code).all() and np.isfinite(log_exposure).all()):
        raise BadValueError(
            f"a response curve must be finite [M] rising and [M, 3], got {log_exposure.shape}, {code.shape}",
            "Train again, or use an earlier checkpoint.",
        )
    return Curve(np.exp(log_exposure), code)


# ---- the true response -------------------------------------------------------------------------------


def stated_response(info: dict[str, Any]) -> Callable[[np.ndarray], np.ndarray] | None:
    """The curve in ``dataset.json``, by a formula or by its points; None if it states none.

    It does not include noise, white balance, vignetting, wrong exposures, or a camera's local response
    (``true_response``).
    Raises ``BadValueError`` for a curve that is not a list of pairs with rising first numbers.
    """
    match info.get("response"):
        case {"curve": points} if points is not None:
            x, code = _columns(points)
            if x[0] > 0.0:  # as synth/response.py has it
                x, code = np.insert(x, 0, 0.0), np.insert(code, 0, 0.0)
            return lambda exposure: np.interp(exposure, x, code)
        case {"name": "reinhard-gamma"}:
            return lambda exposure: (exposure / (1.0 + exposure)) ** (1.0 / 2.2)
        case {"name": "srgb"}:
            return lambda exposure: to_srgb(np.minimum(exposure, 1.0))
    return None


def _columns(points: Any) -> tuple[np.ndarray, np.ndarray]:
    """exposure × radiance ``[N]``, rising, and code ``[N]`` of a curve in ``dataset.json``."""
    try:
        columns = np.array(points, np.float64).T
    except (TypeError, ValueError, OverflowError):  # text, or rows of different lengths
        columns = np.empty(0)
    sound = columns.ndim == 2 and len(columns) == 2 and bool(np.isfinite(columns).all())
    if not sound or not (np.diff(columns[0]) > 0.0).all():
        raise BadValueError(
            "the response's 'curve' in dataset.json is not a list of [exposure × radiance, code] whose first "
            "number rises",
            "Give pairs of finite numbers in rising order, or remove 'curve' from dataset.json.",
        )
    return columns[0], columns[1]


def measured_response(scene: Scene, split: str = TEST) -> Curve | None:
    """The response measured in the pictures of ``split``: the median code of pixels in each bin of exposure.

    From 8-bit codes (the upper 8 of 16) of a camera's pictures against exposure × true radiance, each channel
    by itself. None without true radiance of that split. Opens no other split.
    Raises what ``read_codes`` and ``read_exr`` raise.
    """
    views = scene.splits[split]
    if not views or not truth.has_hdr_truth(scene.root, split):
        return None
    bins = round((BIN_ENDS[1] - BIN_ENDS[0]) / BIN_STOPS) + 1
    counts = np.zeros((3, bins * 256), np.int64)
    for view in views:
        radiance = truth.hdr_truth(scene.root, split, view.index)
        radiance = averaged_to(radiance, view.camera.height, view.camera.width).numpy().reshape(3, -1)
        stops = np.log2(np.maximum(radiance, 1e-12))
        for k, exposure in enumerate(view.exposures):
            if view.encodings[k].is_known:
                continue
            at = np.rint((stops + (np.log2(exposure) - BIN_ENDS[0])) / BIN_STOPS).astype(np.int32)
            codes, mask = eight_bits(view.image(k)).reshape(-1, 3), view.mask(k)
            for c in range(3):
                inside = (at[c] >= 0) & (at[c] < bins)
                if mask is not None:
                    inside &= mask.reshape(-1)
                counts[c] += np.bincount(256 * at[c][inside] + codes[inside, c], minlength=bins * 256)
    code = np.stack([_medians(each.reshape(bins, 256)) for each in counts], axis=1)
    known = np.isfinite(code).any(axis=1)
    exposure = 2.0 ** (BIN_ENDS[0] + BIN_STOPS * np.arange(bins))
    return Curve(exposure[known], code[known]) if known.any() else None


def _medians(counts: np.ndarray) -> np.ndarray:
    """The median code (0…1) of each row of ``[B, 256]`` counts of codes; NaN for too few pixels."""
    below, total = counts.cumsum(axis=1), counts.sum(axis=1, keepdims=True)
    # The mean of the lower and the upper median: the first codes that reach, and pass, half the pixels.
    lower, upper = (2 * below >= total).argmax(axis=1), (2 * below > total).argmax(axis=1)
    return np.where(total[:, 0] >= BIN_VALUES, 0.5 * (lower + upper) / 255.0, np.nan)


def true_response(scene: Scene, learned: Curve, split: str = TEST) -> Curve | None:
    """The stated response at the learned curve's exposures, else the one that ``split`` shows, else None.

    A camera's local response depends on the pixels around: what one curve can be of it, its pictures show.
    Other faults of a camera are no part of the response, but of its pictures, which would show both as one.
    """
    camera = scene.info.get("camera_model")
    is_local = isinstance(camera, dict) and bool(camera.get("local_response"))
    stated = None if is_local else stated_response(scene.info)
    if stated is None:
        return measured_response(scene, split)
    return Curve(learned.exposure, np.repeat(stated(learned.exposure)[:, None], 3, axis=1))


# ---- the check and the figure ------------------------------------------------------------------------


def check_response(learned: Curve, true: Curve | None) -> ResponseCheck:
    """Whether the learned curve rises, and how far it is from the true one."""
    fall = np.maximum.accumulate(learned.code, axis=0) - learned.code
    largest_fall = 255.0 * float(fall.max()) if fall.max() > FALL_TOLERANCE else 0.0
    if true is None:
        return ResponseCheck(largest_fall)
    rms, largest, log_ratios = [], [], []
    log_learned = np.log(learned.exposure)
    for c in range(3):
        telling = (true.code[:, c] >= TELLING[0]) & (true.code[:, c] <= TELLING[1])
        telling &= (true.exposure >= learned.exposure[0]) & (true.exposure <= learned.exposure[-1])
        if not telling.any():
            continue
        at, code = np.log(true.exposure[telling]), true.code[telling, c]
        error = 255.0 * np.abs(np.interp(at, log_learned, learned.code[:, c]) - code)
        rms.append(float(np.sqrt(np.mean(error**2))))
        largest.append(float(error.max()))
        rising = np.maximum.accumulate(learned.code[:, c])
        reached = (code > rising[0]) & (code < rising[-1])
        log_ratios.append((np.interp(code, rising, log_learned) - at)[reached])
    if not rms:
        return ResponseCheck(largest_fall)
    ratios = np.concatenate(log_ratios)
    scale = float(np.exp(np.median(ratios))) if ratios.size else None
    return ResponseCheck(largest_fall, max(rms), max(largest), scale)


def write_response_figure(
    path: Path, learned: Curve, scene: Scene, split: str = TEST, linearity: Linearity | None = None
) -> ResponseCheck:
    """Plot the learned response of each channel, the true one and the anchor into ``path`` (.png).

    ``split``: measures the true one. ``linearity``: plotted below, because a wrong response and
    wrong radiance hide each other in the pictures.
    Returns the check. Raises ``PackageMissingError`` without matplotlib, ``OutputError``, and what reading
    the data set raises.
    """
    figures = needed("matplotlib.figure", "matplotlib", "the figure of the response")
    true = true_response(scene, learned, split)
    check = check_response(learned, true)
    measured = measured_response(scene, split)
    heights = [3.0, *([1.0] if true is not None else []), *([1.2] if linearity is not None else [])]
    figure = figures.Figure(figsize=(7.2, 1.4 + 1.1 * sum(heights)), dpi=150, layout="constrained")
    panels = figure.subplots(len(heights), squeeze=False, height_ratios=heights)
    curves = panels[: 1 if true is None else 2, 0]
    upper = curves[0]
    if measured is not None:
        upper.plot(measured.exposure, measured.code, ".", color="0.72", ms=3.5, zorder=1)
        upper.plot([], [], ".", color="0.72", label=f"the data: median code in the {VIEWS_OF[split]}")
    if true is not None and true.exposure is learned.exposure:
        upper.plot(true.exposure, true.code[:, 0], "--", color="black", lw=1.2, label="true", zorder=4)
    for c, (name, colour) in enumerate(CHANNELS.items()):
        upper.plot(learned.exposure, learned.code[:, c], color=colour, lw=1.6, label=f"learned, {name}")
        if true is not None:
            error = np.interp(true.exposure, learned.exposure, learned.code[:, c]) - true.code[:, c]
            curves[1].plot(true.exposure, 255.0 * error, color=colour, lw=1.2)
    if scene.response_anchor is not None:
        exposure, code = scene.response_anchor
        label = f"anchor: {code:.3f} at {exposure:g}"
        upper.plot([exposure], [code], "*", color="#e0a000", mec="black", ms=13, label=label, zorder=5)
    for axes in curves:
        axes.set_xscale("log", base=2)
        axes.set_xlim(*_shown(learned, measured))
    upper.set_ylim(-0.02, 1.02)
    upper.set_ylabel("code value (8-bit pixel / 255)")
    if true is not None:
        curves[1].axhline(0.0, color="black", lw=0.8)
        curves[1].set_ylabel("learned − true\n(1/255)")
    upper.set_title(scene.name + "\n" + str(check).replace("; ", "\n", 1), fontsize=8, loc="left")
    upper.legend(fontsize=8, loc="upper left")
    for axes in panels[:, 0]:
        axes.grid(alpha=0.25)
    curves[-1].set_xlabel("exposure × radiance (seconds × scene-linear units, absolute)")
    if linearity is not None:
        _plot_ratios(panels[-1, 0], linearity)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")
    return check


def _plot_ratios(axes: Any, linearity: Linearity) -> None:
    ratios = [each.ratio for each in linearity.bins]
    axes.plot([each.truth for each in linearity.bins], ratios, "o-", color="0.2")
    axes.axhline(1.0, color="black", lw=0.8)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log", base=2)
    axes.set_ylim(min(0.5, *ratios), max(2.0, *ratios))
    axes.set_ylabel("prediction / truth")
    axes.set_xlabel(f"true radiance; slope {linearity.slope:.3f}")


def _shown(learned: Curve, measured: Curve | None) -> tuple[float, float]:
    """The range to plot: that of the data, or where the learned curve is neither black nor white."""
    if measured is not None:
        return float(measured.exposure[0]), float(measured.exposure[-1])
    mean = learned.code.mean(axis=1)
    telling = learned.exposure[(mean > 0.005) & (mean < 0.995)]
    ends = telling if telling.size > 1 else learned.exposure
    return float(ends[0]), float(ends[-1])
