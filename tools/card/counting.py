# SPDX-License-Identifier: GPL-3.0-or-later
"""What an iteration asks of a card, counted on the CPU: launches, and bytes that they read and write.

A launch is a tensor operation that computes (views and allocations do not) or a kernel of Warp's. Bytes are
those of its tensors, each once: what a kernel reads again is taken to come from the cache, and what few
threads read of many to be read by all. With a card's bandwidth and the host's time for a launch these give a
prediction, until something is measured.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

_ALLOCATIONS = ("empty", "new_empty", "empty_like", "empty_strided", "new_empty_strided", "detach")


@dataclass
class Count:
    """``torch``: tensor operations; ``warp``: kernels of Warp's; ``bytes`` of both."""

    torch: int = 0
    warp: int = 0
    bytes: int = 0


@contextmanager
def counting() -> Iterator[Count]:
    """Counts what is launched inside by this thread."""
    from physhdr.backend import kernels  # noqa: F401 (imports whatever replaces ``launch`` below by name)
    from physhdr.backend.kernels.card import harmonics, networks, similarity
    from physhdr.backend.rasterize.warp import arrays, lists, stages

    count = Count()

    def launch(kernel: Any, threads: Any, arguments: Any, *rest: Any) -> None:
        count.warp += 1
        count.bytes += sum(a.tensor.nbytes for a in arguments if isinstance(a, arrays.Array))
        arrays.launch(kernel, threads, arguments, *rest)

    class Mode(TorchDispatchMode):
        def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            result = func(*args, **(kwargs or {}))
            taken = [t for t in tree_leaves((args, kwargs)) if isinstance(t, torch.Tensor)]
            results = [t for t in tree_leaves(result) if isinstance(t, torch.Tensor)]
            storages = {t.untyped_storage().data_ptr() for t in taken if t.numel()}
            new = [t for t in results if t.untyped_storage().data_ptr() not in storages]
            changes = func._schema.is_mutable
            if (new or changes) and func._schema.name.split("::")[-1] not in _ALLOCATIONS:
                count.torch += 1
                # What is changed in place is read and written, and it is in both lists.
                count.bytes += sum(t.nbytes for t in taken) + sum(
                    t.nbytes for t in (results if changes else new)
                )
            return result

    modules = (stages, lists, harmonics, networks, similarity)
    for module in modules:
        module.launch = launch
    try:
        with Mode():
            yield count
    finally:
        for module in modules:
            module.launch = arrays.launch
