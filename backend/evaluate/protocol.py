# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's evaluation, and ours of relighting: what is rendered, compared and averaged.

The views are those of one split: the test views, or the validation views.
LDR: every view at every exposure, in 8 bit, by PSNR, SSIM and LPIPS (``pictures.py`` also handles radiance
and masks); averaged for each exposure, then LDR-OE over exposure indices 0, 2, 4 (seen in training) and
LDR-NE over 1, 3 (not seen), alternating on in longer brackets.
HDR: ``metrics.hdr_pair``, both unchanged and divided by the median scale ratio, over the pixels compared in
all pictures of a view.
Relit: the μ-law PSNR under other light, and that of merely scaled pictures (``results.RelitRow``).
Lit: photos under other light that were left out (``lit_photos``).
The PSNR of a picture is at most ``metrics.PSNR_CAP``, 100 dB; a message says where it was reached.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from ...bridge.data_set import HELD_OUT, TEST, VALIDATION
from ...bridge.errors import BadValueError, DataMismatchError
from ..scene.scene import Scene, View
from . import truth
from .geometry import geometry_rows, views_with_surface
from .linearity import Values, compared_values, linearity
from .lit_photos import can_be_compared, lit_rows
from .lpips import SMALLEST_SIDE, Lpips
from .metrics import PSNR_CAP, averaged_to, display, hdr_normaliser, hdr_shown, quantise, scale_ratio
from .photos import Falloff, falloff_there, fitted_photos, no_falloff
from .pictures import Pair, all_of_eight_bits, compared_everywhere, finite, notes_on, pairs, radiance_pair
from .published import data_set_of
from .renderer import Renderer, standard_of
from .response import check_response, learned_response, true_response
from .results import (
    NOVEL,
    OBSERVED,
    OBSERVED_EXPOSURES,
    VIEWS_OF,
    Evaluation,
    HdrRow,
    LdrRow,
    Metrics,
    RelitRow,
    middle_ratio,
    part_of,
)


