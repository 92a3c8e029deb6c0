# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bracket of pictures says of one drawn picture: exposed, developed and compared in two passes.

Of radiance x and the exposures t_k, y_k = f(ln(max(x t_k, 0) + ε)) is what picture k should show, with the
response f read from a table (``curve_table``), and is compared with it by SSIM and by pixel (``ssim``). As
operations of their own the exposures, their stack, its logarithm, the response and its parts each write and
read a picture of every exposure, forward and backward. Here the developed pictures go straight to where SSIM
reads them, and a row of SSIM's gradient straight through the table to the radiance:

    ∂L/∂x = Σ_k ∂L/∂y_k f′ t_k / (x t_k + ε),    ∂L/∂c_j = Σ sʲ ∂L/∂y   (``curve_table``)

The latter are sums over points. Each chunk of rows makes its own, so that they do not depend on the number of
threads.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit

from ..simd import (
    LANES,
    add_powers,
    floor,
    fma,
    kernel,
    load,
    load_quads,
    log2_of_positive,
    maximum,
    peek,
    run_parallel,
    run_ranges,
    select,
    store,
    take_ticket,
)
from .curve_table import KNOTS_PER_UNIT, coefficients_of, gradient_of_values
from .plain import can_fuse
from .ssim import TAPS, PixelError, SsimTarget, backward_line, bordered, similarities, ssim_window

_R = TAPS // 2
_LN2 = np.float32(np.log(2.0))
_PER_UNIT = np.float32(KNOTS_PER_UNIT)

#: Rows of a chunk: few enough to share out, enough that summing the chunks' tables costs little.
ROWS = 32


def can_compare_bracket(radiance: torch.Tensor) -> bool:
    """Whether ``bracket_errors`` takes this ``[3, H, W]``."""
    return can_fuse(radiance) and radiance.shape[2] >= LANES


def log_range(radiance: torch.Tensor, exposures: Sequence[float], epsilon: float) -> tuple[float, float]:
    """Bounds of ln(max(x t, 0) + ε) over all exposures, a little wider than rounding could make it."""
    low, high = (max(float(v), 0.0) for v in torch.aminmax(radiance.detach()))
    if not (np.isfinite(low) and np.isfinite(high)):
        return np.nan, np.nan
    ends = [np.log(low * min(exposures) + epsilon), np.log(high * max(exposures) + epsilon)]
    return ends[0] - 1e-4, ends[1] + 1e-4


def bracket_errors(
    radiance: torch.Tensor,
    exposures: Sequence[float],
    epsilon: float,
    knots: torch.Tensor,
    values: torch.Tensor,
    slopes: torch.Tensor,
    targets: Sequence[SsimTarget],
    error: PixelError,
) -> tuple[torch.Tensor, torch.Tensor]:
    """SSIM and the mean pixel difference of each of K developed pictures, ``[K]`` each.

    ``radiance`` ``[3, H, W]``, K ``exposures`` and ``targets``; the response by its ``values`` ``[3, N]`` and
    ``slopes`` (not differentiable) at ``knots`` ``[N]``, which surround ``log_range``. Differentiable in
    radiance and values. Only for what ``can_compare_bracket`` says.
    """
    times = np.array(exposures, np.float32)
    constants = times, np.float32(epsilon), np.float32(knots[0].item())
    return _Bracket.apply(radiance, values, slopes, constants, tuple(targets), error)


