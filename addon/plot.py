# SPDX-License-Identifier: GPL-3.0-or-later
"""The training's curves as a picture for the panel: loss (logarithmic) and PSNR, each with its own axis.

Below are iterations, at the left the PSNR in dB, at the right the loss, each axis in its curve's colour.
"""

import math
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..bridge.messages import History

WIDTH, HEIGHT = 400, 400
#: Room for the numbers beside the curves, pixels.
LEFT, RIGHT, BOTTOM, TOP = 46, 80, 34, 14
BACKGROUND = (0.11, 0.11, 0.11, 1.0)
GRID = (0.2, 0.2, 0.2, 1.0)
NUMBERS = (0.7, 0.7, 0.7, 1.0)
LOSS = (0.95, 0.55, 0.15, 1.0)
PSNR = (0.35, 0.65, 1.0, 1.0)
#: Half the width of a curve, pixels.
STROKE = 1.5
#: About so many numbers at an axis.
TICKS = 4

#: 5 × 7 pixels each, drawn ``GLYPH`` times as large.
FONT = {
    "0": ("01110", "10001", "10011", "10101", "11001", "10001", "01110"),
    "1": ("00100", "01100", "00100", "00100", "00100", "00100", "01110"),
    "2": ("01110", "10001", "00001", "00110", "01000", "10000", "11111"),
    "3": ("01110", "10001", "00001", "00110", "00001", "10001", "01110"),
    "4": ("00010", "00110", "01010", "10010", "11111", "00010", "00010"),
    "5": ("11111", "10000", "11110", "00001", "00001", "10001", "01110"),
    "6": ("00110", "01000", "10000", "11110", "10001", "10001", "01110"),
    "7": ("11111", "00001", "00010", "00100", "01000", "01000", "01000"),
    "8": ("01110", "10001", "10001", "01110", "10001", "10001", "01110"),
    "9": ("01110", "10001", "10001", "01111", "00001", "00010", "01100"),
    ".": ("00000", "00000", "00000", "00000", "00000", "01100", "01100"),
    "-": ("00000", "00000", "00000", "11111", "00000", "00000", "00000"),
    "k": ("10000", "10000", "10010", "10100", "11000", "10100", "10010"),
    "M": ("10001", "11011", "10101", "10101", "10001", "10001", "10001"),
}
GLYPH = 3
ADVANCE, TALL = 6 * GLYPH, 7 * GLYPH

_icons: bpy.utils.previews.ImagePreviewCollection | None = None
_NAME = "curves"


def draw_curves(history: History) -> np.ndarray:
    """``[HEIGHT, WIDTH, 4]`` float32, display-referred, bottom row first as Blender's icons are."""
    picture = np.empty((HEIGHT, WIDTH, 4), np.float32)
    picture[:] = BACKGROUND
    for row in (BOTTOM, HEIGHT - TOP - 1):
        picture[row, LEFT : WIDTH - RIGHT] = GRID
    for column in (LEFT, WIDTH - RIGHT - 1):
        picture[BOTTOM : HEIGHT - TOP, column] = GRID
    last = max([*history.iterations[-1:], *history.psnr_iterations[-1:]], default=0)
    if last > 0:
        for value in ticks(0, last):
            column = round(float(column_of(value, last)))
            picture[BOTTOM : HEIGHT - TOP, column] = GRID
            _write(picture, short(value), column, 2, "centre", NUMBERS)
    loss_at, losses = _finite(history.iterations, history.losses)
    losses = np.log(np.maximum(losses, 1e-9))
    psnr_at, psnr = _finite(history.psnr_iterations, history.psnr)
    if psnr.size:
        for value in ticks(psnr.min(), psnr.max(), least=1.0) or [round(float(psnr.mean()))]:
            row = round(float(row_of(value, psnr)))
            picture[row, LEFT : WIDTH - RIGHT] = GRID
            _write(picture, short(value), LEFT - 4, row - TALL // 2, "right", PSNR)
    if losses.size:
        for value in powers(math.exp(losses.min()), math.exp(losses.max())):
            row = round(float(row_of(math.log(value), losses)))
            _write(picture, short(value), WIDTH - RIGHT + 5, row - TALL // 2, "left", LOSS)
    _draw(picture, psnr_at, psnr, last, PSNR)
    _draw(picture, loss_at, losses, last, LOSS)
    return picture


def _finite(x: Any, y: Any) -> tuple[np.ndarray, np.ndarray]:
    """The points of a curve that can be drawn; none where fewer than two can: that is no curve."""
    places, values = np.asarray(x, float), np.asarray(y, float)
    kept = np.isfinite(values)
    return (places[kept], values[kept]) if kept.sum() > 1 else (np.empty(0), np.empty(0))


def column_of(iteration: Any, last: int) -> Any:
    """Where an iteration is, pixels from the left."""
    return LEFT + np.asarray(iteration) / last * (WIDTH - LEFT - RIGHT - 1)


def row_of(value: Any, values: np.ndarray) -> Any:
    """Where a value of a curve is, pixels from the bottom; the least of its ``values`` is the lower edge."""
    low, high = float(values.min()), float(values.max())
    return BOTTOM + (np.asarray(value) - low) / max(high - low, 1e-6) * (HEIGHT - BOTTOM - TOP - 1)


def ticks(low: float, high: float, least: float = 0.0) -> list[float]:
    """Round numbers from ``low`` to ``high``, about ``TICKS`` of them: multiples of 1, 2 or 5 times 10^n."""
    if not high > low:
        return []
    step = 10.0 ** math.floor(math.log10((high - low) / TICKS))
    step = max(next(step * k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= TICKS), least)
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def powers(low: float, high: float) -> list[float]:
    """Round numbers from ``low`` to ``high`` for a logarithmic axis, tens if there are some; at least one."""
    tens = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1,), (1, 3), (1, 2, 5), range(1, 10)):
        found = [k * 10.0**ten for ten in tens for k in factors if low <= k * 10.0**ten <= high]
        if len(found) > 1:
            return found[:: math.ceil(len(found) / (TICKS + 1))]
    return found or [low]