@torch.no_grad()
def evaluate(
    renderer: Renderer,
    scene: Scene,
    *,
    split: str = TEST,
    lpips: Lpips | None = None,
    exposure_mode: str = "unknown",
    training_exposures: Sequence[int] | None = None,
    iteration: int | None = None,
    iterations: int | None = None,
    progress: Callable[[int, int, str], None] | None = None,
    falloff: Falloff | None = None,
    hdr: bool = True,
    shows: Callable[[truth.RelitTruth], bool] | None = None,
) -> Evaluation:
    """Render and compare every view of ``split``: the test views, or the validation views (``val``).

    No file of the other split is opened; relit truth exists for test views only. ``exposure_mode``: how
    training chose exposures (exp1, exp3), for the report. ``training_exposures``: the exposure indices it
    chose from, None: unknown; a message reports if LDR-OE and LDR-NE do not match them. ``iteration``: the
    evaluated one of the planned ``iterations``; None: unknown. ``progress`` is called with (done, total, the
    next step). ``falloff``: the learned vignetting of the lens, used if these pictures have it; gain and
    white balance are then also fitted (``photos.py``). For pictures of another program (``PictureFolder``),
    ``hdr`` says whether radiance is included, and ``shows`` whether it is for a mix of lights; default:
    whatever the renderer has levels for.
    Parts without truth are skipped, with a message. Raises ``DataMismatchError`` without views in the split,
    ``BadValueError`` for a training split, if the model renders NaN or ``dataset.json`` states an invalid
    response, and what ``read_codes`` and ``read_exr`` raise.
    """
    views = _views_of(scene, split)
    started = time.monotonic()
    relit = truth.relit_truth(scene.root) if split == TEST else []
    can_show = shows or (lambda item: item.can_be_shown(renderer.lights))
    unknown = [item for item in relit if not can_show(item)]
    why = "the model has no level for a light of it" if shows is None else "no pictures of it were given"
    messages = [*renderer.remarks, *_skipped(scene, split, lpips, hdr, relit, unknown, why)]
    messages += notes_on(views)
    places = {k for view in views for k in view.bracket}
    messages += _notes_on_training(training_exposures, places, iteration, iterations)
    relit = [item for item in relit if item not in unknown]
    camera = views[0].camera
    if _smallest_side(views) < SMALLEST_SIDE:
        lpips = None
    compares_lit = split == TEST and bool(scene.lit_test) and can_be_compared(renderer, scene)
    count = (2 if falloff is None else 3) * len(views) + len(relit) + len(views_with_surface(scene, split))
    step = _Steps(count + (len(scene.lit_test) if compares_lit else 0), progress)

    # Before rendering, which takes long: the response in dataset.json may be invalid.
    learned = learned_response(renderer)
    response = None if learned is None else check_response(learned, true_response(scene, learned, split))
    ldr = []
    falloff_used = falloff is not None and falloff_there(renderer, views, falloff)
    if falloff is not None and not falloff_used:
        messages.append("Training found vignetting, which these pictures do not have: compared without.")
        falloff = no_falloff
    elif falloff is not None:
        messages.append("Pictures are compared with the vignetting that training found of their lens.")
    for view in views:
        step(f"LDR {view.name}")
        ldr += _ldr_rows(renderer, view, lpips, falloff)
    if falloff is not None:
        fitted = fitted_photos(renderer, views, falloff, step)
        messages += [] if fitted is None else [str(fitted)]
    hdr_rows: list[HdrRow] = []
    standard: dict[int, _StandardView] = {}
    relit_rows: list[RelitRow] = []
    if hdr and truth.has_hdr_truth(scene.root, split):
        standard = _standard_views(renderer, scene, split, step)
        hdr_rows = _hdr_rows(standard, lpips, published=bool(data_set_of(scene)))
        messages += _without_scale(hdr_rows)
        # The unit of radiance is free where photographs are trained from: one scale for all, found under the
        # standard light alone, so that no lamp is helped by it.
        scale = middle_ratio([row.scale_ratio for row in hdr_rows]) if scene.photographs else 1.0
        for item in relit:
            step(f"relit {item.condition} {item.path.stem}")
            view = scene.find(TEST, item.index)  # its error lists the poses
            if item.index not in standard:
                continue  # entirely masked
            levels = item.levels_of(renderer.lights, standard_of(renderer, scene))
            if row := _relit_row(renderer, standard[item.index], item, levels, scale or 1.0):
                relit_rows.append(row)
            else:
                messages.append(f"Relit {item.condition} of {view.name} left out: its truth is black.")
    lit = lit_rows(renderer, scene, falloff, step) if compares_lit else []
    if split == TEST and scene.lit_test and not compares_lit:
        messages.append("Photos under other light left out: the model has no levels for their lights.")
    geometry = geometry_rows(renderer, scene, split, step)
    step.end()
    messages += _capped(ldr, hdr_rows, relit_rows)
    return Evaluation(
        scene=scene.name,
        split=split,
        exposure_mode=exposure_mode,
        training_exposures=None if training_exposures is None else tuple(training_exposures),
        resolution=(camera.width, camera.height),
        ldr=ldr,
        hdr=hdr_rows,
        relit=relit_rows,
        messages=messages,
        seconds=time.monotonic() - started,
        data_set=data_set_of(scene) if split == TEST else "",
        response=response,
        iteration=iteration,
        iterations=iterations,
        eight_bit=all_of_eight_bits(views),
        falloff_used=falloff_used,
        lit=lit,
        linearity=linearity([_compared(each) for each in standard.values()]),
        geometry=geometry,
    )


def _views_of(scene: Scene, split: str) -> list[View]:
    """The views of a split that can be evaluated; raises as ``evaluate``."""
    if split not in HELD_OUT:
        raise BadValueError(
            f"the split '{split}' cannot be evaluated: it is for training, or does not exist",
            f"Choose from {', '.join(HELD_OUT)}.",
        )
    if not scene.splits[split]:
        remedy = "Add transforms_test.json and exposure_test.json."
        if scene.validation:
            remedy = "Evaluate the validation views: --split val. Tuning plans have no access to test views."
        if split == VALIDATION:
            remedy = "make_scene.py --validation-views N renders some; or evaluate the test views."
        raise DataMismatchError(f"{scene.root} has no {VIEWS_OF[split]}", remedy)
    return scene.splits[split]


def _smallest_side(views: Sequence[View]) -> int:
    """In pixels. LPIPS is skipped for all views if one is too small, because means must cover all views."""
    return min(min(view.camera.width, view.camera.height) for view in views)


class _Steps:
    """Counts steps for the progress callback."""

    def __init__(self, total: int, progress: Callable[[int, int, str], None] | None) -> None:
        self._total, self._done, self._progress = total, 0, progress

    def __call__(self, what: str) -> None:
        if self._progress is not None:
            self._progress(self._done, self._total, what)
        self._done += 1

    def end(self) -> None:
        if self._progress is not None:
            self._progress(self._total, self._total, "done")


