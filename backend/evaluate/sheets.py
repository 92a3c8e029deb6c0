# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that show results: a labelled grid; truth | ours | residual; several methods on one sheet."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ...bridge.data_set import TEST
from ...bridge.errors import BadValueError
from ...bridge.lights import Levels
from ..scene.scene import Scene, View
from . import truth
from .metrics import MU, averaged_to, display, quantise
from .photos import Falloff
from .pictures import Pair, compared_everywhere, pairs, radiance_pair
from .published import data_set_of
from .renderer import Renderer, standard_of
from .residuals import RESIDUAL_GAIN, legend, residual
from .results import OBSERVED_EXPOSURES, VIEWS_OF, part_of

#: Quantile shown as white in HDR pictures. The metrics use the protocol's own normaliser, the maximum.
WHITE_QUANTILE = 0.999
#: If the scale is off by more than this (natural logarithm), HDR is also shown with its scale aligned.
SCALE_OFF = 0.02
#: Cells narrower than this (pixels) are enlarged by an integer factor, so that labels fit and faults show.
SMALLEST_CELL = 240

PAPER, INK, FAINT, FRAME = (255, 255, 255), (24, 24, 28), (96, 96, 104), (200, 200, 206)
TITLE_SIZE, LABEL_SIZE = 26, 17
MARGIN, GAP, LABEL_GAP = 24, 14, 5
#: Pillow's built-in font lacks these.
SPELLED_OUT = {"×": "x", "μ": "mu", "µ": "mu", "σ": "sigma", "–": "-", "—": "-", "−": "-", "→": "->"}
SPELLED_OUT |= {"≥": ">=", "≤": "<=", "¼": "1/4", "½": "1/2", "¾": "3/4", "∞": "inf", "’": "'"}

Cell = tuple[str, np.ndarray]


def labelled_grid(rows: list[list[Cell]], title: str, note: str = "") -> np.ndarray:
    """Pictures in rows and columns, each under its label: ``[H, W, 3]`` uint8, on white.

    A cell is (label, ``[h, w, 3]`` uint8); sizes may differ, rows may have different lengths, and small
    pictures are enlarged without smoothing. ``note``: small text below the title. Raises ``BadValueError``
    for no cells or another kind of picture.
    """
    cells = [[(label, _enlarged(picture, label)) for label, picture in row] for row in rows if row]
    if not cells:
        raise BadValueError("a labelled grid needs at least one picture")
    title_font, label_font = ImageFont.load_default(TITLE_SIZE), ImageFont.load_default(LABEL_SIZE)
    columns = max(len(row) for row in cells)
    widths = [max(row[i][1].shape[1] for row in cells if i < len(row)) for i in range(columns)]
    inner = sum(widths) + GAP * (columns - 1)
    heads = [*((line, title_font, INK) for line in _wrapped(title, title_font, inner))]
    heads += [(line, label_font, FAINT) for line in _wrapped(note, label_font, inner)]
    labels = [[_wrapped(cell[0], label_font, widths[i]) for i, cell in enumerate(row)] for row in cells]

    label_heights = [max(len(lines) for lines in row) * _line_height(label_font) for row in labels]
    picture_heights = [max(cell[1].shape[0] for cell in row) for row in cells]
    head_height = sum(_line_height(font) for _, font, _ in heads) + (GAP if heads else 0)
    height = 2 * MARGIN + head_height + sum(label_heights) + sum(picture_heights)
    height += LABEL_GAP * len(cells) + GAP * (len(cells) - 1)
    sheet = Image.new("RGB", (2 * MARGIN + inner, height), PAPER)
    draw = ImageDraw.Draw(sheet)

    y = MARGIN
    for line, font, colour in heads:
        draw.text((MARGIN, y), line, colour, font)
        y += _line_height(font)
    y += GAP if heads else 0
    for row, row_labels, label_height, picture_height in zip(
        cells, labels, label_heights, picture_heights, strict=True
    ):
        x = MARGIN
        for (_, picture), lines, width in zip(row, row_labels, widths, strict=False):
            # Labels are directly above their picture, even if a neighbour's has more lines.
            top = y + label_height - len(lines) * _line_height(label_font)
            for i, line in enumerate(lines):
                draw.text((x, top + i * _line_height(label_font)), line, INK, label_font)
            corner = (x, y + label_height + LABEL_GAP)
            # A thin frame, because a white picture would merge with the background.
            far = (corner[0] + picture.shape[1], corner[1] + picture.shape[0])
            draw.rectangle((corner[0] - 1, corner[1] - 1, *far), outline=FRAME)
            sheet.paste(Image.fromarray(picture), corner)
            x += width + GAP
        y += label_height + LABEL_GAP + picture_height + GAP
    return np.asarray(sheet)


