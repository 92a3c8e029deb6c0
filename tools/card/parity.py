# SPDX-License-Identifier: GPL-3.0-or-later
"""Does a side compute what the oracle computes? Pictures, gradients, whole iterations, a training."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.state import State
from physhdr.backend.train.trainer import step

from . import truth
from .side import Side

#: Relative L2 error of a picture. A Gaussian whose alpha is within rounding of 1/255 may be drawn on one side
#: and not on the other; one such pixel in a picture of 128×96 makes 1e-4.
PICTURE = 5e-4
#: Of a gradient.
GRADIENT = 1e-2
#: Of the mean of five trainings, in dB: three standard errors. Rounding grows into different Gaussians, so
#: that a pair of trainings differs by 0.7 dB (standard deviation of 15 pairs, Warp's kernels and the CPU's,
#: both on the CPU; their means by 0.15).
TRAINING = 1.0


@dataclass(frozen=True)
class Finding:
    """One comparison: how far off, and how far it may be."""

    what: str
    error: float
    allowed: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        return bool(self.error <= self.allowed)  # False for NaN


def relative(found: torch.Tensor, expected: torch.Tensor) -> float:
    """‖found − expected‖ / ‖expected‖."""
    expected = expected.detach().double()
    difference = found.detach().cpu().double() - expected
    return float(difference.norm() / expected.norm().clamp_min(1e-30))


def rasteriser(side: Side, oracle: Side, count: int, channels: int) -> Iterator[Finding]:
    """Picture, coverage and the gradients of every input for random Gaussians, some of them out of sight."""
    generator = torch.Generator().manual_seed(channels)
    means = torch.randn(count, 3, generator=generator) * torch.tensor([2.0, 1.5, 1.5])
    tensors = {
        "means": means - torch.tensor([0.0, 0.0, 3.0]),  # some lie behind the camera
        "quaternions": torch.randn(count, 4, generator=generator),
        "scales": (0.6 + torch.rand(count, 3, generator=generator)) * count ** (-1 / 3),
        "opacities": 0.999 * torch.rand(count, generator=generator),
        "colours": torch.rand(count, channels, generator=generator),
    }
    width, height = (131, 93) if count > 1000 else (43, 29)  # not a multiple of any tile
    camera = Camera(np.eye(4), width, height, 0.8 * width, 0.85 * width, 0.52 * width, 0.47 * height)
    weight = torch.randn(channels + 1, height, width, generator=generator)

    def drawn(by: Side) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        leaves = {name: t.clone().to(by.device).requires_grad_() for name, t in tensors.items()}
        offsets = torch.zeros(count, 2, device=by.device, requires_grad=True)
        with by.computing():
            result = rasterize(
                *leaves.values(), camera, screen_offsets=offsets, implementation=by.implementation
            )
            weights = weight.to(by.device)
            ((result.image * weights[:-1]).sum() + (result.alpha * weights[-1]).sum()).backward()
        gradients = {name: t.grad for name, t in leaves.items()} | {"screen position": offsets.grad}
        return result.image, result.alpha, {name: g for name, g in gradients.items() if g is not None}

    image, alpha, gradients = drawn(side)
    expected_image, expected_alpha, expected_gradients = drawn(oracle)
    name = f"{channels} channels"
    yield Finding(f"{name}: picture", relative(image, expected_image), PICTURE)
    yield Finding(f"{name}: coverage", relative(alpha, expected_alpha), PICTURE)
    for key, expected in expected_gradients.items():
        yield Finding(f"{name}: gradient of {key}", relative(gradients[key], expected), GRADIENT)


def same_bits(side: Side, count: int, channels: int) -> Finding:
    """With torch's deterministic algorithms: how many of a picture's and its gradients' numbers differ when
    they are computed twice."""
    torch.use_deterministic_algorithms(True)
    try:
        generator = torch.Generator().manual_seed(channels)
        means = torch.randn(count, 3, generator=generator) - torch.tensor([0.0, 0.0, 3.0])
        tensors = (
            means,
            torch.randn(count, 4, generator=generator),
            count ** (-1 / 3) * (0.6 + torch.rand(count, 3, generator=generator)),
            torch.rand(count, generator=generator),
            torch.rand(count, channels, generator=generator),
        )
        camera = Camera(np.eye(4), 131, 93, 105.0, 111.0, 68.0, 44.0)

        def numbers() -> list[torch.Tensor]:
            leaves = [t.clone().to(side.device).requires_grad_() for t in tensors]
            with side.computing():
                drawn = rasterize(*leaves, camera, implementation=side.implementation)
                drawn.image.square().sum().backward()
            return [drawn.image.detach(), *(t.grad for t in leaves if t.grad is not None)]

        different = sum(int((a != b).sum()) for a, b in zip(numbers(), numbers(), strict=True))
    finally:
        torch.use_deterministic_algorithms(False)
    return Finding("sorted accumulation: numbers that differ the second time", float(different), 0.0)


def iteration(side: Side, oracle: Side, preset: str, size: int, count: int) -> Iterator[Finding]:
    """One iteration: the loss and the gradient of every parameter, Gaussians' and networks'."""

    def computed(by: Side) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        with by.computing():
            state = truth.begin_on(truth.scene(size, count), truth.short(preset, 60), by)
            method = state.method
            _rough_up(state)
            method.active_sh_degree = state.config.method.sh_degree
            view = state.views[1]
            drawn = method.draw(view.camera, view.lighting_levels, view.exposures[2])
            rendering = method.develop(drawn, view.exposures[2])
            total = torch.stack(
                list(method.losses(rendering, state.data.pictures.get(view, 2)).values())
            ).sum()
            total.backward()
        parameters = {**method.gaussians.parameters, **dict(method.named_parameters())}
        return total, {name: p.grad for name, p in parameters.items() if p.grad is not None}

    loss, gradients = computed(side)
    expected_loss, expected_gradients = computed(oracle)
    yield Finding(f"{preset}: loss of an iteration", relative(loss, expected_loss), PICTURE)
    for name, expected in expected_gradients.items():
        if expected.abs().max() > 0:
            yield Finding(f"{preset}: gradient of {name}", relative(gradients[name], expected), GRADIENT)


def _rough_up(state: State) -> None:
    """Make every parameter matter: at their start, networks and higher SH coefficients are zero."""
    generator = torch.Generator().manual_seed(5)
    parameters = [*state.method.gaussians.parameters.values(), *state.method.parameters()]
    with torch.no_grad():
        for parameter in parameters:
            parameter += 0.1 * torch.randn(parameter.shape, generator=generator).to(parameter.device)


def training(
    side: Side, oracle: Side, preset: str, size: int, count: int, iterations: int, scenes: int
) -> Finding:
    """The same short trainings on both sides; the difference of their mean PSNR on test views."""

    def trained(by: Side, seed: int) -> float:
        with by.computing():
            state = truth.begin_on(truth.scene(size, count, seed=seed), truth.short(preset, iterations), by)
            for _ in range(iterations):
                step(state)
            return truth.psnr_of_test_views(state)

    found, expected = (sum(trained(by, seed) for seed in range(scenes)) / scenes for by in (side, oracle))
    what = f"{preset}: {scenes} × {iterations} iterations, {found:.2f} dB against {expected:.2f}"
    return Finding(what, abs(found - expected), TRAINING, "dB")
