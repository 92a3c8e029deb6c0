# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that show results: a labelled grid, and the comparison sheet truth | ours | residual."""

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from ...bridge.errors import BadValueError
from ...bridge.lights import Levels
from ..scene.scene import Scene, View
from . import truth
from .metrics import MU, display, hdr_pair, psnr, quantise, resize_to
from .protocol import Renderer

#: Residuals are shown this many times too bright: 1/8 of the range is white.
RESIDUAL_GAIN = 8.0
#: What is shown as white in HDR pictures. The metrics keep the protocol's own normaliser, the maximum.
WHITE_QUANTILE = 0.999
#: Cells narrower than this (pixels) are enlarged by a whole factor, so that labels fit and faults show.
SMALLEST_CELL = 240

PAPER, INK, FAINT, FRAME = (255, 255, 255), (24, 24, 28), (96, 96, 104), (200, 200, 206)
TITLE_SIZE, LABEL_SIZE = 26, 17
MARGIN, GAP, LABEL_GAP = 24, 14, 5
#: Pillow's built-in font draws boxes for these.
SPELLED_OUT = {"×": "x", "μ": "mu", "µ": "mu", "σ": "sigma", "–": "-", "—": "-", "−": "-", "→": "->"}
SPELLED_OUT |= {"≥": ">=", "≤": "<=", "¼": "1/4", "½": "1/2", "¾": "3/4", "∞": "inf", "’": "'"}

Cell = tuple[str, np.ndarray]


def labelled_grid(rows: list[list[Cell]], title: str, note: str = "") -> np.ndarray:
    """Pictures in rows and columns, each under its label: ``[H, W, 3]`` uint8, white paper.

    A cell is (label, ``[h, w, 3]`` uint8); sizes may differ, rows may have different lengths, and small
    pictures are enlarged without smoothing. ``note`` stands small below the title. Raises ``BadValueError``
    for no cells or a picture of another kind.
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
            # Labels stand directly above their picture, even where a neighbour's takes more lines.
            top = y + label_height - len(lines) * _line_height(label_font)
            for i, line in enumerate(lines):
                draw.text((x, top + i * _line_height(label_font)), line, INK, label_font)
            corner = (x, y + label_height + LABEL_GAP)
            # A hairline outside the picture: a saturated one would melt into the paper.
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


def residual(picture: torch.Tensor, reference: torch.Tensor, gain: float = RESIDUAL_GAIN) -> np.ndarray:
    """``[H, W, 3]`` uint8: gain × |picture − reference|, for each channel."""
    return as_picture((picture.double().cpu() - reference.double().cpu()).abs() * gain)


@torch.no_grad()
def comparison_sheet(
    renderer: Renderer,
    scene: Scene,
    poses: list[int] | None = None,
    exposure_indices: tuple[int, ...] = (0, 2, 4),
    gain: float = RESIDUAL_GAIN,
) -> np.ndarray:
    """Truth | ours | residual for some test views: LDR rows, HDR rows (μ-law), relit rows; uint8.

    ``poses``: test pose numbers; None takes one that has relit truth, or the middle one. Parts without
    truth have no rows. Raises ``BadValueError`` for an unknown pose or exposure, and what readers raise.
    """
    relit = truth.relit_truth(scene.root)
    if poses is None:
        poses = [relit[0].index if relit else scene.test[len(scene.test) // 2].index]
    rows: list[list[Cell]] = []
    for pose in poses:
        view = scene.find("test", pose)
        rows += [_ldr_row(renderer, view, k, gain) for k in exposure_indices if k < len(view.exposures)]
        if truth.has_hdr_truth(scene.root, "test"):
            reference = truth.hdr_truth(scene.root, "test", pose)
            rows.append(_hdr_row(renderer, view, 1.0, reference, f"{view.name} HDR", gain))
        for item in relit:
            if item.index == pose and item.can_be_shown(renderer.lights):
                levels = item.levels_of(renderer.lights)
                label = f"{view.name} {item.condition}"
                rows.append(_hdr_row(renderer, view, levels, item.radiance(), label, gain))
    note = (
        f"residual: absolute difference × {gain:g}; HDR and relit rows: μ-law, μ = {MU:g}, "
        f"white is the {100.0 * WHITE_QUANTILE:g}th percentile of the truth"
    )
    return labelled_grid(rows, f"{scene.name}: truth, ours, residual", note)


def _ldr_row(renderer: Renderer, view: View, k: int, gain: float) -> list[Cell]:
    exposure = view.exposures[k]
    reference = torch.from_numpy(view.image(k).copy()).permute(2, 0, 1).double() / 255.0
    ours = quantise(renderer.ldr(view.camera, exposure, view.lighting_level).detach().cpu())
    return _row(f"{view.name}, {exposure:g} s", ours, reference, gain)


def _hdr_row(
    renderer: Renderer, view: View, level: Levels, reference: torch.Tensor, label: str, gain: float
) -> list[Cell]:
    radiance = renderer.hdr(view.camera, level).detach().cpu()
    pair = hdr_pair(radiance, reference)
    white = display_white(reference)
    shown = resize_to(display(reference, white), radiance.shape[1], radiance.shape[2])
    decibels = psnr(pair.prediction, pair.truth)
    return _row(label, quantise(display(radiance, white)), quantise(shown), gain, decibels)


def display_white(radiance: torch.Tensor) -> float:
    """The radiance to show as white: a high percentile, because a bare bulb would leave the rest black."""
    flat = radiance.flatten().double()
    return max(float(torch.quantile(flat[:: max(1, flat.numel() // 1_000_000)], WHITE_QUANTILE)), 1e-6)


def _row(
    label: str, ours: torch.Tensor, reference: torch.Tensor, gain: float, decibels: float | None = None
) -> list[Cell]:
    decibels = psnr(ours, reference) if decibels is None else decibels
    return [
        (f"{label}: truth", as_picture(reference)),
        (f"ours, {decibels:.2f} dB", as_picture(ours)),
        (f"residual × {gain:g}", residual(ours, reference, gain)),
    ]
