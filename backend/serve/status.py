# SPDX-License-Identifier: GPL-3.0-or-later
"""What clients are told of the engine's state: the newest status, and how its words are made."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import torch

from ...bridge.messages import JobStatus

#: States in which a training is under way or about to be.
RUNNING = ("preparing", "training", "paused", "stopping")


class Status:
    """The newest ``JobStatus``, ``now``; ``publish`` is called with each that is told."""

    def __init__(self, publish: Callable[[JobStatus], None]) -> None:
        self._publish = publish
        self.now = JobStatus()

    @property
    def is_running(self) -> bool:
        """Whether a training is under way, or about to be."""
        return self.now.state in RUNNING

    def tell(self, status: JobStatus) -> None:
        """Another status; where it names no device it is that of the one before."""
        if not status.device:
            status = dataclasses.replace(status, device=self.now.device)
        self.now = status
        self._publish(status)

    def change(self, **changes: Any) -> None:
        """The same status but for ``changes``, told at once."""
        self.tell(dataclasses.replace(self.now, **changes))

    def note(self, **changes: Any) -> None:
        """As ``change``, told with the next status: nothing is sent more often than that."""
        self.now = dataclasses.replace(self.now, **changes)


def device_words(device: torch.device) -> str:
    """``cpu``, or ``cuda (name of the card)``."""
    return "cpu" if device.type == "cpu" else f"cuda ({torch.cuda.get_device_name(device)})"


def finite(values: dict[str, float]) -> dict[str, float]:
    """Without infinities (the PSNR of equal pictures) and NaN: JSON has no words for them."""
    return {name: value for name, value in values.items() if math.isfinite(value)}
