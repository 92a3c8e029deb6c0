# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of the CPU kernels, each beside its plain-torch alternative, from the same run.

Every figure is a median; rivals are timed in turn (one of each, again and again), so that whatever else
the machine does meanwhile hits both. ``python benchmarks/run.py`` (all), ``--quick`` (no 200 k, less torch),
``--threads N``, ``--json FILE``.
"""

import argparse
import json
import math
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

# torch's OpenMP threads must not spin between operations: they would take the kernels' cores.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from physhdr.backend import kernels
from physhdr.backend.kernels.warmup import warmup
from physhdr.backend.rasterize import cpu, rasterize
from physhdr.backend.scene.camera import Camera

SIZE = 400  # pixels of a side


def gaussians(count: int, channels: int, seed: int = 0) -> tuple[list[torch.Tensor], Camera]:
    """Gaussians spread over the view, 1–5 m away; opacity 0.1–0.9; footprints of 7 px on average."""
    generator = torch.Generator().manual_seed(seed)
    depth = 1.0 + 4.0 * torch.rand(count, generator=generator)
    x, y = (torch.rand(2, count, generator=generator) - 0.5) * 1.2 * depth
    scales = 0.005 * torch.exp(torch.rand(count, 3, generator=generator) * math.log(4.0))
    tensors = [
        torch.stack([x, y, -depth], dim=1),
        torch.randn(count, 4, generator=generator),
        scales,
        0.1 + 0.8 * torch.rand(count, generator=generator),
        torch.rand(count, channels, generator=generator),
    ]
    camera = Camera.from_field_of_view(np.eye(4), SIZE, SIZE, 2.0 * math.atan(0.5))
    return [t.requires_grad_() for t in tensors], camera


def draw(tensors: list[torch.Tensor], camera: Camera, implementation) -> Callable[[], None]:
    """Forward and backward of one picture."""
    weights = torch.randn(tensors[4].shape[1], SIZE, SIZE)

    def step() -> None:
        image = rasterize(*tensors, camera, implementation=implementation).image
        torch.autograd.grad(image, tensors, weights)

    return step


def view(tensors: list[torch.Tensor], camera: Camera) -> Callable[[], None]:
    """Forward only."""

    def step() -> None:
        with torch.no_grad():
            rasterize(*tensors, camera, implementation="cpu")

    return step


def forward_backward(function: Callable[..., torch.Tensor], *shapes: tuple[int, ...]) -> Callable[[], None]:
    """``function`` of random tensors, and the gradients of all of them."""
    generator = torch.Generator().manual_seed(1)
    tensors = [torch.rand(shape, generator=generator).requires_grad_() for shape in shapes]

    def step() -> None:
        output = function(*tensors)
        torch.autograd.grad(output, tensors, torch.ones_like(output))

    return step


def alternate(*steps: Callable[[], None], rounds: int) -> list[float]:
    """Median milliseconds of each step, timed in turn, after one round that does not count."""
    times: list[list[float]] = [[] for _ in steps]
    for round_number in range(rounds + 1):
        for step, mine in zip(steps, times, strict=True):
            start = time.perf_counter()
            step()
            if round_number:
                mine.append(1e3 * (time.perf_counter() - start))
    return [statistics.median(t) for t in times]


def rasteriser_rows(quick: bool):
    """(what, milliseconds, alternative's milliseconds or None, note) of the rasteriser."""
    for count in (10_000, 50_000) if quick else (10_000, 50_000, 200_000):
        steps = [draw(*gaussians(count, channels), "cpu") for channels in (3, 6, 10)]
        three, six, ten = alternate(*steps, rounds=9)
        alone = alternate(view(*gaussians(count, 6)), rounds=9)[0]
        reference = None
        if count == 10_000 or (count == 50_000 and not quick):
            reference = alternate(draw(*gaussians(count, 6), "reference"), rounds=1)[0]
        name = f"rasterise {count // 1000} k"
        yield f"{name}, 3 channels, forward + backward", three, None, ""
        yield f"{name}, 6 channels, forward + backward", six, reference, f"{six / three:.2f} × three channels"
        yield f"{name}, 10 channels, forward + backward", ten, None, f"{ten / three:.2f} × three channels"
        yield f"{name}, 6 channels, forward", alone, None, f"{1e3 / alone:.0f} pictures per second"


def kernel_rows(quick: bool):
    """The same for the other kernels, at the size of a 400 × 400 picture."""
    rounds = 2 if quick else 5
    picture, pixels, hidden = (3, SIZE, SIZE), SIZE * SIZE, 64
    target = torch.rand(picture)
    known = kernels.SsimTarget(target)
    rows: list[tuple[str, Callable, Callable, list[tuple[int, ...]]]] = [
        ("SSIM", lambda x: kernels.ssim(x, target), lambda x: kernels.ssim_reference(x, target), [picture]),
        (
            "SSIM, target known",
            lambda x: kernels.ssim(x, known),
            lambda x: kernels.ssim_reference(x, target),
            [picture],
        ),
        (
            "blur 11, 6 channels",
            lambda x: kernels.gaussian_blur(x, 11, 3.0),
            lambda x: kernels.gaussian_blur_reference(x, 11, 3.0),
            [(6, SIZE, SIZE)],
        ),
    ]
    for activation in ("relu", "softplus"):
        rows.append(
            (
                f"response curves 1–64–1, one picture, {activation}",
                lambda *t, a=activation: kernels.curve_mlp(*t, a),
                lambda *t, a=activation: kernels.curve_mlp_reference(*t, a),
                [(3, pixels), (3, hidden), (3, hidden), (3, hidden), (3,)],
            )
        )
    for inputs, outputs, points, what in ((6, 3, pixels, "fusion"), (4, 3, 50_000, "composer, 50 k")):
        rows.append(
            (
                f"network {inputs}–64–{outputs}, {what}",
                lambda *t: kernels.small_mlp(*t, "relu"),
                lambda *t: kernels.small_mlp_reference(*t, "relu"),
                [(inputs, points), (hidden, inputs), (hidden,), (outputs, hidden), (outputs,)],
            )
        )
    count = 50_000
    means, viewpoint = torch.randn(count, 3), torch.zeros(3)
    rows.append(
        (
            "spherical harmonics, degree 3, 50 k",
            lambda *t: kernels.evaluate_sh(*t, means, viewpoint, 3),
            lambda *t: kernels.evaluate_sh_reference(*t, means, viewpoint, 3),
            [(count, 3), (count, 15, 3)],
        )
    )
    for what, fused, twin, shapes in rows:
        ours, theirs = alternate(
            forward_backward(fused, *shapes), forward_backward(twin, *shapes), rounds=rounds
        )
        yield what, ours, theirs, ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="leave out 200 k and the slow references")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads of both sides")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    cpu.set_threads(options.threads)
    torch.set_num_threads(options.threads)

    console = Console()
    with console.status("compiling …") as status:
        start = time.perf_counter()
        warmup(lambda what, done, total: status.update(f"compiling {done}/{total}: {what}"))
        compile_seconds = time.perf_counter() - start
    busy = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    machine = f"{platform.processor() or platform.machine()}, {options.threads} threads{busy}"
    table = Table(title=f"{SIZE} × {SIZE}, {machine}; kernels ready after {compile_seconds:.1f} s")
    table.add_column("work")
    for column in ("ms", "plain torch, ms", "ratio"):
        table.add_column(column, justify="right")
    table.add_column("")
    results = []
    with console.status("measuring …") as status:
        for rows in (rasteriser_rows, kernel_rows):
            for what, ours, theirs, note in rows(options.quick):
                status.update(f"measured {what}")
                results.append({"work": what, "ms": ours, "torch_ms": theirs})
                beside = (f"{theirs:.1f}", f"{theirs / ours:.1f} ×") if theirs else ("", "")
                table.add_row(what, f"{ours:.2f}", *beside, note)
    console.print(table)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine, "results": results}, indent=1))


if __name__ == "__main__":
    main()