def _enlarged(picture: np.ndarray, label: str) -> np.ndarray:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise BadValueError(
            f"cell '{label}' of a labelled grid must be [H, W, 3] uint8, got {picture.shape} {picture.dtype}"
        )
    factor = max(1, -(-SMALLEST_CELL // picture.shape[1]))
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def _line_height(font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> int:
    _, top, _, bottom = font.getbbox("Ágj")
    return round(1.25 * (bottom - top))


def _wrapped(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> list[str]:
    """``text`` in lines no wider than ``width`` pixels where words allow it; [] for no text."""
    for glyph, spelled in SPELLED_OUT.items():
        text = text.replace(glyph, spelled)
    lines: list[str] = []
    for word in text.split():
        if lines and font.getlength(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def as_picture(image: torch.Tensor) -> np.ndarray:
    """``[3, H, W]`` in 0…1 as ``[H, W, 3]`` uint8, rounded as the evaluation rounds."""
    return (quantise(image.detach().cpu()) * 255.0).to(torch.uint8).permute(1, 2, 0).numpy()


@dataclass(frozen=True)
class Shown:
    """One renderer's image under one condition, ``[3, H, W]`` in 0…1, and its numbers."""

    picture: torch.Tensor
    reference: torch.Tensor
    psnr: float
    ssim: float


@torch.no_grad()
def comparison_sheet(
    renderer: Renderer,
    scene: Scene,
    poses: list[int] | None = None,
    exposure_indices: tuple[int, ...] = OBSERVED_EXPOSURES,
    gain: float = RESIDUAL_GAIN,
    split: str = TEST,
    hdr: bool = True,
    shows: Callable[[truth.RelitTruth], bool] | None = None,
    name: str = "ours",
    scale: float | None = None,
    falloff: Falloff | None = None,
) -> np.ndarray:
    """Truth | ours | residual for some views of ``split``: LDR rows, HDR rows (μ-law), relit rows; uint8.

    ``poses``: pose numbers; None: one that is not entirely masked, with relit truth if possible, else the
    middle one. Missing exposures and parts without truth have no rows; relit truth exists for test views
    only. ``hdr`` and ``shows`` as for ``evaluate``; ``name``: of the renderer; ``scale``: the evaluation's
    ``scale_ratio``: if it is off, HDR is shown a second time, divided by it; a model of photographs, whose
    unit is free, is divided by it under other light, too. ``falloff``: the evaluation's vignetting, None:
    without. Raises ``BadValueError`` for an unknown pose, and what readers raise.
    """
    can_show = shows or (lambda item: item.can_be_shown(renderer.lights))
    relit, published = _relit(scene, split), bool(data_set_of(scene))
    rows: list[list[Cell]] = []
    for pose in _poses(scene, split, poses, relit):
        view = scene.find(split, pose)
        for k in _positions(view, exposure_indices):
            label = f"{view.name}, {view.exposures[k]:.4g} s"
            rows.append(_row(label, name, _ldr(renderer, view, k, falloff), gain))
        if hdr and truth.has_hdr_truth(scene.root, split):
            reference = truth.hdr_truth(scene.root, split, pose)
            shown = _hdr(renderer, view, None, reference, published=published)
            rows.append(_row(f"{view.name} HDR", name, shown, gain))
            if _is_off(scale):
                shown = _hdr(renderer, view, None, reference, scale, published=published)
                rows.append(_row(f"{view.name} HDR, scale aligned", f"{name} / {scale:.3g}", shown, gain))
        for item in relit:
            if hdr and item.index == pose and can_show(item) and (lit := item.radiance()).max() > 0.0:
                levels = item.levels_of(renderer.lights, standard_of(renderer, scene))
                shown = _hdr(renderer, view, levels, lit, scale if scale and scene.photographs else 1.0)
                rows.append(_row(f"{view.name} {item.condition}", name, shown, gain))
    return labelled_grid(
        [*rows, [legend(SMALLEST_CELL, gain)]], f"{_title(scene, split)}: truth, {name}, residual", _note()
    )


@torch.no_grad()
def method_sheet(
    renderers: Mapping[str, Renderer],
    scene: Scene,
    poses: list[int] | None = None,
    exposure_indices: tuple[int, ...] = (2, 3),
    gain: float = RESIDUAL_GAIN,
    split: str = TEST,
    without_hdr: Collection[str] = (),
    scales: Mapping[str, float | None] | None = None,
    falloffs: Mapping[str, Falloff | None] | None = None,
) -> np.ndarray:
    """Several methods and the truth: each condition is a row of pictures above a row of residuals; uint8.

    ``renderers``: by their name in captions. The conditions are the exposures (by default one seen in
    training and one between) and HDR if there is truth; ``poses`` and ``split`` as in ``comparison_sheet``.
    ``without_hdr``: names of those without radiance; ``scales``: the others' ``scale_ratio``: if one is off,
    HDR is shown a second time, divided by it; ``falloffs``: by name, as ``falloff`` there.
    Raises ``BadValueError`` without a method or for an unknown pose, and what readers raise.
    """
    if not renderers:
        raise BadValueError("a sheet of methods needs at least one method")
    published, through = bool(data_set_of(scene)), falloffs or {}
    rows: list[list[Cell]] = []
    for pose in _poses(scene, split, poses, _relit(scene, split)):
        view = scene.find(split, pose)
        for k in _positions(view, exposure_indices):
            shown = {name: _ldr(each, view, k, through.get(name)) for name, each in renderers.items()}
            rows += _method_rows(f"{view.name}, {_part(view, k)}, {view.exposures[k]:.4g} s", shown, gain)
        if truth.has_hdr_truth(scene.root, split) and renderers.keys() - set(without_hdr):
            reference = truth.hdr_truth(scene.root, split, pose)
            radiant = {name: each for name, each in renderers.items() if name not in without_hdr}
            shown = {
                name: _hdr(renderer, view, None, reference, published=published)
                for name, renderer in radiant.items()
            }
            rows += _method_rows(f"{view.name}, HDR", shown, gain)
            off = {name: by for name, by in (scales or {}).items() if name in radiant and _is_off(by)}
            if off:
                shown = {
                    f"{name} / {off[name]:.3g}" if name in off else name: _hdr(
                        renderer, view, 1.0, reference, off.get(name, 1.0), published=published
                    )
                    for name, renderer in radiant.items()
                }
                rows += _method_rows(f"{view.name}, HDR, scale aligned", shown, gain)
    return labelled_grid(rows, f"{_title(scene, split)}: truth and {len(renderers)} methods", _note())


def _title(scene: Scene, split: str) -> str:
    return scene.name if split == TEST else f"{scene.name}, {VIEWS_OF[split]}"


def _relit(scene: Scene, split: str) -> list[truth.RelitTruth]:
    return truth.relit_truth(scene.root) if split == TEST else []


def _poses(scene: Scene, split: str, poses: list[int] | None, relit: list[truth.RelitTruth]) -> list[int]:
    if poses is not None:
        return poses
    views = scene.splits[split]
    middle = views[len(views) // 2].index
    nearest = sorted((view.index for view in views), key=lambda index: abs(index - middle))
    wanted = [*(item.index for item in relit), *nearest]
    return [next((pose for pose in wanted if _is_compared(scene.find(split, pose))), wanted[0])]


def _is_compared(view: View) -> bool:
    """Whether any pixel is compared in all its pictures."""
    mask = compared_everywhere(view)
    return mask is None or bool(mask.any())


def _positions(view: View, exposure_indices: Sequence[int]) -> list[int]:
    """The positions of these bracket indices in the view's lists, without missing ones."""
    return [view.bracket.index(k) for k in exposure_indices if k in view.bracket]


def _part(view: View, k: int) -> str:
    return part_of(view.bracket[k])


def _ldr(renderer: Renderer, view: View, k: int, falloff: Falloff | None) -> Shown:
    effect = None if falloff is None else falloff(view.camera)
    (pair,) = pairs(renderer, view, [k], effect=effect)
    picture, reference = pair.shown()
    metrics = pair.metrics()
    return Shown(picture, reference, metrics.psnr, metrics.ssim)


def _is_off(scale: float | None) -> TypeGuard[float]:
    return scale is not None and 0.0 < scale < math.inf and abs(math.log(scale)) > SCALE_OFF


def _hdr(
    renderer: Renderer,
    view: View,
    level: Levels | None,
    reference: torch.Tensor,
    divided_by: float = 1.0,
    *,
    published: bool = False,
) -> Shown:
    """Numbers as in the protocol; the pictures are brighter, see ``WHITE_QUANTILE``."""
    at = () if level is None else (level,)
    radiance = renderer.hdr(view.camera, *at).detach().cpu() / divided_by
    mask = compared_everywhere(view)
    metrics = radiance_pair(radiance, reference, mask, published=published).metrics()
    white = display_white(reference)
    true = averaged_to(reference, radiance.shape[1], radiance.shape[2])
    pictures = Pair(quantise(display(radiance, white)), quantise(display(true, white)), mask).shown()
    return Shown(*pictures, metrics.psnr, metrics.ssim)


def display_white(radiance: torch.Tensor) -> float:
    """The radiance shown as white: a high percentile, because a bare bulb would leave the rest black."""
    flat = radiance.flatten().double()
    return max(float(torch.quantile(flat[:: max(1, flat.numel() // 1_000_000)], WHITE_QUANTILE)), 1e-6)


def _row(label: str, name: str, shown: Shown, gain: float) -> list[Cell]:
    return [
        (f"{label}: truth", as_picture(shown.reference)),
        (f"{name}, {_numbers(shown)}", as_picture(shown.picture)),
        (f"residual × {gain:g}", residual(shown.picture, shown.reference, gain)),
    ]


def _method_rows(label: str, shown: dict[str, Shown], gain: float) -> list[list[Cell]]:
    """A row of pictures with their numbers, and below it the legend and their residuals."""
    reference = as_picture(next(iter(shown.values())).reference)
    pictures: list[Cell] = [(f"{label}: truth", reference)]
    residuals: list[Cell] = [legend(max(SMALLEST_CELL, reference.shape[1]), gain)]
    for name, each in shown.items():
        pictures.append((f"{name}: {_numbers(each)}", as_picture(each.picture)))
        residuals.append((f"{name}: residual × {gain:g}", residual(each.picture, each.reference, gain)))
    return [pictures, residuals]


def _numbers(shown: Shown) -> str:
    if math.isnan(shown.psnr):
        return "masked, not compared"
    return f"{shown.psnr:.2f} dB, SSIM {shown.ssim:.4f}"


def _note() -> str:
    return (
        "residual: the worst channel's absolute difference; HDR and relit pictures and residuals: μ-law, "
        f"μ = {MU:g}, white is the {100.0 * WHITE_QUANTILE:g}th percentile of the truth; their numbers are "
        "the protocol's, whose white is the maximum"
    )
