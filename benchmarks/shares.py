# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the time of an iteration goes.

A stopwatch is put around the parts of the running program (its kernels, the autograd functions that call
them, the loss, the optimiser) for as long as the measurement lasts; the product knows nothing of it. Parts
nest, and each counts only the time that no part inside it counted. What is written in plain torch between
the kernels therefore turns up under the part that surrounds it: "torch between kernels".

Only the main thread's clock is read. It draws tickets like every other worker, and waits for them, so its
time is the time that passes; the wait for the slowest worker counts for the surrounding part.
"""

import functools
import importlib
import inspect
import pkgutil
import statistics
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from synthetic import LEARNED, SIZE, trained_state

from physhdr.backend import kernels
from physhdr.backend.methods.physhdr_common import PhysHDRMethod
from physhdr.backend.rasterize import cpu
from physhdr.backend.train import densify, trainer
from physhdr.backend.train.optimisers import Optimiser

REST = "torch between kernels"
OTHER = "pictures, schedules, rest"
#: What the modules of backend/kernels are called here; a new one goes by its own name.
PART_OF_MODULE = {
    "activations": "colours",
    "blur": "blur",
    "bracket": "developed and compared",
    "curve_table": "networks",
    "local_curves": "local curves",
    "mlp": "networks",
    "spherical_harmonics": "SH",
    "ssim": "SSIM",
}


class Stopwatch:
    """Seconds by (part, direction); directions are ``forward`` and ``backward``."""

    def __init__(self) -> None:
        self.seconds: dict[tuple[str, str], float] = defaultdict(float)
        self._stack: list[float] = []  # of the open parts: seconds that parts inside them have taken
        self._undo: list[tuple[Any, str, Any]] = []
        self._thread = threading.get_ident()

    def timed(self, function: Callable[..., Any], part: str, direction: str) -> Callable[..., Any]:
        """``function``, with its time counted under ``part`` when the main thread calls it."""

        @functools.wraps(function)
        def wrapper(*arguments: Any, **keywords: Any) -> Any:
            if threading.get_ident() != self._thread:
                return function(*arguments, **keywords)
            self._stack.append(0.0)
            start = time.perf_counter()
            try:
                return function(*arguments, **keywords)
            finally:
                elapsed = time.perf_counter() - start
                self.seconds[part, direction] += elapsed - self._stack.pop()
                if self._stack:
                    self._stack[-1] += elapsed

        return wrapper

    def put_around(self, owner: Any, name: str, part: str, direction: str) -> None:
        """Time ``owner.name`` (of a class or a module) until ``take_off``."""
        original = inspect.getattr_static(owner, name)
        static = isinstance(original, staticmethod)
        wrapped = self.timed(original.__func__ if static else original, part, direction)
        self._undo.append((owner, name, original))
        setattr(owner, name, staticmethod(wrapped) if static else wrapped)

    def put_around_functions(self, module: Any, part: str) -> None:
        """Time forward and backward of every autograd function that ``module`` defines."""
        for value in list(vars(module).values()):
            if (
                isinstance(value, type)
                and issubclass(value, torch.autograd.Function)
                and value.__module__ == module.__name__
            ):
                for direction in ("forward", "backward"):
                    self.put_around(value, direction, part, direction)

    def take_off(self) -> None:
        """Put everything back as it was."""
        while self._undo:
            setattr(*self._undo.pop())


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """A stopwatch around every part of ``trainer.step``."""
    watch = Stopwatch()
    try:
        watch.put_around(trainer, "step", OTHER, "forward")
        watch.put_around(PhysHDRMethod, "training_outcome", REST, "forward")
        watch.put_around(torch.Tensor, "backward", REST, "backward")
        watch.put_around(densify, "observe", "densification's statistics", "forward")
        watch.put_around(Optimiser, "step", "optimiser", "forward")
        watch.put_around(kernels.SsimTarget, "__init__", "SSIM", "forward")
        watch.put_around_functions(cpu, "projection and binning")
        watch.put_around(cpu, "draw", "tiles", "forward")
        watch.put_around(cpu, "draw_backward", "tiles", "backward")
        for module in pkgutil.iter_modules(kernels.__path__):
            watch.put_around_functions(
                importlib.import_module(f"{kernels.__name__}.{module.name}"),
                PART_OF_MODULE.get(module.name, module.name),
            )
        yield watch
    finally:
        watch.take_off()


def shares(
    preset: str, count: int, steps: int = 15, size: int = SIZE, learned: int = LEARNED
) -> dict[str, dict[str, float]]:
    """Median milliseconds of each part of an iteration, by direction, the costliest part first.

    Of a state that has ``learned`` for so many iterations.
    """
    state = trained_state(preset, count, size, learned)
    samples: dict[tuple[str, str], list[float]] = defaultdict(list)
    with stopwatch() as watch:
        for _ in range(3):
            trainer.step(state)
        for _ in range(steps):
            watch.seconds.clear()
            trainer.step(state)
            for key, seconds in watch.seconds.items():
                samples[key].append(1e3 * seconds)
    parts: dict[str, dict[str, float]] = {}
    for (part, direction), times in samples.items():
        parts.setdefault(part, {"forward": 0.0, "backward": 0.0})[direction] = statistics.median(times)
    return dict(sorted(parts.items(), key=lambda item: -sum(item[1].values())))
