# SPDX-License-Identifier: GPL-3.0-or-later
"""The training's curves as a picture for the panel: loss (logarithmic) and PSNR, each on its own scale."""

from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from ..bridge.messages import History

WIDTH, HEIGHT = 320, 320
BACKGROUND = (0.11, 0.11, 0.11, 1.0)
GRID = (0.2, 0.2, 0.2, 1.0)
LOSS = (0.95, 0.55, 0.15, 1.0)
PSNR = (0.35, 0.65, 1.0, 1.0)
LINES = 4
#: Half the width of a curve, pixels.
STROKE = 1.2
MARGIN = 6

_icons: bpy.utils.previews.ImagePreviewCollection | None = None
_NAME = "curves"


def draw_curves(history: History) -> np.ndarray:
    """``[HEIGHT, WIDTH, 4]`` float32, display-referred, bottom row first as Blender's icons are."""
    picture = np.empty((HEIGHT, WIDTH, 4), np.float32)
    picture[:] = BACKGROUND
    for row in np.linspace(MARGIN, HEIGHT - MARGIN - 1, LINES).astype(int):
        picture[row] = GRID
    last = max([*history.iterations[-1:], *history.psnr_iterations[-1:]], default=0)
    losses = np.log(np.maximum(history.losses, 1e-9)) if history.losses else np.empty(0)
    _draw(picture, history.psnr_iterations, np.asarray(history.psnr), last, PSNR)
    _draw(picture, history.iterations, losses, last, LOSS)
    return picture


def _draw(picture: np.ndarray, x: tuple[int, ...], y: np.ndarray, last: int, colour: tuple) -> None:
    """One curve, soft-edged: in each column what lies between it and its neighbours' heights."""
    if len(x) < 2 or last <= 0:
        return
    low, high = float(y.min()), float(y.max())
    room = HEIGHT - 2 * MARGIN - 1
    columns = np.arange(WIDTH)
    at = np.interp(columns / (WIDTH - 1) * last, x, (y - low) / max(high - low, 1e-6) * room + MARGIN)
    padded = np.pad(at, 1, mode="edge")
    halfway = 0.5 * (padded[1:] + padded[:-1])
    bottom = np.minimum(np.minimum(halfway[:-1], halfway[1:]), at) - STROKE
    top = np.maximum(np.maximum(halfway[:-1], halfway[1:]), at) + STROKE
    rows = np.arange(HEIGHT)[:, None]
    cover = np.clip(np.minimum(rows + 1.0, top) - np.maximum(rows, bottom), 0.0, 1.0)
    cover *= (columns >= x[0] / last * (WIDTH - 1)) & (columns <= x[-1] / last * (WIDTH - 1))
    picture += cover[..., None] * (np.array(colour, np.float32) - picture)


def update(history: History) -> None:
    """Show these curves from now on (not from a panel's draw, where nothing may change)."""
    global _icons
    if len(history.iterations) < 2:
        return
    if _icons is None:
        _icons = bpy.utils.previews.new()
    # Any: what is set here is an array, of which Blender's types say that it cannot be.
    icon: Any = _icons.get(_NAME) or _icons.new(_NAME)
    icon.image_size = (WIDTH, HEIGHT)
    icon.image_pixels_float.foreach_set(draw_curves(history).reshape(-1))


def icon_id() -> int:
    """The icon with the curves; 0 where there are none yet."""
    icon = _icons.get(_NAME) if _icons is not None else None
    return icon.icon_id if icon is not None else 0


def unregister() -> None:
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None


def register() -> None:
    """Nothing to do: the icon is made when there is something to show."""
