# SPDX-License-Identifier: GPL-3.0-or-later
"""Computing on a CUDA card: by NVIDIA Warp, which needs a driver and a wheel. Does it work here?"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

import torch

from ...bridge.errors import BadValueError
from .contract import Rasterization
from .trial import first_line, try_out

WARP_MISSING = "warp-lang is not installed"
INSTALL_WARP = (
    "Install it beside torch: pip install warp-lang "
    "(where NVIDIA's driver is older than R580: 'warp-lang<1.18')."
)

# A context variable, so that a preview that renders in another thread is not affected.
_as_on_card: ContextVar[bool] = ContextVar("cpu_computes_as_a_card", default=False)


@contextmanager
def warp_on_cpu() -> Iterator[None]:
    """Inside, this thread computes by Warp's kernels on the CPU, too (tests), which has its own otherwise."""
    token = _as_on_card.set(True)
    try:
        yield
    finally:
        _as_on_card.reset(token)


def cpu_computes_as_a_card() -> bool:
    """Whether this thread is inside ``warp_on_cpu``."""
    return _as_on_card.get()


def warp_takes(*tensors: torch.Tensor) -> bool:
    """Whether Warp's kernels are to compute these: float32 on a card where they work."""
    if any(tensor.dtype != torch.float32 for tensor in tensors):
        return False
    return cpu_computes_as_a_card() or (
        all(tensor.is_cuda for tensor in tensors) and unavailable_reason() is None
    )


@cache
def unavailable_reason() -> str | None:
    """Why nothing can be computed on this machine's card, or None.

    Compiles Warp's kernels at first (seconds) and draws a Gaussian, so that a driver, a card or a version
    that does not fit is found here, not in training.
    """
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        error = try_out(warp_rasterize(), torch.device("cuda"))
    except BadValueError:
        return WARP_MISSING
    except Exception as exception:  # noqa: BLE001 (drivers fail in many ways; the reason is passed on)
        return f"Warp's kernels do not run: {first_line(exception)}"
    return None if error < 1e-3 else f"Warp's kernels draw a Gaussian wrongly (by {error:g})"


def warp_rasterize() -> Callable[..., Rasterization]:
    """``warp.rasterize``; raises ``BadValueError`` with the remedy where warp-lang is missing."""
    try:
        from .warp import rasterize
    except ModuleNotFoundError as error:
        if error.name != "warp":
            raise
        raise BadValueError(f"the rasteriser 'warp' cannot be used: {WARP_MISSING}", INSTALL_WARP) from error
    return rasterize