def short(value: float) -> str:
    """A number in few characters: ``500``, ``2.5k``, ``1M``, ``0.02``, ``.005``."""
    for size, unit in ((1_000_000, "M"), (1_000, "k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{unit}"
    text = f"{value:.2g}" if abs(value) < 100 else f"{value:.0f}"
    if "e" in text:
        text = f"{value:.4f}".rstrip("0").rstrip(".")
    return text.replace("0.", ".", 1) if len(text) > 4 else text


def _draw(picture: np.ndarray, x: np.ndarray, y: np.ndarray, last: int, colour: tuple) -> None:
    """One curve, soft-edged: in each column what lies between it and its neighbours' heights."""
    if y.size < 2 or last <= 0:
        return
    columns = np.arange(LEFT, WIDTH - RIGHT)
    at = np.interp(columns, column_of(x, last), row_of(y, y))
    padded = np.pad(at, 1, mode="edge")
    halfway = 0.5 * (padded[1:] + padded[:-1])
    bottom = np.minimum(np.minimum(halfway[:-1], halfway[1:]), at) - STROKE
    top = np.maximum(np.maximum(halfway[:-1], halfway[1:]), at) + STROKE
    rows = np.arange(HEIGHT)[:, None]
    cover = np.clip(np.minimum(rows + 1.0, top) - np.maximum(rows, bottom), 0.0, 1.0)
    cover *= (columns >= column_of(x[0], last)) & (columns <= column_of(x[-1], last))
    part = picture[:, LEFT : WIDTH - RIGHT]
    part += cover[..., None] * (np.array(colour, np.float32) - part)


def _write(picture: np.ndarray, text: str, x: int, y: int, side: str, colour: tuple) -> None:
    """A number whose ``side`` (or centre) is at column ``x``, its foot at row ``y``; all of it inside."""
    width = ADVANCE * len(text) - GLYPH
    x -= {"left": 0, "centre": width // 2, "right": width}[side]
    x, y = min(max(x, 0), WIDTH - width), min(max(y, 0), HEIGHT - TALL)
    for index, character in enumerate(text):
        inked = np.array([[mark == "1" for mark in line] for line in FONT[character]])
        large = np.repeat(np.repeat(inked, GLYPH, axis=0), GLYPH, axis=1)[::-1]
        begin = x + ADVANCE * index
        picture[y : y + TALL, begin : begin + 5 * GLYPH][large] = colour


def update(history: History) -> None:
    """Show these curves from now on (not from a panel's draw, where nothing may change)."""
    global _icons
    if _icons is None:
        _icons = bpy.utils.previews.new()
    # Any: what is set here is an array, of which Blender's types say that it cannot be.
    icon: Any = _icons.get(_NAME) or _icons.new(_NAME)
    icon.image_size = (WIDTH, HEIGHT)
    icon.image_pixels_float.foreach_set(draw_curves(history).reshape(-1))


def icon_id() -> int:
    """The icon with the curves; 0 where there were none yet."""
    icon = _icons.get(_NAME) if _icons is not None else None
    return icon.icon_id if icon is not None else 0


def unregister() -> None:
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None


def register() -> None:
    """Nothing to do: the icon is made when there is something to show."""
