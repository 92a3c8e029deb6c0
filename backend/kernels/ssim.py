# SPDX-License-Identifier: GPL-3.0-or-later
"""Mean structural similarity (Wang et al. 2004) as 3DGS takes it, and its gradient.

11 × 11 Gaussian window, σ 1.5, separable, zero padding, C₁ = 0.01², C₂ = 0.03², mean over all pixels and
channels. With 𝒢 the window, x the prediction, y the target:

    μ₁ = 𝒢x   μ₂ = 𝒢y   σ₁ = 𝒢x² − μ₁²   σ₂ = 𝒢y² − μ₂²   σ₁₂ = 𝒢xy − μ₁μ₂
    S = A₁A₂ / (B₁B₂),   A₁ = 2μ₁μ₂ + C₁,  A₂ = 2σ₁₂ + C₂,  B₁ = μ₁² + μ₂² + C₁,  B₂ = σ₁ + σ₂ + C₂

Backward: S depends on x through 𝒢x, 𝒢x² and 𝒢xy, and 𝒢 is its own adjoint (symmetric, zero padding), so

    ∂ΣS/∂x = 𝒢p + 2x 𝒢q + y 𝒢r,    r = ∂S/∂(𝒢xy) = 2A₁/(B₁B₂),    q = ∂S/∂(𝒢x²) = −S/B₂,
                                    p = ∂S/∂(𝒢x) = 2μ₂(A₂ − A₁)/(B₁B₂) − 2μ₁S (1/B₁ − 1/B₂)

The mean absolute or squared difference x − y, the other half of L_rec, comes along: the pixels are at hand.

Both passes are three separable blurs at once, row by row: down the columns into three row buffers, then
along them. μ₂ and σ₂ do not change while the target does not: ``SsimTarget`` keeps them.

For S of every pixel (``ssim_map``), p, q and r are multiplied by its ∂L/∂S before they are blurred.
"""

import functools
from typing import Any, Literal

import numpy as np
import torch
from numba import njit
from torch.nn import functional

from ..simd import (
    LANES,
    absolute,
    fma,
    kernel,
    lane_numbers,
    load,
    peek,
    run_ranges,
    select,
    splat,
    store,
    store_strided,
    total,
)
from .constants import SSIM_C1 as C1
from .constants import SSIM_C2 as C2
from .constants import SSIM_TAPS as TAPS
from .constants import ssim_window as window_in_float64
from .plain import can_fuse, card_takes

PixelError = Literal["l1", "mse"]

_R = TAPS // 2


class SsimTarget:
    """A target image ``[C, H, W]`` with what SSIM needs of it computed once (three times its size)."""

    def __init__(self, image: torch.Tensor) -> None:
        self.shape = tuple(image.shape)
        self.padded = _padded(image)
        self.mean, self.variance = (np.empty_like(self.padded) for _ in range(2))
        channels, height, _ = self.shape
        plane, row = self.padded.shape[1:]
        run_ranges(
            *(_target_rows, channels * height, height, plane, row, self.padded.reshape(-1)),
            *(ssim_window(), self.mean.reshape(-1), self.variance.reshape(-1)),
            minimum=32,
        )

    @property
    def image(self) -> torch.Tensor:
        """The target itself, ``[C, H, W]``."""
        _, height, width = self.shape
        return torch.from_numpy(inside(self.padded, height, width))

    @property
    def nbytes(self) -> int:
        """What it takes in memory."""
        return self.padded.nbytes + self.mean.nbytes + self.variance.nbytes


def ssim(prediction: torch.Tensor, target: torch.Tensor | SsimTarget) -> torch.Tensor:
    """Mean SSIM of two images ``[C, H, W]``, a scalar, differentiable in ``prediction``.

    Float32 is fused, on the CPU and by Warp; anything else goes to ``ssim_reference``. The target gets no
    gradient from the fused path.
    """
    return ssim_and_error(prediction, target, "l1")[0]


def ssim_and_error(
    prediction: torch.Tensor, target: torch.Tensor | SsimTarget, error: PixelError
) -> tuple[torch.Tensor, torch.Tensor]:
    """``ssim``, and the mean absolute (``l1``) or squared (``mse``) difference, from one pass."""
    if isinstance(target, SsimTarget):
        if can_fuse(prediction):
            return _Ssim.apply(prediction, target, error)
        target = target.image.to(prediction)
    elif can_fuse(prediction, target) and not target.requires_grad:
        return _Ssim.apply(prediction, SsimTarget(target), error)
    difference = prediction - target
    pixel = difference.abs().mean() if error == "l1" else difference.square().mean()
    return _not_fused(prediction, target).mean(), pixel