def _skipped(
    scene: Scene,
    split: str,
    lpips: Lpips | None,
    hdr: bool,
    relit: list[truth.RelitTruth],
    unknown: list[truth.RelitTruth],
    why: str,
) -> list[str]:
    messages = []
    if lpips is None:
        messages.append("LPIPS left out: no weights were given.")
    elif _smallest_side(scene.splits[split]) < SMALLEST_SIDE:
        messages.append(f"LPIPS left out: there are pictures smaller than {SMALLEST_SIDE}×{SMALLEST_SIDE}.")
    if not truth.has_hdr_truth(scene.root, split):
        messages.append(
            f"HDR and relit left out: {scene.root} has no true radiance of its {VIEWS_OF[split]}."
        )
    elif not hdr:
        messages.append("HDR and relit left out: no HDR pictures were given.")
    elif split != TEST:
        messages.append(f"Relit left out: relit truth is of test views alone, not of {VIEWS_OF[split]}.")
    elif not relit:
        messages.append(f"Relit left out: {scene.root / 'relit'} holds no hdr_*.exr.")
    elif unknown:
        conditions = ", ".join(dict.fromkeys(item.condition for item in unknown))
        messages.append(f"Relit left out, because {why}: {conditions}.")
    return messages


def _notes_on_training(
    exposures: Sequence[int] | None, places: set[int], iteration: int | None, iterations: int | None
) -> list[str]:
    """Notes if training did not follow the protocol or is incomplete.

    ``places``: those in the bracket that the evaluated views have.
    """
    messages = []
    if exposures is None:
        exposures = OBSERVED_EXPOSURES
    given = f"(--training-exposures {' '.join(map(str, exposures))})"
    if seen := [str(k) for k in sorted(places) if part_of(k) == NOVEL and k in exposures]:
        messages.append(f"LDR-NE is not of novel exposures: training saw index {' and '.join(seen)} {given}.")
    if unseen := [str(k) for k in sorted(places) if part_of(k) == OBSERVED and k not in exposures]:
        messages.append(
            f"LDR-OE is not of observed exposures: training did not see index {' and '.join(unseen)} {given}."
        )
    if iteration is not None and iterations is not None and iteration < iterations:
        messages.append(f"The training is not complete: {iteration} of {iterations} iterations.")
    return messages


def _without_scale(rows: list[HdrRow]) -> list[str]:
    black = [row.view for row in rows if not math.isfinite(row.scale_ratio)]
    if not black:
        return []
    return [
        f"The HDR scale is that of the other views: the truth of {', '.join(black)} is black wherever it is "
        "compared."
    ]


def _capped(ldr: list[LdrRow], hdr: list[HdrRow], relit: list[RelitRow]) -> list[str]:
    relit_numbers = [(row.ours, row.scaled_truth, row.scaled_ours, row.best_scaled_truth) for row in relit]
    parts = {
        "LDR": [row.metrics.psnr for row in ldr],
        "HDR": [row.metrics.psnr for row in hdr],
        "HDR, scale aligned": [row.aligned.psnr for row in hdr],
        "relit": [number for row in relit_numbers for number in row],
    }
    capped = [part for part, numbers in parts.items() if PSNR_CAP in numbers]
    if not capped:
        return []
    return [
        f"PSNR is capped at {PSNR_CAP:g} dB, which was reached in {'; '.join(capped)}: pictures (almost) "
        "equal to the truth."
    ]


def _ldr_rows(renderer: Renderer, view: View, lpips: Lpips | None, falloff: Falloff | None) -> list[LdrRow]:
    rows = []
    effect = None if falloff is None else falloff(view.camera)
    for k, pair in enumerate(pairs(renderer, view, effect=effect)):
        if pair.mask is None or pair.mask.any():
            metrics = pair.metrics(lpips)
            rows.append(LdrRow(view.name, view.index, view.bracket[k], view.exposures[k], metrics))
    return rows


@dataclass(frozen=True)
class _StandardView:
    """A view under the standard light: the model's render and the truth ``[3, H, W]``.

    ``mask``: which pixels are compared, ``[H, W]`` bool; None: all.
    """

    view: View
    prediction: torch.Tensor
    truth: torch.Tensor
    mask: torch.Tensor | None