class _Bracket(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, radiance, values, slopes, constants, targets, error: PixelError):
        times, epsilon, start = constants
        radiance = radiance.detach().contiguous()
        channels, height, width = radiance.shape
        padded = bordered(len(times), channels, height, width)
        run_ranges(
            *(_develop, channels * height, height, width, *padded.shape[2:], radiance.numpy().reshape(-1)),
            *(times, epsilon, start, coefficients_of(values).reshape(-1), padded.reshape(-1)),
            minimum=32,
        )
        partials = [[bordered(channels, height, width) for _ in range(3)] for _ in times]
        nowhere = np.empty((0, 0, 0), np.float32)
        sums = [
            similarities(picture, target, error, parts, nowhere).sum(axis=0)
            for picture, target, parts in zip(padded, targets, partials, strict=True)
        ]
        ctx.saved = (radiance, slopes.detach(), constants, padded, partials, targets, error)
        ctx.set_materialize_grads(False)
        means = torch.from_numpy((np.stack(sums) / radiance.numel()).astype(np.float32))
        return means[:, 0].clone(), means[:, 1].clone()

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        radiance, slopes, (times, epsilon, start), padded, partials, targets, error = ctx.saved
        channels, height, width = radiance.shape
        scales = np.zeros((2, len(times)), np.float32)
        for scale, grad in zip(scales, grads, strict=True):
            if grad is not None:
                scale[:] = grad.numpy() / radiance.numel()
        chunks = -(-height // ROWS)
        sums = np.zeros((channels, chunks, slopes.shape[1], 4), np.float32)
        grad_radiance = torch.zeros_like(radiance)
        table = coefficients_of(slopes).reshape(-1)
        for k, (picture, target, parts) in enumerate(zip(padded, targets, partials, strict=True)):
            counter = np.zeros(1, np.int64)
            arrays = (
                *(height, width, *picture.shape[1:], radiance.numpy().reshape(-1), times[k], epsilon, start),
                *(table, picture.reshape(-1), target.padded.reshape(-1), *(p.reshape(-1) for p in parts)),
                *(ssim_window(), error == "mse", scales[0, k], scales[1, k]),
                *(grad_radiance.numpy().reshape(-1), sums),
            )
            run_parallel(lambda _, counter=counter, arrays=arrays: _backward(counter, *arrays))
        return grad_radiance, gradient_of_values(sums), None, None, None, None


@njit
def _place(x, epsilon, start):
    """Where ln(max(x, 0) + ε) is in the table: the knot before it, and how far from there to the next."""
    place = (log2_of_positive(maximum(x, 0.0) + epsilon) * _LN2 - start) * _PER_UNIT
    whole = floor(place)
    return whole, place - whole


@kernel
def _develop(first, last, height, width, plane, row, radiance, times, epsilon, start, coefficients, padded):
    """Rows ``first … last − 1`` (over channels) of every exposure's picture, at their padded places."""
    channels = radiance.size // (height * width)
    stride = coefficients.size // channels
    for line in range(first, last):
        channel, y = line // height, line % height
        for k in range(times.size):
            time = times[k]
            target = ((k * channels + channel) * plane + y + _R) * row + _R
            # The last vector ends with the row: what it has in common with the one before is made twice.
            for i in range(0, width, LANES):
                at = min(i, width - LANES)
                whole, s = _place(load(radiance, line * width + at) * time, epsilon, start)
                c0, c1, c2, c3 = load_quads(coefficients, channel * stride, whole)
                store(fma(s, fma(s, fma(s, c3, c2), c1), c0), padded, target + at)


@kernel
def _backward(
    counter,
    height,
    width,
    plane,
    row,
    radiance,
    time,
    epsilon,
    start,
    slopes,
    x_image,
    y_image,
    p,
    q,
    r,
    window,
    squared,
    scale,
    error_scale,
    grad_radiance,
    sums,
):
    """Of one exposure: added to ``grad_radiance`` and ``sums[channel, chunk]``, chunks by ticket."""
    channels, chunks, knots = sums.shape[:3]
    columns = np.zeros((3, row), np.float32)
    lines = np.zeros((4, row), np.float32)
    grads, places, shares, passed = lines[0], lines[1], lines[2], lines[3]
    own = np.empty((2, knots * 4), np.float32)
    even, odd = own[0], own[1]
    while True:
        ticket = take_ticket(counter)
        if ticket >= channels * chunks:
            break
        channel, chunk = ticket // chunks, ticket % chunks
        own[:] = 0.0
        for y in range(chunk * ROWS, min(chunk * ROWS + ROWS, height)):
            top, line = (channel * plane + y) * row, (channel * height + y) * width
            backward_line(
                *(top, width, row, x_image, y_image, p, q, r, window, squared, scale, error_scale),
                *(columns, grads, 0),
            )
            for i in range(0, width, LANES):
                at = min(i, width - LANES)
                x = load(radiance, line + at) * time
                whole, s = _place(x, epsilon, start)
                c0, c1, c2, c3 = load_quads(slopes, channel * knots * 4, whole)
                slope = fma(s, fma(s, fma(s, c3, c2), c1), c0)
                through = load(grads, at) * slope * time / (x + epsilon)
                store(select(x >= 0.0, through, 0.0), passed, at)
                store(whole, places, at)
                store(s, shares, at)
            for i in range(width):
                grad_radiance[line + i] += passed[i]
            # Neighbours often fall between the same knots, and a sum waits for the one before: two tables.
            for i in range(0, width - 1, 2):
                add_powers(even, 4 * np.int64(peek(places, i)), peek(grads, i), peek(shares, i))
                add_powers(odd, 4 * np.int64(peek(places, i + 1)), peek(grads, i + 1), peek(shares, i + 1))
            if width % 2:
                i = width - 1
                add_powers(even, 4 * np.int64(peek(places, i)), peek(grads, i), peek(shares, i))
        target = sums[channel, chunk].reshape(-1)
        for i in range(target.size):
            target[i] += even[i] + odd[i]
