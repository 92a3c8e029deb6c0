# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to compute: a CUDA card if there is one whose kernels work, else the CPU, and why."""

from typing import Literal

import torch

from ..bridge.errors import BadValueError
from .rasterize.cuda import unavailable_reason

DeviceName = Literal["auto", "cpu", "cuda"]


def choose_device(name: DeviceName) -> tuple[torch.device, str]:
    """The device and a line that says why it was chosen.

    Raises ``BadValueError`` where ``cuda`` is asked for and cannot be used.
    """
    if name == "cpu":
        return torch.device("cpu"), "on the CPU, as asked"
    reason = unavailable_reason()
    if reason is None:
        return torch.device("cuda"), f"on {torch.cuda.get_device_name()}"
    if name == "cuda":
        raise BadValueError(
            f"cannot compute on CUDA: {reason}", "Choose --device cpu, or install gsplat and nvcc."
        )
    return torch.device("cpu"), f"on the CPU ({reason})"
