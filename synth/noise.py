# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise of the data: PSNR between two renders of one view, as the metrics of the method measure it."""

from __future__ import annotations

import numpy as np

from .png import quantise
from .response import Response

MU = 5000.0
CEILING = 99.0
"""dB reported for identical pictures, whose PSNR is infinite (JSON has no infinity)."""


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB between two 8-bit pictures."""
    error = np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2) / 255.0**2
    return CEILING if error == 0 else min(CEILING, float(-10.0 * np.log10(error)))


def mu_law(radiance: np.ndarray, maximum: float) -> np.ndarray:
    """ln(1 + μ x) / ln(1 + μ) of x = radiance / maximum clipped to 0…1 (HDR-NeRF's evaluation)."""
    return np.log1p(MU * np.clip(radiance.astype(np.float64) / maximum, 0.0, 1.0)) / np.log1p(MU)


def floor(
    first: np.ndarray, second: np.ndarray, response: Response, exposures: tuple[float, ...]
) -> dict[str, object]:
    """``psnr`` at each exposure after response and 8 bit; ``hdr_psnr``: μ-law over the first's maximum."""
    brackets = [
        psnr(
            quantise(response(first.astype(np.float64) * t)),
            quantise(response(second.astype(np.float64) * t)),
        )
        for t in exposures
    ]
    maximum = float(first.max()) or 1.0
    hdr = psnr(quantise(mu_law(first, maximum)), quantise(mu_law(second, maximum)))
    return {"psnr": [round(value, 3) for value in brackets], "hdr_psnr": round(hdr, 3)}
