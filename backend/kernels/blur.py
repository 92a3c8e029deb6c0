# SPDX-License-Identifier: GPL-3.0-or-later
"""Separable Gaussian blur with mirrored borders, and its gradient.

y = 𝒢 M x: M mirrors the border (without repeating the edge), 𝒢 is the window on what lies inside. Its
adjoint: spread the gradient by the same symmetric window over the mirrored image, then fold every
mirrored pixel back onto the one it was a copy of.
"""

import functools
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from ...bridge.errors import BadValueError
from ..simd import LANES, fma, kernel, load, run_ranges, splat, store
from .plain import can_fuse


def gaussian_blur(image: torch.Tensor, size: int, sigma: float) -> torch.Tensor:
    """Blur ``[C, H, W]`` with a ``size`` × ``size`` window (odd) of σ ``sigma`` px; the border is mirrored.

    Float32 on the CPU is fused; anything else goes to ``gaussian_blur_reference``.
    Raises ``BadValueError`` if the image is not larger than half the window.
    """
    if size % 2 == 0 or min(image.shape[1:]) <= size // 2:
        raise BadValueError(
            f"cannot blur an image of {list(image.shape[1:])} pixels with a window of {size}",
            "The window must be odd, and the image larger than half of it.",
        )
    if can_fuse(image):
        return _Blur.apply(image, size, sigma)
    return gaussian_blur_reference(image, size, sigma)


def gaussian_blur_reference(image: torch.Tensor, size: int, sigma: float) -> torch.Tensor:
    """The same in plain torch, for any dtype and device."""
    r = size // 2
    window = _window_on(size, sigma, image.device, image.dtype)
    padded = functional.pad(image[None], (r, r, r, r), mode="reflect")[0][:, None]
    return functional.conv2d(
        functional.conv2d(padded, window.view(1, 1, 1, size)), window.view(1, 1, size, 1)
    )[:, 0]


@functools.cache
def _window_on(size: int, sigma: float, device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    """Kept, because a copy to a CUDA card makes the host wait for the card."""
    return torch.from_numpy(_window(size, sigma)).to(device, dtype)


@functools.cache
def _window(size: int, sigma: float) -> np.ndarray:
    offsets = np.arange(size) - size // 2
    window = np.exp(-(offsets**2) / (2.0 * sigma**2))
    return window / window.sum()


class _Blur(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: torch.Tensor, size: int, sigma: float) -> torch.Tensor:
        ctx.window, ctx.shape = (size, sigma), image.shape
        r = size // 2
        mirrored = np.pad(image.detach().numpy(), ((0, 0), (r, r), (r, r)), mode="reflect")
        return torch.from_numpy(_blur_inside(mirrored, size, sigma))

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (grad,) = grads
        size, sigma = ctx.window
        r = size // 2
        _, height, width = ctx.shape
        spread = _blur_inside(np.pad(grad.numpy(), ((0, 0), (2 * r, 2 * r), (2 * r, 2 * r))), size, sigma)
        # Mirrored pixel r − k is a copy of r + k, and likewise at the other end.
        for k in range(1, r + 1):
            spread[:, r + k] += spread[:, r - k]
            spread[:, r + height - 1 - k] += spread[:, r + height - 1 + k]
        for k in range(1, r + 1):
            spread[:, :, r + k] += spread[:, :, r - k]
            spread[:, :, r + width - 1 - k] += spread[:, :, r + width - 1 + k]
        return torch.from_numpy(spread[:, r : r + height, r : r + width].copy()), None, None


def _blur_inside(padded: np.ndarray, size: int, sigma: float) -> np.ndarray:
    """The window on ``[C, H + size − 1, W + size − 1]`` → ``[C, H, W]``."""
    channels, plane, row = padded.shape
    height, width = plane - size + 1, row - size + 1
    result = np.empty((channels, height, width), np.float32)
    window = _window(size, sigma).astype(np.float32)
    flat = np.ascontiguousarray(padded).reshape(-1)
    run_ranges(_blur_rows, channels * height, height, width, plane, row, flat, window, result, minimum=32)
    return result


@kernel
def _blur_rows(first, last, height, width, plane, row, image, window, result):
    """Rows ``first … last − 1``, counted over channels: down the columns into a buffer, then along it."""
    taps = window.size
    column = np.zeros(row + 2 * LANES, np.float32)
    output = np.zeros(width + LANES, np.float32)
    for line in range(first, last):
        top = (line // height * plane + line % height) * row
        for x in range(0, row - LANES + 1, LANES):
            value = splat(0.0)
            for k in range(taps):
                value = fma(splat(window[k]), load(image, top + k * row + x), value)
            store(value, column, x)
        for x in range(row // LANES * LANES, row):
            rest = np.float32(0.0)
            for k in range(taps):
                rest += window[k] * image[top + k * row + x]
            column[x] = rest
        for x in range(0, width, LANES):
            value = splat(0.0)
            for k in range(taps):
                value = fma(splat(window[k]), load(column, x + k), value)
            store(value, output, x)
        result[line // height, line % height] = output[:width]
