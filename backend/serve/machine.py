# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine computes with: threads, the device, memory that is given back, compiled kernels."""

import gc
import logging
from collections.abc import Callable

import torch

from ...bridge.errors import BadValueError
from ..device import DeviceName, choose_device
from ..kernels.ahead import Needs, compile_ahead
from ..rasterize.cpu import set_threads, thread_count
from ..simd import give_back_freed_memory
from .status import device_words

log = logging.getLogger(__name__)

#: A preview draws radiance and depth; the kernels for so many channels are compiled with the method's own.
PREVIEW_CHANNELS = 4


class Machine:
    """``device``, ``threads`` (0: one a core): what is used where a request leaves it open."""

    def __init__(self, device: DeviceName, threads: int) -> None:
        self._default_device: DeviceName = device
        self._default_threads = threads or thread_count()

    def use_threads(self, asked: int) -> None:
        """Compute with ``asked`` threads from now on; 0: the default."""
        count = asked or self._default_threads
        set_threads(count)
        torch.set_num_threads(count)

    def device_for(self, asked: DeviceName) -> DeviceName:
        """The device that a request asks for, or the default one."""
        return self._default_device if asked == "auto" else asked

    def default_device(self) -> tuple[str, str]:
        """The device in words and why it is that; no device and why not, where there is none as wanted."""
        try:
            device, why = choose_device(self._default_device)
        except BadValueError as error:
            return "", error.message  # a training that asks for another one still works
        return device_words(device), why


def compile_kernels(needs: Needs, report: Callable[[str], None]) -> None:
    """The kernels of a method and of its previews; ``report`` is told of each."""
    compile_ahead(
        needs | Needs(channels=(PREVIEW_CHANNELS,)),
        lambda what, done, total: report(f"compiling kernels {done}/{total}: {what}"),
    )


def free_memory() -> None:
    """Give back what nobody uses any more: the card's, and what the heap keeps (``simd.heap``)."""
    gc.collect()
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
    give_back_freed_memory()
