# SPDX-License-Identifier: GPL-3.0-or-later
"""The two ways to compute on a CUDA card, and which of them works here.

``cuda``: gsplat's kernels, and networks through ``torch.compile``; both need compilers on the machine.
``warp``: NVIDIA Warp's; they need a driver and wheels. gsplat is taken where it works, because it has been
measured by others; Warp where it does not. ``using`` overrides that, for comparisons and tests.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Literal

import torch

from ...bridge.errors import BadValueError
from .contract import Rasterization
from .trial import first_line, try_out

Way = Literal["cuda", "warp"]

WARP_MISSING = "warp-lang is not installed"
INSTALL_WARP = (
    "Install it beside torch: pip install warp-lang "
    "(where NVIDIA's driver is older than R580: 'warp-lang<1.18')."
)

# A context variable, so that a preview that renders in another thread goes on as it was.
_forced: ContextVar[Way | None] = ContextVar("way_to_compute_on_a_card", default=None)


@contextmanager
def using(way: Way) -> Iterator[None]:
    """Inside, this thread computes on a card in that way; by ``warp`` on the CPU, too, for tests."""
    token = _forced.set(way)
    try:
        yield
    finally:
        _forced.reset(token)


def forced() -> Way | None:
    """What ``using`` says, or None."""
    return _forced.get()


def way() -> Way | None:
    """How to compute on this machine's card; None where neither way works. May build gsplat (minutes)."""
    return _forced.get() or _working()[0]


def unavailable_reason() -> str | None:
    """Why nothing can be computed on a card here, or None where something can."""
    return _working()[1]


def warp_takes(*tensors: torch.Tensor) -> bool:
    """Whether Warp's kernels are to compute these: float32 on a card that has nothing better."""
    if any(tensor.dtype != torch.float32 for tensor in tensors):
        return False
    if _forced.get() is not None:
        return _forced.get() == "warp"
    return all(tensor.is_cuda for tensor in tensors) and way() == "warp"


@cache
def _working() -> tuple[Way | None, str | None]:
    """The way that works, and why none does."""
    if not torch.cuda.is_available():
        return None, "torch sees no CUDA device"
    from . import cuda

    of_gsplat = cuda.unavailable_reason()
    if of_gsplat is None:
        return "cuda", None
    of_warp = warp_unavailable_reason()
    return ("warp", None) if of_warp is None else (None, f"{of_gsplat}; {of_warp}")


@cache
def warp_unavailable_reason() -> str | None:
    """Why Warp's kernels cannot be used on this machine's card, or None. Compiles them at first (seconds)."""
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
