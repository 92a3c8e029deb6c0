# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""What all Warp kernels here are launched with: torch's tensors, torch's device, torch's current stream.

Every buffer is allocated through torch, so there is one memory pool; Warp gets descriptors of tensors (3 µs
each, where ``wp.array`` objects take 20). Descriptors keep their tensor alive, and what torch frees is used
again in the order of the stream on which all of this runs.
"""

import threading
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

import torch

# Not an import statement: type checkers take the name, inside a package of the same, for that package.
wp: Any = import_module("warp")

# Warp says on standard output what it compiles; there progress and results are read.
wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
wp.init()  # looks for devices; device_from_torch does not do it

#: Threads of a block where it does not matter.
BLOCK = 256

_ready: set[tuple[int, str, int]] = set()
_loading = threading.Lock()


def array(tensor: torch.Tensor, dtype: Any) -> Any:
    """A contiguous tensor for a kernel; of vector types the last dimension is the vector."""
    return wp.from_torch(tensor, dtype, requires_grad=False, return_ctype=True)


def launch(
    kernel: Any,
    threads: int | tuple[int, ...],
    arguments: Sequence[Any],
    device: torch.device,
    block: int = BLOCK,
) -> None:
    """Run ``kernel`` in ``threads`` threads on torch's current stream; 0 threads do nothing.

    The first launch compiles its module, or loads it from Warp's cache: one thread of ours at a time.
    """
    if threads == 0 or (isinstance(threads, tuple) and 0 in threads):
        return
    stream = None
    if device.type == "cuda":
        stream = _stream(torch.cuda.current_stream(device))
    target = _device(device)
    key = (id(kernel), target.alias, block)
    if key in _ready:
        wp.launch(kernel, threads, arguments, device=target, stream=stream, block_dim=block)
        return
    with _loading:
        wp.launch(kernel, threads, arguments, device=target, stream=stream, block_dim=block)
        _ready.add(key)


@cache
def _device(device: torch.device) -> Any:
    return wp.device_from_torch(device)


@cache
def _stream(stream: "torch.cuda.Stream") -> Any:
    """Kept: torch has a fixed number of streams, and Warp registers each that it is shown."""
    return wp.stream_from_torch(stream)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const float4 four = reinterpret_cast<const float4*>(rows.data)[row];
    return wp::vec_t<4, wp::float32>(four.x, four.y, four.z, four.w);
#else
    return rows.data[row];
#endif
""")
def load4(rows: wp.array[wp.vec4], row: int) -> wp.vec4:  # pyright: ignore[reportReturnType]
    """``rows[row]`` in one instruction of 16 bytes; Warp's own vectors are loaded number by number.

    Torch's allocations begin at multiples of 64 bytes at least.
    """
    ...
