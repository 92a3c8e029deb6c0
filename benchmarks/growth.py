# SPDX-License-Identifier: GPL-3.0-or-later
"""How the time of an iteration grows with the Gaussians and with the pixels, and a picture of it."""

import math
from collections.abc import Callable
from pathlib import Path

from measure import alternate
from PIL import Image, ImageDraw, ImageFont
from synthetic import SIZE, steady_trainer

PRESETS = ("default", "paper")
COUNTS = (10_000, 25_000, 50_000, 100_000, 200_000, 400_000)
SIZES = (100, 200, 400, 800)
#: Gaussians while the resolution changes.
COUNT = 50_000

PANEL, MARGIN = (460, 380), (70, 66, 20, 60)  # pixels: panel; left, top, right, bottom of it
COLOURS = {"default": (31, 119, 180), "paper": (214, 69, 65)}
INK, FAINT, PAPER = (24, 24, 28), (210, 210, 214), (255, 255, 255)

#: What was varied → its values and, for each preset, milliseconds.
Growth = dict[str, dict[str, list[float]]]


def measure(report: Callable[[str], None]) -> Growth:
    """Median milliseconds of ``Trainer.step``, both presets in turn."""

    def series(axis: str, cases: list[tuple[float, int, int]]) -> dict[str, list[float]]:
        found: dict[str, list[float]] = {axis: [], **{preset: [] for preset in PRESETS}}
        for x, count, size in cases:
            report(f"{axis}: {x:g}")
            steps = [steady_trainer(preset, count, size).step for preset in PRESETS]
            found[axis].append(x)
            for preset, time in zip(PRESETS, alternate(*steps, rounds=7), strict=True):
                found[preset].append(time)
        return found

    return {
        "Gaussians": series("Gaussians", [(count, count, SIZE) for count in COUNTS]),
        "pixels": series("pixels", [(size * size, COUNT, size) for size in SIZES]),
    }


def slopes(growth: Growth) -> dict[str, float]:
    """d ln(time) / d ln(size) between the last two points: 1 is linear growth."""
    found = {}
    for axis, series in growth.items():
        x = series[axis]
        for preset in PRESETS:
            y = series[preset]
            found[f"{axis}, {preset}"] = math.log(y[-1] / y[-2]) / math.log(x[-1] / x[-2])
    return found


def plot(growth: Growth, path: Path) -> None:
    """Two panels, both axes logarithmic, beside a dashed line of linear growth; written as PNG."""
    sheet = Image.new("RGB", (len(growth) * PANEL[0], PANEL[1]), PAPER)
    titles = {"Gaussians": f"{SIZE}x{SIZE} pixels", "pixels": f"{COUNT // 1000} k Gaussians"}
    for i, (axis, series) in enumerate(growth.items()):
        _panel(ImageDraw.Draw(sheet), i * PANEL[0], axis, titles[axis], series)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


def _panel(
    draw: ImageDraw.ImageDraw, left: int, axis: str, title: str, series: dict[str, list[float]]
) -> None:
    font, small = ImageFont.load_default(15), ImageFont.load_default(12)
    x0, y1 = left + MARGIN[0], PANEL[1] - MARGIN[3]
    x1, y0 = left + PANEL[0] - MARGIN[2], MARGIN[1]
    times = [time for preset in PRESETS for time in series[preset]]
    x_range = (min(series[axis]) / 1.2, max(series[axis]) * 1.2)
    y_range = (min(times) / 1.5, max(times) * 1.5)

    def at(x: float, y: float) -> tuple[float, float]:
        across = math.log(x / x_range[0]) / math.log(x_range[1] / x_range[0])
        up = math.log(y / y_range[0]) / math.log(y_range[1] / y_range[0])
        return x0 + across * (x1 - x0), y1 - up * (y1 - y0)

    for y in _round_numbers(*y_range):
        place = at(x_range[0], y)[1]
        draw.line([(x0, place), (x1, place)], FAINT)
        draw.text((x0 - 6, place), f"{y:g}", INK, small, anchor="rm")
    for x in series[axis]:
        place = at(x, y_range[0])[0]
        draw.line([(place, y0), (place, y1)], FAINT)
        draw.text((place, y1 + 6), f"{x / 1000:g} k", INK, small, anchor="ma")
    draw.rectangle([x0, y0, x1, y1], outline=INK)
    draw.text(((x0 + x1) / 2, y1 + 26), axis, INK, font, anchor="ma")
    draw.text((x0, y0 - 30), f"ms per iteration, {title}", INK, font, anchor="ls")
    legend = [*COLOURS.items(), ("- - linear growth", INK)]
    for number, (label, colour) in enumerate(legend):
        draw.text((x0 + 90 * number, y0 - 9), label, colour, small, anchor="ls")

    for preset in PRESETS:
        points = [at(x, y) for x, y in zip(series[axis], series[preset], strict=True)]
        draw.line(points, COLOURS[preset], 2)
        for x, y in points:
            draw.ellipse([x - 4, y - 4, x + 4, y + 4], COLOURS[preset])
    # Linear growth through the largest case of the first preset.
    x_end, y_end = series[axis][-1], series[PRESETS[0]][-1]
    x_start = max(x_range[0], x_end * y_range[0] / y_end)
    _dashed(draw, at(x_start, y_end * x_start / x_end), at(x_end, y_end))


def _round_numbers(low: float, high: float) -> list[float]:
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [n * 10.0**d for d in decades for n in (1, 2, 5) if low <= n * 10.0**d <= high]


def _dashed(draw: ImageDraw.ImageDraw, start: tuple[float, float], end: tuple[float, float]) -> None:
    dashes = max(1, int(math.dist(start, end) / 10))
    for i in range(dashes):
        a, b = i / dashes, (i + 0.5) / dashes
        ends = [tuple(s + t * (e - s) for s, e in zip(start, end, strict=True)) for t in (a, b)]
        draw.line([ends[0], ends[1]], INK)