def ssim_map(prediction: torch.Tensor, target: torch.Tensor | SsimTarget) -> torch.Tensor:
    """S of every pixel ``[C, H, W]``, whose mean is ``ssim``; differentiable in ``prediction``."""
    if isinstance(target, SsimTarget):
        if can_fuse(prediction):
            return _SsimMap.apply(prediction, target)
        target = target.image.to(prediction)
    elif can_fuse(prediction, target) and not target.requires_grad:
        return _SsimMap.apply(prediction, SsimTarget(target))
    return _not_fused(prediction, target)


def _not_fused(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """``ssim_map`` where the CPU's kernels cannot compute it."""
    if card_takes(prediction, target) and not target.requires_grad:
        from .card.similarity import ssim_map as on_card

        return on_card(prediction, target)
    return ssim_map_reference(prediction, target)


def ssim_reference(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """``ssim`` in plain torch, for any dtype and device."""
    return ssim_map_reference(prediction, target).mean()


def ssim_map_reference(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """``ssim_map`` in plain torch, for any dtype and device."""
    window = _window_on(prediction.device, prediction.dtype)
    stacked = torch.stack(
        [prediction, target, prediction * prediction, target * target, prediction * target], dim=1
    )
    flat = stacked.reshape(-1, 1, *prediction.shape[1:])
    flat = functional.conv2d(flat, window.view(1, 1, 1, TAPS), padding=(0, _R))
    flat = functional.conv2d(flat, window.view(1, 1, TAPS, 1), padding=(_R, 0))
    m1, m2, xx, yy, xy = flat.reshape(stacked.shape).unbind(1)
    a1, a2 = 2 * m1 * m2 + C1, 2 * (xy - m1 * m2) + C2
    b1, b2 = m1 * m1 + m2 * m2 + C1, xx - m1 * m1 + yy - m2 * m2 + C2
    return a1 * a2 / (b1 * b2)


class _Ssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, prediction: torch.Tensor, target: SsimTarget, error: PixelError):
        channels, height, width = target.shape
        padded = _padded(prediction)
        nowhere = np.empty((0, 0, 0), np.float32)
        partials = [bordered(*target.shape) if ctx.needs_input_grad[0] else nowhere for _ in range(3)]
        row_sums = similarities(padded, target, error, partials, nowhere)
        ctx.saved = (padded, target, partials, error)
        ctx.set_materialize_grads(False)
        similarity, pixel = row_sums.sum(axis=0) / (channels * height * width)
        return torch.tensor(similarity, dtype=torch.float32), torch.tensor(pixel, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        padded, target, partials, error = ctx.saved
        channels, height, width = target.shape
        scales = [np.float32(0.0 if g is None else g.item() / (channels * height * width)) for g in grads]
        return _to_prediction(padded, target, partials, error, *scales), None, None


class _SsimMap(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, prediction: torch.Tensor, target: SsimTarget) -> torch.Tensor:
        _, height, width = target.shape
        padded = _padded(prediction)
        nowhere = np.empty((0, 0, 0), np.float32)
        partials = [bordered(*target.shape) if ctx.needs_input_grad[0] else nowhere for _ in range(3)]
        similarity = np.empty_like(padded)
        similarities(padded, target, "l1", partials, similarity)
        ctx.saved = (padded, target, partials)
        return torch.from_numpy(inside(similarity, height, width).copy())

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        padded, target, partials = ctx.saved
        weight = _padded(grads[0])
        weighted = [partial * weight for partial in partials]
        return _to_prediction(padded, target, weighted, "l1", np.float32(1.0), np.float32(0.0)), None


def similarities(
    padded: np.ndarray,
    target: SsimTarget,
    error: PixelError,
    partials: list[np.ndarray],
    similarity: np.ndarray,
) -> np.ndarray:
    """``_ssim_rows`` on all rows: their sums ``[rows, 2]``; fills ``partials`` and ``similarity``."""
    channels, height, width = target.shape
    row_sums = np.empty((channels * height, 2))
    run_ranges(
        *(_ssim_rows, channels * height, height, width, padded.shape[1], padded.shape[2]),
        *(padded.reshape(-1), target.padded.reshape(-1), target.mean.reshape(-1)),
        *(target.variance.reshape(-1), ssim_window(), error == "mse", row_sums),
        *(p.reshape(-1) for p in partials),
        similarity.reshape(-1),
        minimum=32,
    )
    return row_sums


def _to_prediction(
    padded: np.ndarray,
    target: SsimTarget,
    partials: list[np.ndarray],
    error: PixelError,
    scale: np.float32,
    error_scale: np.float32,
) -> torch.Tensor:
    """``_ssim_backward_rows`` on all rows: ∂L/∂prediction ``[C, H, W]``."""
    channels, height, width = target.shape
    result = torch.empty(target.shape)
    run_ranges(
        *(_ssim_backward_rows, channels * height, height, width, padded.shape[1], padded.shape[2]),
        *(padded.reshape(-1), target.padded.reshape(-1), *(p.reshape(-1) for p in partials)),
        *(ssim_window(), error == "mse", scale, error_scale, result.numpy().reshape(-1)),
        minimum=32,
    )
    return result


def _padded(image: torch.Tensor) -> np.ndarray:
    """``[C, H + 10, W′]`` with a border of zeros; W′ leaves room to read whole vectors beyond it."""
    result = bordered(*image.shape)
    inside(result, *image.shape[1:])[:] = image.detach().numpy()
    return result


def bordered(*shape: int) -> np.ndarray:
    """For ``[…, H, W]`` an array ``[…, H + 10, W′]``: zeros around what is not yet written."""
    *channels, height, width = shape
    row = -(-width // LANES) * LANES + 2 * _R + LANES
    result = np.empty((*channels, height + 2 * _R, row), np.float32)
    result[..., :_R, :] = result[..., _R + height :, :] = 0.0
    result[..., _R : _R + height, :_R] = result[..., _R : _R + height, _R + width :] = 0.0
    return result


def inside(padded: np.ndarray, height: int, width: int) -> np.ndarray:
    """The picture in a ``bordered`` array."""
    return padded[..., _R : _R + height, _R : _R + width]


@functools.cache
def _window_on(device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    """Kept, because a copy to a CUDA card makes the host wait for the card."""
    return torch.from_numpy(window_in_float64()).to(device, dtype)


@functools.cache
def ssim_window() -> np.ndarray:
    return window_in_float64().astype(np.float32)


@kernel
def _target_rows(first, last, height, plane, row, y, window, mean, variance):
    """𝒢y and 𝒢y² − (𝒢y)² of rows ``first … last − 1`` (counted over channels), at their padded places."""
    column = np.zeros((2, row), np.float32)
    mean_column, square_column = column[0], column[1]
    for line in range(first, last):
        top = (line // height * plane + line % height) * row  # of the window's first row
        for x in range(0, row - LANES + 1, LANES):
            m, s = splat(0.0), splat(0.0)
            for k in range(TAPS):
                value, weight = load(y, top + k * row + x), splat(peek(window, k))
                weighted = value * weight
                m, s = m + weighted, fma(weighted, value, s)
            store(m, mean_column, x)
            store(s, square_column, x)
        centre = top + _R * row + _R
        for x in range(0, row - 2 * _R - LANES + 1, LANES):
            m, s = splat(0.0), splat(0.0)
            for k in range(TAPS):
                weight = splat(peek(window, k))
                m = fma(weight, load(mean_column, x + k), m)
                s = fma(weight, load(square_column, x + k), s)
            store(m, mean, centre + x)
            store(s - m * m, variance, centre + x)


@kernel
def _ssim_rows(
    first,
    last,
    height,
    width,
    plane,
    row,
    x_image,
    y_image,
    mean,
    variance,
    window,
    squared,
    row_sums,
    p,
    q,
    r,
    similarity,
):
    """Rows ``first … last − 1``: Σ S and Σ |x − y| (or its square) into ``row_sums`` ``[rows, 2]``.

    p, q, r of the pixels unless their size is 0; S itself into ``similarity`` unless its size is 0.
    """
    columns = np.zeros((3, row), np.float32)
    column_x, column_xx, column_xy = columns[0], columns[1], columns[2]
    lanes = lane_numbers()
    for line in range(first, last):
        top = (line // height * plane + line % height) * row
        for i in range(0, row - LANES + 1, LANES):
            sx, sxx, sxy = splat(0.0), splat(0.0), splat(0.0)
            for k in range(TAPS):
                at = top + k * row + i
                value = load(x_image, at)
                weighted = value * splat(peek(window, k))
                sx, sxx, sxy = sx + weighted, fma(weighted, value, sxx), fma(weighted, load(y_image, at), sxy)
            store(sx, column_x, i)
            store(sxx, column_xx, i)
            store(sxy, column_xy, i)
        centre = top + _R * row + _R
        line_sum, line_error = splat(0.0), splat(0.0)
        for i in range(0, width, LANES):
            m1, xx, xy = splat(0.0), splat(0.0), splat(0.0)
            for k in range(TAPS):
                weight = splat(peek(window, k))
                m1 = fma(weight, load(column_x, i + k), m1)
                xx = fma(weight, load(column_xx, i + k), xx)
                xy = fma(weight, load(column_xy, i + k), xy)
            m2 = load(mean, centre + i)
            product, square = m1 * m2, m1 * m1
            a1, a2 = 2.0 * product + C1, 2.0 * (xy - product) + C2
            b1, b2 = fma(m2, m2, square) + C1, xx - square + load(variance, centre + i) + C2
            inverse = 1.0 / (b1 * b2)
            s = a1 * a2 * inverse
            inside = lanes < float(width - i)
            line_sum = line_sum + select(inside, s, 0.0)
            if similarity.size:
                store(s, similarity, centre + i)
            # Beyond the width both images are zero.
            difference = load(x_image, centre + i) - load(y_image, centre + i)
            line_error = line_error + (difference * difference if squared else absolute(difference))
            if p.size:
                # 1/B₁ = B₂ · inverse, 1/B₂ = B₁ · inverse
                through_mean = 2.0 * inverse * (m2 * (a2 - a1) - m1 * s * (b2 - b1))
                store(select(inside, through_mean, 0.0), p, centre + i)
                store(select(inside, -s * b1 * inverse, 0.0), q, centre + i)
                store(select(inside, 2.0 * a1 * inverse, 0.0), r, centre + i)
        row_sums[line, 0], row_sums[line, 1] = total(line_sum), total(line_error)


@kernel
def _ssim_backward_rows(
    first,
    last,
    height,
    width,
    plane,
    row,
    x_image,
    y_image,
    p,
    q,
    r,
    window,
    squared,
    scale,
    error_scale,
    result,
):
    """``scale`` · (𝒢p + 2x 𝒢q + y 𝒢r) + ``error_scale`` · (sign(x − y), or 2(x − y)), into ``result``.

    Rows ``first … last − 1``; ``result`` is not padded.
    """
    columns = np.zeros((3, row), np.float32)
    for line in range(first, last):
        at = (line // height * plane + line % height) * row
        backward_line(
            *(at, width, row, x_image, y_image, p, q, r, window, squared, scale, error_scale, columns),
            *(result, line * width),
        )


@njit
def backward_line(
    top, width, row, x_image, y_image, p, q, r, window, squared, scale, error_scale, columns, result, to
):
    """One row of ``_ssim_backward_rows``, whose window begins at ``top``, to ``result[to:]``."""
    column_p, column_q, column_r = columns[0], columns[1], columns[2]
    for i in range(0, row - LANES + 1, LANES):
        sp, sq, sr = splat(0.0), splat(0.0), splat(0.0)
        for k in range(TAPS):
            at, weight = top + k * row + i, splat(peek(window, k))
            sp, sq = fma(weight, load(p, at), sp), fma(weight, load(q, at), sq)
            sr = fma(weight, load(r, at), sr)
        store(sp, column_p, i)
        store(sq, column_q, i)
        store(sr, column_r, i)
    centre = top + _R * row + _R
    for i in range(0, width, LANES):
        sp, sq, sr = splat(0.0), splat(0.0), splat(0.0)
        for k in range(TAPS):
            weight = splat(peek(window, k))
            sp = fma(weight, load(column_p, i + k), sp)
            sq = fma(weight, load(column_q, i + k), sq)
            sr = fma(weight, load(column_r, i + k), sr)
        x, y = load(x_image, centre + i), load(y_image, centre + i)
        difference = x - y
        slope = 2.0 * difference if squared else select(difference > 0.0, splat(1.0), 0.0)
        slope = slope if squared else select(difference < 0.0, splat(-1.0), slope)
        value = fma(fma(y, sr, fma(2.0 * x, sq, sp)), scale, slope * error_scale)
        if i + LANES <= width:
            store(value, result, to + i)
        else:
            store_strided(value, result, to + i, 1, width - i)
