# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""What all Warp kernels here are launched with: torch's tensors, torch's device, torch's current stream.

Every buffer is allocated through torch, so there is one memory pool, and what torch frees is used again in
the order of the stream on which all of this runs. Each thread of ours records a kernel's launch once, and
from then on writes into it what is new, as a rule the addresses of tensors: ``wp.launch`` packs all arguments
anew, which takes seven times as long.
"""

import threading
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import torch

# Not an import statement: type checkers take the name, inside a package of the same, for that package.
wp: Any = import_module("warp")

# Warp says on standard output what it compiles; there progress and results are read.
wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
wp.init()  # looks for devices; device_from_torch does not do it

#: Threads of a block where it does not matter.
BLOCK = 256

_loading = threading.Lock()

Threads = int | tuple[int, ...]


class Array(NamedTuple):
    """A contiguous tensor as a kernel is to see it: of vector types its last dimension is the vector."""

    tensor: torch.Tensor
    dtype: Any


class _Recorded:
    """The launch of a kernel in blocks of one size on one device. It keeps no tensor alive."""

    def __init__(self, kernel: Any, threads: Threads, arguments: Sequence[Any], device: Any, block: int):
        #: What the launch has of each argument, addresses apart.
        self._has = [_all_but_address(argument) for argument in arguments]
        self._descriptors: list[Any] = [_descriptor(a) if isinstance(a, Array) else None for a in arguments]
        self._threads = threads
        packed = [d if isinstance(a, Array) else a for a, d in zip(arguments, self._descriptors, strict=True)]
        self._launch = wp.launch(kernel, threads, packed, device=device, block_dim=block, record_cmd=True)

    def run(self, threads: Threads, arguments: Sequence[Any], stream: Any) -> None:
        if threads != self._threads:
            self._launch.set_dim(threads)
            self._threads = threads
        for index, argument in enumerate(arguments):
            rest = _all_but_address(argument)
            if rest == self._has[index]:
                if isinstance(argument, Array):
                    self._descriptors[index].data = argument.tensor.data_ptr()
                continue
            if isinstance(argument, Array):
                value = self._descriptors[index] = _descriptor(argument)
            else:
                value = argument.__ctype__() if hasattr(argument, "__ctype__") else argument
            self._launch.set_param_at_index_from_ctype(index, value)
            self._has[index] = rest
        self._launch.launch(stream)


def _all_but_address(argument: Any) -> Any:
    if isinstance(argument, Array):
        tensor, dtype = argument
        return tensor.shape, tensor.stride(), tensor.dtype, dtype
    return argument


def _descriptor(array: Array) -> Any:
    descriptor = wp.from_torch(array.tensor, array.dtype, requires_grad=False, return_ctype=True)
    descriptor._ref = None  # the tensor, which whoever launches has
    return descriptor


class _Launches(threading.local):
    """A thread's own: between what is written into a launch and its start, no other may write."""

    def __init__(self) -> None:
        self.recorded: dict[tuple[Any, str, int, bool], _Recorded] = {}


_launches = _Launches()


def launch(
    kernel: Any,
    threads: Threads,
    arguments: Sequence[Any],
    device: torch.device,
    block: int = BLOCK,
) -> None:
    """Run ``kernel`` in ``threads`` threads on torch's current stream; 0 threads do nothing.

    ``arguments``: ``Array``s, numbers and Warp's structs. The first launch compiles the kernel's
    module, or loads it from Warp's cache: one thread of ours at a time.
    """
    if threads == 0 or (isinstance(threads, tuple) and 0 in threads):
        return
    stream = None
    if device.type == "cuda":
        stream = _stream(torch.cuda.current_stream(device))
    target = _device(device)
    # On the CPU a launch is recorded for blocks of threads, or for threads one after the other.
    key = (kernel, target.alias, block, getattr(wp.config, "enable_cpu_blocks", False))
    recorded = _launches.recorded.get(key)
    if recorded is None:
        with _loading:
            recorded = _Recorded(kernel, threads, arguments, target, block)
        _launches.recorded[key] = recorded
    recorded.run(threads, arguments, stream)


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
