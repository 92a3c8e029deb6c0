# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile every kernel ahead of its first use; what is compiled stays on disk for the next start."""

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
import torch

from ...bridge.cores import usable_cores
from ..rasterize import rasterize
from ..scene.camera import Camera
from ..simd.compiling import cached_files
from . import curve_mlp, evaluate_sh, gaussian_blur, local_curves, small_mlp, ssim
from .activations import lit_colours
from .bracket import bracket_errors
from .mlp import Activation
from .pointwise import blend, corrected, log_of_exposure
from .ssim import SsimTarget, _ssim_rows
from .stereo import matching_costs, semi_global

#: The context of the local curves.
CONTEXT = 4

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a training calls beside what every one does; ``|`` is what two of them call."""

    #: Numbers of channels that are drawn.
    channels: tuple[int, ...] = ()
    #: (inputs, outputs) of networks with one hidden layer.
    networks: tuple[tuple[int, int], ...] = ()
    #: Of the global curves.
    activations: tuple[Activation, ...] = ()
    #: Branches that ask the local curves at once.
    local_branches: tuple[int, ...] = ()
    blur: bool = False

    def __or__(self, other: "Needs") -> "Needs":
        return Needs(
            channels=_union(self.channels, other.channels),
            networks=_union(self.networks, other.networks),
            activations=_union(self.activations, other.activations),
            local_branches=_union(self.local_branches, other.local_branches),
            blur=self.blur or other.blur,
        )


def compile_ahead(needs: Needs, report: Callable[[str, int, int], None] | None = None) -> None:
    """Run what is needed once on a few numbers. ``report(what, done, total)`` is called after each.

    About 25 s on two cores where nothing is cached, else a second. The compiler works on one core, so
    where nothing is cached several processes share the work and leave the results on disk. Where none can be
    left there, or where one of them dies, this process does all of it.
    """
    jobs = _jobs(needs)
    cores = usable_cores()
    if cached_files(_ssim_rows) == [] and cores > 1:
        context = multiprocessing.get_context("spawn")
        # One dies where memory is too little for all of them to load torch.
        with suppress(BrokenProcessPool), ProcessPoolExecutor(min(cores, len(jobs)), context) as pool:
            names = {pool.submit(job): name for name, job in jobs.items()}
            for done, future in enumerate(as_completed(names), start=1):
                future.result()
                if report:
                    report(names[future], done, len(jobs))
    for done, (name, job) in enumerate(jobs.items(), start=1):
        job()
        if report:
            report(name, done, len(jobs))


def _jobs(needs: Needs) -> dict[str, Callable[[], None]]:
    """By name; the longest first, so that they are not last."""
    jobs: dict[str, Callable[[], None]] = {"rasteriser": partial(_rasterise, needs.channels)}
    for activation in needs.activations:
        jobs[f"response curves, {activation}"] = partial(_curves, activation)
    jobs["stereo"] = _stereo
    jobs["SSIM"] = _ssim
    for inputs, outputs in needs.networks:
        jobs[f"network {inputs} → {outputs}"] = partial(_network, inputs, outputs)
    for branches in needs.local_branches:
        jobs[f"local curves, {branches} at once"] = partial(_local_curves, branches)
    jobs["spherical harmonics"] = _spherical_harmonics
    jobs["pointwise"] = _pointwise
    jobs["activations"] = _activations
    jobs["brackets"] = _bracket
    if needs.blur:
        jobs["blur"] = _blur
    return jobs


def _union(some: tuple[T, ...], others: tuple[T, ...]) -> tuple[T, ...]:
    return tuple(dict.fromkeys((*some, *others)))


def are_cached() -> bool:
    """Whether the disk has anything of ours, so that there is little or nothing to compile."""
    return bool(cached_files(_ssim_rows))


def _rasterise(channels: Iterable[int]) -> None:
    camera = Camera(np.eye(4), 8, 8, 8.0, 8.0, 4.0, 4.0)
    shapes = torch.tensor([[1.0, 0.0, 0.0, 0.0]]), torch.full((1, 3), 0.1), torch.full((1,), 0.5)
    for count in channels:
        means = torch.tensor([[0.0, 0.0, -2.0]], requires_grad=True)
        drawn = rasterize(means, *shapes, torch.ones(1, count), camera, implementation="cpu")
        drawn.image.sum().backward()


def _ssim() -> None:
    ssim(torch.rand(3, 16, 16, requires_grad=True), torch.rand(3, 16, 16)).backward()


def _stereo() -> None:
    picture, place = np.zeros((8, 8), np.float32), np.zeros((1, 3, 64), np.float32)
    semi_global(matching_costs(picture, [picture], place, np.ones((1, 3), np.float32), np.ones(8)))


def _blur() -> None:
    gaussian_blur(torch.rand(3, 16, 16, requires_grad=True), 11, 3.0).sum().backward()


def _spherical_harmonics() -> None:
    rest = torch.zeros(2, 15, 3, requires_grad=True)
    evaluate_sh(torch.zeros(2, 3), rest, torch.ones(2, 3), torch.zeros(3), 3).sum().backward()


def _pointwise() -> None:
    x = torch.zeros(20, requires_grad=True)
    blend(corrected(log_of_exposure(x, 1.0), x), x, x).sum().backward()


def _activations() -> None:
    triples, ones = torch.zeros(8, 3, requires_grad=True), torch.zeros(8, 1)
    lit_colours(triples, ones, triples[:, None], (2.0,))[0].sum().backward()


def _bracket() -> None:
    radiance, knots = torch.ones(3, 16, 16, requires_grad=True), torch.linspace(-1.0, 1.0, 257)
    values = knots.expand(3, -1).contiguous()
    target = SsimTarget(torch.rand(3, 16, 16))
    errors = bracket_errors(radiance, [1.0], 1e-5, knots, values, values, [target], "l1")
    (errors[0] + errors[1]).sum().backward()


def _network(inputs: int, outputs: int) -> None:
    w1, w2 = torch.ones(8, inputs, requires_grad=True), torch.ones(outputs, 8)
    small_mlp(torch.zeros(inputs, 20), w1, torch.zeros(8), w2, torch.zeros(outputs), "relu").sum().backward()


def _local_curves(branches: int) -> None:
    w1, rest = torch.ones(3, 8, 1 + CONTEXT, requires_grad=True), torch.zeros(3, 8)
    x, context = torch.zeros(3, branches, 20), torch.zeros(CONTEXT, 20)
    local_curves(x, context, w1, rest, rest, rest[:, 0]).sum().backward()


def _curves(activation: Activation) -> None:
    w1, rest = torch.ones(3, 8, requires_grad=True), torch.zeros(3, 8)
    for points in (20, 20_000):  # one by one, and by the table
        curve_mlp(torch.zeros(3, points), w1, rest, rest, rest[:, 0], activation).sum().backward()
