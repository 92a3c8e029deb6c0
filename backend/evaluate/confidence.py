# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares confidence with truth: is radiance right where the model is most confident?

A pixel's error is the mean over the channels of |ln(radiance / truth)|, after one factor for all pixels (the
median), because photographs have no absolute scale. Compared pixels are sorted by confidence into ten equal
parts.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from ...bridge.confidence import MEANING, STOPS, TOLERANCE
from ...bridge.errors import BadValueError
from .metrics import SCALE_FLOOR

FORMAT, VERSION = "physhdr-confidence", 1
#: Added to truth and render (at the truth's scale), as a share of the median lit value, because logarithms of
#: black are meaningless.
FLOOR = 1e-4
PARTS = 10
#: Files of ``physhdr evaluate --confidence``.
CALIBRATION_FILES = ("confidence.json", "confidence.md")
HEADINGS = ("pixels", "confidence", f"within {STOPS:g} stops", "median |ln error|")


@dataclass(frozen=True)
class Part:
    """A tenth of the pixels: mean ``confidence``, the ``share`` that is right, the median |ln error|."""

    confidence: float
    share: float
    median_error: float


@dataclass(frozen=True)
class Calibration:
    """``parts``: the surest first; ``pixels``: of all views."""

    parts: tuple[Part, ...]
    pixels: int

    @property
    def ratio(self) -> float | None:
        """Median error of the surest tenth / that of the least sure; None where the latter is 0, as for black
        rendered black."""
        last = self.parts[-1].median_error
        return self.parts[0].median_error / last if last else None

    @property
    def deviation(self) -> float:
        """Root mean square over the parts of confidence − share; 0: confidence is exact."""
        return float(np.sqrt(np.mean([(part.confidence - part.share) ** 2 for part in self.parts])))

    def described(self) -> dict[str, Any]:
        """The table as stored in files."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "meaning": MEANING,
            "pixels": self.pixels,
            "ratio": self.ratio,
            "deviation": self.deviation,
            "parts": [asdict(part) for part in self.parts],
        }

    @property
    def summary(self) -> str:
        """The table in a sentence."""
        compared = "The least sure tenth's median error is 0, so the surest tenth's is not compared with it"
        if self.ratio is not None:
            compared = f"The surest tenth's median error is {self.ratio:.3f} of the least sure tenth's"
        return f"{compared}; confidence and share differ by {self.deviation:.3f} (root mean square)."

    def rows(self) -> list[tuple[str, str, str, str]]:
        """The cells below ``HEADINGS``."""
        names = {0: "surest tenth", PARTS - 1: "least sure tenth"}
        return [
            (
                names.get(index, str(index + 1)),
                f"{part.confidence:.2f}",
                f"{part.share:.2f}",
                f"{part.median_error:.4f}",
            )
            for index, part in enumerate(self.parts)
        ]

    def markdown(self) -> str:
        lines = [
            "| " + " | ".join(heading.replace("|", "\\|") for heading in HEADINGS) + " |",
            "|---|---:|---:|---:|",
            *("| " + " | ".join(row) + " |" for row in self.rows()),
        ]
        return "\n".join(lines) + f"\n\n{self.summary}\n"

    def rich(self, title: str) -> Table:
        """For ``rich.console.Console.print``."""
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
        table.caption, table.caption_justify = self.summary, "left"
        for number, heading in enumerate(HEADINGS):
            table.add_column(heading, justify="right" if number else "left")
        for row in self.rows():
            table.add_row(*row)
        return table


def log_error(drawn: Sequence[np.ndarray], truth: Sequence[np.ndarray]) -> np.ndarray:
    """``[P]`` for all pixels of some views, from rendered and true radiance ``[3, …]`` each.

    Raises ``BadValueError`` if all of the truth is black.
    """
    a, b = (
        np.maximum(np.concatenate([each.reshape(3, -1) for each in views], axis=1), 0.0)
        for views in (drawn, truth)
    )
    if not (b > 0.0).any():
        raise BadValueError(
            "the true radiance to compare confidence with is black", "Leave out --confidence."
        )
    # Without the black parts, which may be most of a picture: a floor of 0 would not be one.
    middle = float(np.median(b[b > 0.0]))
    lit = b > SCALE_FLOOR * middle
    factor = float(np.median(a[lit] / b[lit]))
    # Before adding the floor, which has the truth's scale: it would hide a render at a much smaller one.
    a = a / factor if factor > 0.0 else a
    floor = FLOOR * middle
    return np.abs(np.log((a + floor) / (b + floor))).mean(axis=0)


def calibration(confidence: np.ndarray, error: np.ndarray) -> Calibration:
    """The table of pixels' ``confidence`` ``[P]`` and ``error`` ``[P]`` (``log_error``)."""
    order = np.argsort(-confidence, kind="stable")
    parts = tuple(
        Part(
            float(confidence[which].mean()),
            float((error[which] <= TOLERANCE).mean()),
            float(np.median(error[which])),
        )
        for which in np.array_split(order, PARTS)
    )
    return Calibration(parts, len(error))
