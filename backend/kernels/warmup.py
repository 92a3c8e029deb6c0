# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile every kernel ahead of its first use; what is compiled stays on disk for the next start."""

from collections.abc import Callable, Iterable

import numpy as np
import torch

from ..rasterize import rasterize
from ..scene.camera import Camera
from . import curve_mlp, evaluate_sh, gaussian_blur, small_mlp, ssim

#: Channels that the methods draw: radiance; with its ambient part, context or depth; all of them.
CHANNELS = (3, 4, 6, 7, 10)

#: (inputs, outputs) of the method's networks with one hidden layer: g, φ, f_mix, local curves.
NETWORKS = ((4, 3), (2, 1), (6, 3), (5, 1))


def warmup(report: Callable[[str, int, int], None] | None = None, channels: Iterable[int] = CHANNELS) -> None:
    """Run everything once on a few numbers. ``report(what, done, total)`` is called before each step.

    About 25 s on two cores where nothing is cached, else a second.
    """
    steps = [(f"rasteriser, {c} channels", lambda c=c: _rasterise(c)) for c in channels]
    steps += [("SSIM, blur, spherical harmonics", _images)]
    steps += [(f"network {i} → {o}", lambda i=i, o=o: _network(i, o)) for i, o in NETWORKS]
    steps += [("response curves", _curves)]
    for done, (what, step) in enumerate(steps):
        if report:
            report(what, done, len(steps))
        step()
    if report:
        report("done", len(steps), len(steps))


def _rasterise(channels: int) -> None:
    camera = Camera(np.eye(4), 8, 8, 8.0, 8.0, 4.0, 4.0)
    means = torch.tensor([[0.0, 0.0, -2.0]], requires_grad=True)
    shapes = torch.tensor([[1.0, 0.0, 0.0, 0.0]]), torch.full((1, 3), 0.1), torch.full((1,), 0.5)
    rasterize(means, *shapes, torch.ones(1, channels), camera, implementation="cpu").image.sum().backward()


def _images() -> None:
    image = torch.rand(3, 16, 16, requires_grad=True)
    (ssim(image, torch.rand(3, 16, 16)) + gaussian_blur(image, 11, 3.0).sum()).backward()
    rest = torch.zeros(2, 15, 3, requires_grad=True)
    evaluate_sh(torch.zeros(2, 3), rest, torch.ones(2, 3), torch.zeros(3), 3).sum().backward()


def _network(inputs: int, outputs: int) -> None:
    w1, w2 = torch.ones(8, inputs, requires_grad=True), torch.ones(outputs, 8)
    small_mlp(torch.zeros(inputs, 20), w1, torch.zeros(8), w2, torch.zeros(outputs), "relu").sum().backward()


def _curves() -> None:
    w1, rest = torch.ones(3, 8, requires_grad=True), torch.zeros(3, 8)
    for activation in ("relu", "softplus"):
        for points in (20, 20_000):
            curve_mlp(torch.zeros(3, points), w1, rest, rest, rest[:, 0], activation).sum().backward()
