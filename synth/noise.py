# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise of the data: PSNR between two renders of one view, as the metrics of the method measure it."""

import math

import numpy as np

from .png import quantise
from .response import Response

MU = 5000.0
#: dB reported for identical pictures, whose PSNR is infinite (JSON has no infinity).
CEILING = 99.0
BY_DENOISER, BY_LAPLACIAN = "difference to the denoised picture", "Immerkær's Laplacian"


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB between two 8-bit pictures."""
    return _decibels(float(np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2)) / 255.0**2)


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


def estimate(raw: np.ndarray, denoised: np.ndarray | None) -> float:
    """μ-law PSNR in dB of one render's noise before denoising, without a second render.

    Against the denoised picture where there is one. Else by Immerkær's method (Fast Noise Variance
    Estimation, 1996): σ = √(π/2) · mean |M * I| / 6 with M the difference of two Laplacians, which sees no
    slopes or curves; it takes fine texture for noise, so the true figure may be higher.
    """
    maximum = float((raw if denoised is None else denoised).max()) or 1.0
    picture = mu_law(raw, maximum)
    if denoised is not None:
        return round(_decibels(float(np.mean((picture - mu_law(denoised, maximum)) ** 2))), 2)
    lines = picture[:-2] - 2.0 * picture[1:-1] + picture[2:]
    mask = lines[:, :-2] - 2.0 * lines[:, 1:-1] + lines[:, 2:]
    sigma = math.sqrt(math.pi / 2.0) * float(np.mean(np.abs(mask))) / 6.0
    return round(_decibels(sigma**2), 2)


def _decibels(mean_square: float) -> float:
    return CEILING if mean_square <= 0.0 else min(CEILING, -10.0 * math.log10(mean_square))
