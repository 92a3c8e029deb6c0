# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's resources: threads, the device, memory, compiled kernels."""

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

#: Channels of a preview (radiance and depth), whose kernels are compiled with the method's own.
PREVIEW_CHANNELS = 4


class Machine:
    """``device``, ``threads`` (0: one per core): defaults for requests."""

    def __init__(self, device: DeviceName, threads: int) -> None:
        self._default_device: DeviceName = device
        self._default_threads = threads or thread_count()

    def use_threads(self, requested: int) -> None:
        """Compute with this many threads from now on; 0: the default."""
        count = requested or self._default_threads
        set_threads(count)
        torch.set_num_threads(count)

    def device_for(self, requested: DeviceName) -> DeviceName:
        """The requested device, or the default one."""
        return self._default_device if requested == "auto" else requested

    def default_device(self) -> tuple[str, str]:
        """The default device's name and why it was chosen; "" and why not, if it is unavailable."""
        try:
            device, why = choose_device(self._default_device)
        except BadValueError as error:
            return "", error.message  # requests for another device still work
        return device_words(device), why


def compile_kernels(needs: Needs, report: Callable[[str], None]) -> None:
    """Compile the kernels of a method and its previews; calls ``report`` for each."""
    compile_ahead(
        needs | Needs(channels=(PREVIEW_CHANNELS,)),
        lambda what, done, total: report(f"compiling kernels {done}/{total}: {what}"),
    )


def free_memory() -> None:
    """Release unused memory: the card's, and the heap's (``simd.heap``)."""
    gc.collect()
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
    give_back_freed_memory()
