# SPDX-License-Identifier: GPL-3.0-or-later
"""Does a rasteriser draw at all, and rightly? One Gaussian against its closed form."""

from collections.abc import Callable

import numpy as np
import torch

from ...bridge.splatting import LOW_PASS
from ..scene.camera import Camera
from .contract import Rasterization


def try_out(draw: Callable[..., Rasterization], device: torch.device) -> float:
    """Draw one Gaussian, forward and backward; its largest error against the closed form."""
    size, depth, spread, opacity = 16, 2.0, 0.5, 0.8
    camera = Camera(np.eye(4), size, size, float(size), float(size), 0.5 * size, 0.5 * size)
    means = torch.tensor([[0.0, 0.0, -depth]], device=device, requires_grad=True)  # Blender looks down −Z
    quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]], device=device)
    scales = torch.full((1, 3), spread, device=device)
    colour = torch.ones(1, 6, device=device)
    drawn = draw(means, quaternions, scales, torch.full((1,), opacity, device=device), colour, camera)
    variance = (size * spread / depth) ** 2 + LOW_PASS
    x = torch.arange(size, device=device) + 0.5 - 0.5 * size
    expected = opacity * torch.exp(-0.5 * (x[:, None] ** 2 + x**2) / variance)
    error = max((drawn.alpha - expected).abs().max().item(), (drawn.image - expected).abs().max().item())
    # ∂/∂(mean) of the sum over the right half, by the same closed form: fx/z Σ expected · x/σ².
    drawn.image[0, :, size // 2 :].sum().backward()
    half = slice(size // 2, None)
    slope = size / depth * (expected[:, half] * x[half] / variance).sum().item()
    assert means.grad is not None
    return max(error, abs(means.grad[0, 0].item() - slope) / abs(slope))


def first_line(error: BaseException) -> str:
    """Of what an error says, one line; its type where it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
