# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused kernel or plain torch: the one place that decides.

Plain torch computes what the fused kernels cannot (float64; on a card whatever Warp's do not), and what they
are measured against (``plain_torch``, for benchmarks and tests).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

from ..rasterize.card import cpu_computes_as_a_card, warp_takes

# A context variable, so that a preview that renders in another thread stays fused.
_plain: ContextVar[bool] = ContextVar("plain_torch", default=False)


@contextmanager
def plain_torch() -> Iterator[None]:
    """Inside, every function of ``backend.kernels`` that this thread calls goes to its ``_reference`` twin.

    The choice is made in the forward pass; backward follows it wherever it is called. The rasteriser has a
    switch of its own: ``implementation="reference"``.
    """
    token = _plain.set(True)
    try:
        yield
    finally:
        _plain.reset(token)


def can_fuse(*tensors: torch.Tensor) -> bool:
    """Whether the CPU's kernels may take these: all float32 on the CPU, and not inside ``plain_torch`` (nor
    where the CPU computes as a card would, ``card.warp_on_cpu``)."""
    if _plain.get() or cpu_computes_as_a_card():
        return False
    return all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors)


def card_takes(*tensors: torch.Tensor) -> bool:
    """Whether Warp's kernels are to take these (``card.warp_takes``), and not inside ``plain_torch``."""
    return not _plain.get() and warp_takes(*tensors)
