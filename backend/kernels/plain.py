# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused kernel or plain torch: the one place that decides.

Plain torch computes what the fused kernels cannot (float64, CUDA), and what they are measured against
(``plain_torch``, for benchmarks and tests).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch

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
    """Whether a fused kernel may take these: all float32 on the CPU, and not inside ``plain_torch``."""
    return not _plain.get() and all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors)
