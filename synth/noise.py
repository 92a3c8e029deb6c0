# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise of the data: PSNR between two renders of one view, as the metrics of the method measure it."""

import math

import numpy as np

from .png import quantise
from .response import Response

MU = 5000.0
#: dB reported for identical pictures, whose PSNR is infinite (JSON has no infinity).
CEILING = 99.0
#: Pixels: noise is no wider, so that tiles of this size scatter by themselves.
TILE = 10
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


def floor_of_limit(
    truth: np.ndarray,
    halves: tuple[np.ndarray, np.ndarray],
    response: Response,
    exposures: tuple[float, ...],
) -> dict[str, object]:
    """As ``floor``, between ``truth`` and what it would be without noise and without a denoiser's bias.

    The two ``halves`` are the view again, with noise of their own and not denoised, [height, width, 3] as
    ``truth``. What they have in common is the limit, so that the mean of (truth − first) × (truth − second)
    is the squared error of the truth alone: their noise is not in it, but for what the bend of the response
    makes of it (second order). ``psnr_error`` and ``hdr_psnr_error``: how much their noise may still have
    moved that mean, dB (standard error, from the scatter over tiles of the picture; ``CEILING`` where nothing
    tells).
    """
    maximum = float(truth.max()) or 1.0

    def developed(picture: np.ndarray, exposure: float | None) -> np.ndarray:
        if exposure is None:
            return mu_law(picture, maximum)
        return response(picture.astype(np.float64) * exposure)

    found = []
    for exposure in (*exposures, None):
        best, first, second = (developed(each, exposure) for each in (truth, *halves))
        found.append(_mean_and_error((best - first) * (best - second)))
    decibels = [round(_decibels(mean), 3) for mean, _ in found]
    errors = [
        round(min(CEILING, 10.0 / math.log(10.0) * error / mean), 3) if mean > 0.0 else CEILING
        for mean, error in found
    ]
    return {
        **{"psnr": decibels[:-1], "psnr_error": errors[:-1]},
        **{"hdr_psnr": decibels[-1], "hdr_psnr_error": errors[-1]},
    }


def _mean_and_error(picture: np.ndarray) -> tuple[float, float]:
    """The mean of ``picture`` [height, width, 3] and its standard error, by tiles of ``TILE`` × ``TILE``.

    Infinite where there are no two tiles, which alone can scatter.
    """
    rows, columns = (size // TILE for size in picture.shape[:2])
    if rows * columns < 2:
        return float(picture.mean()), math.inf
    whole = picture[: rows * TILE, : columns * TILE]
    tiles = whole.reshape(rows, TILE, columns, TILE, 3).mean(axis=(1, 3, 4))
    return float(picture.mean()), float(tiles.std(ddof=1) / math.sqrt(tiles.size))


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
