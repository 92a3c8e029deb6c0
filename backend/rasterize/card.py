# SPDX-License-Identifier: GPL-3.0-or-later
"""The two ways to compute on a CUDA card, and which of them works here.

``warp``: NVIDIA Warp's; they need a driver and wheels. ``cuda``: gsplat's kernels, and networks through
``torch.compile``; both need compilers on the machine, and their time. Warp's are taken where they work,
gsplat's where they do not. ``using`` overrides that, for comparisons and tests.
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
_as_on_card: ContextVar[bool] = ContextVar("cpu_computes_as_a_card", default=False)


@contextmanager
def using(way: Way, *, on_cpu: bool = False) -> Iterator[None]:
    """Inside, this thread computes on a card in that way.

    ``on_cpu``: on the CPU, too, which only ``warp`` can (tests). Otherwise the CPU has its own kernels.
    """
    tokens = _forced.set(way), _as_on_card.set(on_cpu)
    try:
        yield
    finally:
        _forced.reset(tokens[0])
        _as_on_card.reset(tokens[1])


def cpu_computes_as_a_card() -> bool:
    """Whether ``using`` says that Warp's kernels compute on the CPU, too."""
    return _as_on_card.get() and _forced.get() == "warp"


def way() -> Way | None:
    """How to compute on this machine's card; None where neither way works. May build gsplat (minutes)."""
    return _forced.get() or _working()[0]


def unavailable_reason() -> str | None:
    """Why nothing can be computed on a card here, or None where something can."""
    return _working()[1]


def warp_takes(*tensors: torch.Tensor) -> bool:
    """Whether Warp's kernels are to compute these: float32 on a card, by the way that is taken."""
    if any(tensor.dtype != torch.float32 for tensor in tensors):
        return False
    return cpu_computes_as_a_card() or (all(tensor.is_cuda for tensor in tensors) and way() == "warp")


@cache
def _working() -> tuple[Way | None, str | None]:
    """The way that works, and why none does."""
    if not torch.cuda.is_available():
        return None, "torch sees no CUDA device"
    of_warp = warp_unavailable_reason()
    if of_warp is None:
        return "warp", None
    from . import cuda

    of_gsplat = cuda.unavailable_reason()
    return ("cuda", None) if of_gsplat is None else (None, f"{of_warp}; {of_gsplat}")


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
