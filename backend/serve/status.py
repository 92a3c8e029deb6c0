# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's state for clients: the newest status, and how its texts are made."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import torch

from ...bridge.messages import JobStatus

#: States in which a training runs or is about to.
RUNNING = ("preparing", "training", "paused", "stopping")


class Status:
    """The newest ``JobStatus``, ``now``; ``publish`` is called with each that is sent."""

    def __init__(self, publish: Callable[[JobStatus], None]) -> None:
        self._publish = publish
        self.now = JobStatus()

    @property
    def is_running(self) -> bool:
        """Whether a training runs or is about to."""
        return self.now.state in RUNNING

    def replace(self, status: JobStatus) -> None:
        """Publish a new status; without a device, it keeps that of the last one."""
        if not status.device:
            status = dataclasses.replace(status, device=self.now.device)
        self.now = status
        self._publish(status)

    def change(self, **changes: Any) -> None:
        """Publish the same status with ``changes`` at once."""
        self.replace(dataclasses.replace(self.now, **changes))

    def note(self, **changes: Any) -> None:
        """As ``change``, but published with the next status, to limit how often it is sent."""
        self.now = dataclasses.replace(self.now, **changes)


def device_words(device: torch.device) -> str:
    """``cpu``, or ``cuda (name of the card)``."""
    return "cpu" if device.type == "cpu" else f"cuda ({torch.cuda.get_device_name(device)})"


def finite(values: dict[str, float]) -> dict[str, float]:
    """Without infinities (the PSNR of equal pictures) and NaN, which JSON cannot express."""
    return {name: value for name, value in values.items() if math.isfinite(value)}
