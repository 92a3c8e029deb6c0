# SPDX-License-Identifier: GPL-3.0-or-later
"""The rasteriser and every other kernel, forward and backward, each beside its plain-torch twin."""

from collections.abc import Callable, Iterator

import torch
from measure import Row, Step, alternate
from synthetic import SIZE, gaussians

from physhdr.backend import kernels
from physhdr.backend.rasterize import Implementation, rasterize
from physhdr.backend.scene.camera import Camera

#: To be reached: milliseconds of forward + backward with 6 channels, 6 channels over 3, torch over ours.
TARGETS = {50_000: 15.0, 200_000: 50.0}
SIX_OVER_THREE = 1.4
FASTER = 100.0


def draw(tensors: list[torch.Tensor], camera: Camera, implementation: Implementation = "cpu") -> Step:
    """Forward and backward of one picture."""
    weights = torch.randn(tensors[4].shape[1], camera.height, camera.width)

    def step() -> None:
        image = rasterize(*tensors, camera, implementation=implementation).image
        torch.autograd.grad(image, tensors, weights)

    return step


def view(tensors: list[torch.Tensor], camera: Camera) -> Step:
    """Forward only."""

    def step() -> None:
        with torch.no_grad():
            rasterize(*tensors, camera, implementation="cpu")

    return step


def forward_backward(function: Callable[..., torch.Tensor], *shapes: tuple[int, ...]) -> Step:
    """``function`` of random tensors, and the gradients of all of them."""
    generator = torch.Generator().manual_seed(1)
    tensors = [torch.rand(shape, generator=generator).requires_grad_() for shape in shapes]

    def step() -> None:
        output = function(*tensors)
        torch.autograd.grad(output, tensors, torch.ones_like(output))

    return step


def rasteriser_rows(quick: bool) -> Iterator[Row]:
    """Drawing Gaussians, sort and binning included."""
    for count in (10_000, 50_000) if quick else (10_000, 50_000, 200_000):
        name = f"draw {count // 1000} k"
        steps = [draw(*gaussians(count, channels)) for channels in (3, 6, 10)]
        three, six, ten, forward = alternate(*steps, view(*gaussians(count, 6)), rounds=9)
        plain = None
        if count == 10_000 or (count == 50_000 and not quick):
            plain = alternate(draw(*gaussians(count, 6), "reference"), rounds=1)[0]
        yield Row(work=f"{name}, 3 channels", value=three)
        yield Row(
            work=f"{name}, 6 channels",
            value=six,
            plain=plain,
            at_most=TARGETS.get(count),
            faster=FASTER if plain else None,
        )
        yield Row(work=f"{name}, 10 channels", value=ten)
        yield Row(work=f"{name}, 6 over 3 channels", value=six / three, unit="×", at_most=SIX_OVER_THREE)
        yield Row(work=f"{name}, 6 channels, no gradients", value=forward)


def kernel_rows(quick: bool) -> Iterator[Row]:
    """The other kernels, at the size of a 400 × 400 picture or of 50 k Gaussians."""
    pixels, hidden = SIZE * SIZE, 64
    for what, function, shapes in (*_image_kernels(), *_networks(pixels, hidden), *_spherical_harmonics()):

        def plain(*tensors: torch.Tensor, function=function) -> torch.Tensor:
            with kernels.plain_torch():
                return function(*tensors)

        ours, theirs = alternate(
            forward_backward(function, *shapes),
            forward_backward(plain, *shapes),
            rounds=2 if quick else 5,
            repeats=(5, 1),
        )
        yield Row(work=what, value=ours, plain=theirs)


Case = tuple[str, Callable[..., torch.Tensor], list[tuple[int, ...]]]


def _image_kernels() -> Iterator[Case]:
    picture = (3, SIZE, SIZE)
    target = torch.rand(picture)
    known = kernels.SsimTarget(target)
    yield "SSIM", lambda x: kernels.ssim(x, target), [picture]
    yield "SSIM, target known", lambda x: kernels.ssim(x, known), [picture]
    yield "blur 11, 6 channels", lambda x: kernels.gaussian_blur(x, 11, 3.0), [(6, SIZE, SIZE)]


def _networks(pixels: int, hidden: int) -> Iterator[Case]:
    for activation in ("relu", "softplus"):
        yield (
            f"curves 1–64–1, {activation}",
            lambda *t, a=activation: kernels.curve_mlp(*t, a),
            [(3, pixels), (3, hidden), (3, hidden), (3, hidden), (3,)],
        )
    sizes = ((6, 3, pixels, "fusion"), (5, 1, pixels, "a local curve"), (4, 3, 50_000, "g, 50 k"))
    for inputs, outputs, points, what in (*sizes, (2, 1, 50_000, "φ, 50 k")):
        yield (
            f"network {inputs}–64–{outputs}, {what}",
            lambda *t: kernels.small_mlp(*t, "relu"),
            [(inputs, points), (hidden, inputs), (hidden,), (outputs, hidden), (outputs,)],
        )


def _spherical_harmonics() -> Iterator[Case]:
    count = 50_000
    means, viewpoint = torch.randn(count, 3), torch.zeros(3)
    yield (
        "SH degree 3, 50 k",
        lambda dc, rest: kernels.evaluate_sh(dc, rest, means, viewpoint, 3),
        [(count, 3), (count, 15, 3)],
    )
