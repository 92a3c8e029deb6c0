# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain-torch twins on a CUDA card, fused by ``torch.compile`` (which writes Triton kernels).

As separate operations a network of 64 hidden units writes and reads 123 MB several times for a picture of
400×400, and keeps two such tensors for backward. Compiled, the response curves keep nothing but their input.
Where compiling does not work (no Triton, no C compiler) the twin runs as it is, and a warning says so once.
"""

import functools
import types
import warnings
from collections.abc import Callable, Hashable
from typing import Any

import torch

from .plain import can_fuse

#: What ``torch.compile`` compiles with; tests take one that needs no compiler.
BACKEND = "inductor"


def compiled_on_cuda(twin: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
    """``twin``, compiled when its first argument is on a card (and not inside ``plain_torch``).

    Tensors of a network's weights must keep their shapes; the number of points may change freely.
    """

    @functools.wraps(twin)
    def run(*arguments: Any) -> torch.Tensor:
        points, *weights = arguments
        if not points.is_cuda or not can_fuse() or not _works():
            return twin(*arguments)
        shapes = tuple(tuple(w.shape) if isinstance(w, torch.Tensor) else w for w in weights)
        return compiled(twin, (shapes, torch.is_grad_enabled()))(*arguments)

    return run


@functools.cache
def compiled(function: Callable[..., torch.Tensor], key: Hashable) -> Callable[..., torch.Tensor]:
    """``function`` compiled for its own ``key``, for any number of points.

    Torch counts the variants of one code object and gives up at eight, which the networks of a method, each
    with and without gradients, would reach. So every key has a code object of its own.
    """
    code = function.__code__.replace(co_name=f"{function.__name__}_{abs(hash(key))}")
    copy = types.FunctionType(code, function.__globals__, None, function.__defaults__, function.__closure__)
    return torch.compile(copy, dynamic=True, backend=BACKEND)


@functools.cache
def _works() -> bool:
    """Whether a small function can be compiled for the card and run there, forward and backward."""
    try:
        x = torch.linspace(-1.0, 1.0, 64, device="cuda").requires_grad_()
        # Straight through the same machinery, so that whatever can fail fails here.
        y = compiled(_probe, "probe")(x)
        y.backward()
        return bool(torch.isfinite(y)) and x.grad is not None
    except Exception as error:  # noqa: BLE001 (compilers fail in many ways; none may end a training)
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        warnings.warn(
            f"torch.compile does not work here ({reason}): networks run unfused on the card, which is slower "
            "and takes about half a GB more for a picture of 400×400",
            stacklevel=2,
        )
        return False


def _probe(x: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.softplus(x * 2.0).sum()
