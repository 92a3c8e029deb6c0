# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast, and with how much memory: pictures per second, iterations, what waits for the card."""

import dataclasses
import itertools
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import torch

from physhdr.backend.rasterize import rasterize
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State
from physhdr.backend.train.trainer import step

from . import truth
from .loading import ROOT
from .side import Side

sys.path.insert(0, str(ROOT / "benchmarks"))
import synthetic  # the Gaussians that `make benchmark` measures the CPU on

#: Iterations of a whole training, for the projection.
WHOLE = 30_000


@dataclass(frozen=True)
class Figure:
    """One measurement, and what it is to reach, where that was set (docs/performance.md)."""

    what: str
    value: float
    unit: str
    at_least: float | None = None
    at_most: float | None = None

    @property
    def target(self) -> str:
        if self.at_least is not None:
            return f"≥ {self.at_least:g}: {'met' if self.value >= self.at_least else 'missed'}"
        if self.at_most is not None:
            return f"≤ {self.at_most:g}: {'met' if self.value <= self.at_most else 'missed'}"
        return ""


def steady(preset: str) -> TrainConfig:
    """Late training, standing still: full SH, f_mix learning, no densification within what is timed."""
    config = PRESETS[preset]
    tone_mapper = dataclasses.replace(config.method.tone_mapper, warm_start_steps=0)
    return dataclasses.replace(
        config,
        iterations=WHOLE,
        optimiser=synthetic.STANDSTILL,
        backbone=dataclasses.replace(config.backbone, stop=1.0, every=1 << 30, reset_every=0),
        method=dataclasses.replace(config.method, tone_mapper=tone_mapper),
    )


def begun_state(side: Side, preset: str, count: int, size: int, views: int) -> State:
    """A run on the benchmark's Gaussians, with its pictures where they will be."""
    (means, quaternions, scales, opacities, _), _ = synthetic.gaussians(count, 3, size)
    scene = synthetic.scene(means.detach().numpy(), views, size)
    state = truth.begin_on(scene, steady(preset), side)
    parameters = state.method.gaussians.parameters
    with torch.no_grad():
        parameters["quaternions"].copy_(quaternions)
        parameters["log_scales"].copy_(scales.log())
        parameters["opacity_logits"].copy_(opacities.logit())
    for view, allowed in zip(state.views, state.data.exposures, strict=True):
        for k in allowed:
            state.data.pictures.get(view, k)
    state.iteration = int(synthetic.PROGRESS * WHOLE)
    return state


def preset(side: Side, name: str, count: int, size: int, views: int, repeats: int) -> Iterator[Figure]:
    """All figures of a preset at ``count`` Gaussians and ``size``² pixels."""
    side.forget_peak()
    with side.computing():
        state = begun_state(side, name, count, size, views)
        yield Figure(f"{name}: first iteration (networks compiled)", side.seconds(partial(step, state)), "s")
        for _ in range(max(1, repeats // 10)):
            step(state)
        seconds = side.seconds(partial(step, state), repeats)
        yield Figure(f"{name}: iteration", 1e3 * seconds, "ms")
        minutes = seconds * WHOLE / 60.0
        yield Figure(f"{name}: {WHOLE} such iterations", minutes, "min", at_most=5.0)
        yield from _peak(side, name)
        what = f"{name}: the host waits for the card, in an iteration"
        yield Figure(what, _waits(side, state), "times", at_most=1.0)

        method = state.method
        cameras = itertools.cycle([view.camera for view in state.views])
        side.seconds(lambda: method.ldr(next(cameras), 1.0), max(2, repeats // 10))
        ldr = side.seconds(lambda: method.ldr(next(cameras), 1.0), repeats)
        hdr = side.seconds(lambda: method.hdr(next(cameras)), repeats)
        yield Figure(f"{name}: LDR pictures", 1.0 / ldr, "/s", at_least=500.0)
        yield Figure(f"{name}: HDR pictures", 1.0 / hdr, "/s")


def rasteriser(side: Side, count: int, size: int, repeats: int, channels: int = 6) -> Iterator[Figure]:
    """Milliseconds of drawing ``count`` Gaussians in ``size``² pixels and of the way back."""
    leaves, camera = synthetic.gaussians(count, channels, size)
    leaves = [t.detach().to(side.device).requires_grad_() for t in leaves]
    grad = torch.rand(channels, size, size, generator=torch.Generator().manual_seed(0)).to(side.device)

    def forward() -> torch.Tensor:
        return rasterize(*leaves, camera, implementation=side.implementation).image

    def both() -> None:
        forward().backward(grad)

    with side.computing():
        side.seconds(both, max(2, repeats // 10))
        name = f"{count} Gaussians, {size}×{size}, {channels} channels"
        with torch.no_grad():
            yield Figure(f"{name}: drawn", 1e3 * side.seconds(forward, repeats), "ms")
        side.forget_peak()
        yield Figure(f"{name}: drawn and back", 1e3 * side.seconds(both, repeats), "ms")
        if allocated := side.peak_bytes()[0]:
            yield Figure(f"{name}: peak memory", allocated / 1e9, "GB")
        if side.implementation == "warp":
            torch.use_deterministic_algorithms(True)
            try:
                side.seconds(both, max(2, repeats // 10))
                yield Figure(f"{name}: with sorted accumulation", 1e3 * side.seconds(both, repeats), "ms")
            finally:
                torch.use_deterministic_algorithms(False)


def iterations(side: Side, preset: str, count: int, size: int, views: int, repeats: int) -> Iterator[Figure]:
    """Milliseconds of an iteration at one size, and the memory."""
    with side.computing():
        state = begun_state(side, preset, count, size, views)
        for _ in range(max(2, repeats // 10)):
            step(state)
        side.forget_peak()
        name = f"{preset}, {count} Gaussians, {size}×{size}"
        yield Figure(f"{name}: iteration", 1e3 * side.seconds(partial(step, state), repeats), "ms")
        if allocated := side.peak_bytes()[0]:
            yield Figure(f"{name}: peak memory", allocated / 1e9, "GB")


def _peak(side: Side, name: str) -> Iterator[Figure]:
    allocated, reserved = side.peak_bytes()
    if allocated:
        yield Figure(f"{name}: peak memory of tensors", allocated / 1e9, "GB", at_most=2.0)
        yield Figure(f"{name}: peak memory that torch held", reserved / 1e9, "GB")


def _waits(side: Side, state: State) -> float:
    """How often a step makes the host wait for the card, as torch counts it; once for the pairs."""
    if side.device.type != "cuda":
        return 0.0
    side.wait()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            step(state)
        finally:
            torch.cuda.set_sync_debug_mode("default")
    return float(sum("called a synchronizing" in str(warning.message) for warning in caught))


def profile(side: Side, name: str, count: int, size: int, rows: int = 25) -> str:
    """Where the time of ten iterations goes, by kernel: torch's own table."""
    activities = [torch.profiler.ProfilerActivity.CPU]
    if side.device.type == "cuda":
        activities.append(torch.profiler.ProfilerActivity.CUDA)
    with side.computing():
        state = begun_state(side, name, count, size, views=2)
        for _ in range(3):
            step(state)
        with torch.profiler.profile(activities=activities) as record:
            for _ in range(10):
                step(state)
            side.wait()
    key = "self_device_time_total" if side.device.type == "cuda" else "self_cpu_time_total"
    return record.key_averages().table(sort_by=key, row_limit=rows, max_name_column_width=60)