def _standard_views(renderer: Renderer, scene: Scene, split: str, step: _Steps) -> dict[int, _StandardView]:
    """By pose, without entirely masked ones: rendered and read once, for the HDR and relit rows."""
    views = {}
    for view in scene.splits[split]:
        step(f"HDR {view.name}")
        mask = compared_everywhere(view)
        if mask is None or mask.any():
            prediction = finite(renderer.hdr(view.camera), f"{view.name}, HDR")
            true = truth.hdr_truth(scene.root, split, view.index)
            views[view.index] = _StandardView(view, prediction, true, mask)
    return views


def _compared(each: _StandardView) -> Values:
    return compared_values(each.prediction, each.truth, each.mask)


def _hdr_rows(standard: dict[int, _StandardView], lpips: Lpips | None, *, published: bool) -> list[HdrRow]:
    def measured(each: _StandardView, prediction: torch.Tensor) -> Metrics:
        return radiance_pair(prediction, each.truth, each.mask, published=published).metrics(lpips)

    views = list(standard.values())
    ratios = [scale_ratio(each.prediction, each.truth, each.mask) for each in views]
    # One scale for all views: aligning each by itself would hide disagreement between views.
    common = middle_ratio(ratios)
    rows = []
    for each, ratio in zip(views, ratios, strict=True):
        metrics = measured(each, each.prediction)
        aligned = measured(each, each.prediction / common if common else each.prediction)
        normaliser = hdr_normaliser(each.truth)
        own = linearity([_compared(each)])
        slope = math.nan if own is None else own.slope
        rows.append(HdrRow(each.view.name, each.view.index, normaliser, ratio, metrics, aligned, slope))
    return rows


def _relit_row(
    renderer: Renderer,
    standard: _StandardView,
    item: truth.RelitTruth,
    levels: tuple[float, ...],
    scale: float,
) -> RelitRow | None:
    """None if the truth is black, as with every light off: there is nothing to normalise by.

    ``levels``: of the renderer's lights; ``scale``: the renderer's radiance over the truth's.
    """
    view, mask, relit = standard.view, standard.mask, item.radiance()
    if not relit.max() > 0.0:
        return None
    ours = renderer.hdr(view.camera, levels)
    ours = finite(ours, f"{view.name} at {item.condition}") / scale
    height, width = ours.shape[1:]
    truth_standard = averaged_to(standard.truth, height, width)
    best_factor = scale_ratio(averaged_to(relit, height, width), truth_standard, mask)
    if math.isnan(best_factor):
        best_factor = 1.0  # the compared truth is black, and stays so with any factor
    changed = list(item.changed.values())
    # Not 0, for a light switched off: the whole picture would be black.
    factor = changed[0] if len(changed) == 1 and changed[0] > 0.0 else best_factor

    shown, normaliser = hdr_shown(relit, height, width)
    left = None
    if changed == [0.0]:
        left = _light_left(ours, averaged_to(relit, height, width), truth_standard, mask)

    def score(prediction: torch.Tensor) -> float:
        return Pair(quantise(display(prediction, normaliser)), shown, mask).psnr()

    return RelitRow(
        levels=item.levels,
        view=view.name,
        index=view.index,
        normaliser=normaliser,
        scale_ratio=scale_ratio(ours, relit, mask),
        ours=score(ours),
        scaled_truth=(scaled_truth := score(factor * truth_standard)),
        scaled_ours=score(factor / scale * standard.prediction),
        best_scaled_truth=scaled_truth if factor == best_factor else score(best_factor * truth_standard),
        factor=factor,
        best_factor=best_factor,
        light_left=left,
    )


def _light_left(
    ours: torch.Tensor, off: torch.Tensor, on: torch.Tensor, mask: torch.Tensor | None
) -> float | None:
    """How much of a light that is off remains in ``ours``, as a share of it; negative: too much was taken.

    ``off``, ``on``: true radiance without it and with it, ``[3, H, W]``. The median over the values at least
    half of which are that light's (elsewhere errors of other light would be divided by next to nothing);
    None where there are none.
    """
    light = on - off
    counted = (light >= 0.5 * on) & (on > 0.0)
    if mask is not None:
        counted &= mask
    if not counted.any():
        return None
    return float(((ours - off)[counted] / light[counted]).median())


def lpips_from(path: Path | str | None) -> Lpips | None:
    """LPIPS with the weights at ``path``; None (LPIPS is skipped) without one."""
    return None if path is None else Lpips.from_file(Path(path))
