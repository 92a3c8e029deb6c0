# SPDX-License-Identifier: GPL-3.0-or-later
"""The figure of ``quality_curve.py``: PSNR against seconds, one line for each preset, its end marked."""

import math
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

PANEL, MARGIN = (560, 460), (64, 44, 24, 56)  # pixels: panel; left, top, right, bottom of it
LINE = 20  # of the legend, below the axis
INK, FAINT, PAPER = (24, 24, 28), (222, 222, 226), (255, 255, 255)
COLOURS = {
    "fast": (44, 140, 60),
    "default": (31, 119, 180),
    "baseline": (148, 120, 40),
    "paper": (214, 69, 65),
    "paper-short": (214, 69, 65),
    "gausshdr-short": (130, 80, 170),
    "hdr-gs-short": (90, 150, 160),
}
METRICS = ("LDR-OE", "HDR")
#: Seconds on the axis; those within its range are drawn.
TICKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400)

Points = list[dict[str, float]]


def plot(curves: dict[str, Points], path: Path) -> None:
    """Draw ``curves`` (preset → points with ``seconds`` and the metrics in dB) and write a PNG."""
    metrics = [m for m in METRICS if all(m in point for points in curves.values() for point in points)]
    sheet = Image.new("RGB", (len(metrics) * PANEL[0], PANEL[1] + LINE * len(curves)), PAPER)
    for i, metric in enumerate(metrics):
        _panel(ImageDraw.Draw(sheet), i * PANEL[0], metric, curves)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def _panel(draw: ImageDraw.ImageDraw, left: int, metric: str, curves: dict[str, Points]) -> None:
    font, small = ImageFont.load_default(15), ImageFont.load_default(12)
    x0, y0 = left + MARGIN[0], MARGIN[1]
    x1, y1 = left + PANEL[0] - MARGIN[2], PANEL[1] - MARGIN[3]
    everything = [point for points in curves.values() for point in points]
    low_x = min(point["seconds"] for point in everything) / 1.2
    high_x = max(point["seconds"] for point in everything) * 1.3
    low_y = math.floor(min(point[metric] for point in everything))
    high_y = math.ceil(max(point[metric] for point in everything) + 0.5)

    def at(x: float, y: float) -> tuple[float, float]:
        across = math.log(x / low_x) / math.log(high_x / low_x)
        return x0 + across * (x1 - x0), y1 - (y - low_y) / (high_y - low_y) * (y1 - y0)

    for y in range(low_y, high_y + 1, 1 if high_y - low_y <= 14 else 2):
        draw.line([at(low_x, y), at(high_x, y)], FAINT)
        draw.text((x0 - 6, at(low_x, y)[1]), f"{y}", INK, small, anchor="rm")
    for x in TICKS:
        if low_x <= x <= high_x:
            draw.line([at(x, low_y), at(x, high_y)], FAINT)
            draw.text((at(x, low_y)[0], y1 + 6), f"{x}", INK, small, anchor="ma")
    draw.rectangle([x0, y0, x1, y1], outline=INK)
    draw.text(((x0 + x1) / 2, y1 + 26), "seconds of training", INK, font, anchor="ma")
    draw.text((x0, y0 - 8), f"{metric}, PSNR of the test views, dB", INK, font, anchor="ls")

    for number, (preset, points) in enumerate(curves.items()):
        colour = COLOURS.get(preset, INK)
        line = [at(point["seconds"], point[metric]) for point in points]
        draw.line(line, colour, 2)
        for x, y in line:
            draw.ellipse([x - 2, y - 2, x + 2, y + 2], colour)
        x, y = line[-1]
        draw.ellipse([x - 6, y - 6, x + 6, y + 6], PAPER, colour, 3)
        end = points[-1]
        label = f"{preset}: {end[metric]:.1f} dB after {end['seconds']:.0f} s, {end['iteration']} iterations"
        draw.text((x0, y1 + 52 + LINE * number), label, colour, font, anchor="la")
