# SPDX-License-Identifier: GPL-3.0-or-later
"""The threads that run Numba's ``nogil`` kernels.

Kernels never depend on how the work was split: they write disjoint outputs, and sums over jobs are
taken afterwards in a fixed order. So results are bit-identical for any number of threads. All of them flush
denormals (``denormals``); the caller's thread is afterwards as it was.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from ...bridge.cores import usable_cores
from ...bridge.limits import THREADS_MAX, whole
from .denormals import flush_denormals, restore_denormals

T = TypeVar("T")


class _Pool:
    """``count`` threads, the caller's being one of them."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._helpers = (
            ThreadPoolExecutor(count - 1, "physhdr", initializer=flush_denormals) if count > 1 else None
        )

    def run(self, job: Callable[[int], T]) -> list[T]:
        """Call ``job(0) … job(count − 1)`` at the same time, wait for all of them, return what they did."""
        before = flush_denormals()
        waiting = [self._helpers.submit(job, i) for i in range(1, self.count)] if self._helpers else []
        try:
            mine = job(0)
        finally:
            restore_denormals(before)
            others = [future.result() for future in waiting]
        return [mine, *others]

    def close(self) -> None:
        if self._helpers:
            self._helpers.shutdown()


_pool = _Pool(min(usable_cores(), THREADS_MAX))


def set_threads(count: int) -> None:
    """Use ``count`` threads from now on. Results do not depend on it."""
    global _pool
    if whole("the number of threads", count, 1, THREADS_MAX) != _pool.count:
        _pool.close()
        _pool = _Pool(count)


def thread_count() -> int:
    """How many threads kernels run on."""
    return _pool.count


def run_parallel(job: Callable[[int], T]) -> list[T]:
    """Call ``job(worker)`` once on every thread; workers share the work by a ticket counter or by range."""
    return _pool.run(job)


def ranges(count: int) -> np.ndarray:
    """Edges ``[threads + 1]`` of contiguous ranges that cover ``range(count)``, one a thread."""
    # Multiples of 16 keep SIMD groups (and cache lines of outputs) whole.
    edges = (np.linspace(0, count, _pool.count + 1) / 16).astype(np.int64) * 16
    edges[-1] = count
    return edges


def run_ranges(kernel: Callable[..., object], count: int, *arguments: object, minimum: int = 1024) -> None:
    """Call ``kernel(first, last, *arguments)`` on contiguous ranges that cover ``range(count)``."""
    if count < minimum or _pool.count == 1:
        before = flush_denormals()
        try:
            kernel(0, count, *arguments)
        finally:
            restore_denormals(before)
        return
    edges = ranges(count)
    _pool.run(lambda i: kernel(edges[i], edges[i + 1], *arguments))
