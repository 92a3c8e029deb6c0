# SPDX-License-Identifier: GPL-3.0-or-later
"""The two sides that are compared: the card, and the CPU as the oracle."""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from physhdr.backend.kernels import plain_torch
from physhdr.backend.rasterize import Implementation, rasterize
from physhdr.backend.rasterize.card import warp_on_cpu
from physhdr.backend.scene.camera import Camera


@dataclass(frozen=True)
class Side:
    """Where something is computed, by which rasteriser, and whether by the plain-torch twins."""

    name: str
    device: torch.device
    implementation: Implementation
    plain: bool = False

    @contextlib.contextmanager
    def computing(self) -> Iterator[None]:
        plain = plain_torch() if self.plain else contextlib.nullcontext()
        is_stand_in = self.implementation == "warp" and self.device.type == "cpu"
        with plain, warp_on_cpu() if is_stand_in else contextlib.nullcontext():
            yield

    def wait(self) -> None:
        """Until everything that was asked of the device is done."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    def forget_peak(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.empty_cache()
            torch.cuda.reset_peak_memory_stats(self.device)

    def peak_bytes(self) -> tuple[int, int]:
        """The most that tensors took since ``forget_peak``, and the most that torch held for them."""
        if self.device.type == "cuda":
            return torch.cuda.max_memory_allocated(self.device), torch.cuda.max_memory_reserved(self.device)
        return 0, 0

    def seconds(self, work: Callable[[], object], repeats: int = 1) -> float:
        """Seconds that one call of ``work`` takes, the mean of ``repeats`` in a row."""
        self.wait()
        start = time.perf_counter()
        for _ in range(repeats):
            work()
        self.wait()
        return (time.perf_counter() - start) / repeats


def oracle(has_numba: bool) -> Side:
    """The CPU's kernels; plain torch where there is no Numba, or one that cannot compile them."""
    cpu = torch.device("cpu")
    if not has_numba:
        return Side("plain torch on the CPU", cpu, "reference", plain=True)
    camera = Camera(np.eye(4), 4, 4, 4.0, 4.0, 2.0, 2.0)
    try:
        rasterize(
            torch.tensor([[0.0, 0.0, -1.0]]),
            *(torch.ones(1, 4), torch.ones(1, 3), torch.full((1,), 0.5), torch.ones(1, 3)),
            camera,
            implementation="cpu",
        )
    except Exception as error:  # noqa: BLE001 (a Numba of another version can fail in any way)
        name = f"plain torch on the CPU (its kernels cannot be compiled: {type(error).__name__})"
        return Side(name, cpu, "reference", plain=True)
    return Side("CPU kernels", cpu, "cpu")
