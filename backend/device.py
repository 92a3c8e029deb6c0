# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to compute: a CUDA card if there is one whose kernels work, else the CPU, and why."""

from typing import Literal

import torch

from ..bridge.errors import BadValueError
from .rasterize.card import INSTALL_WARP, unavailable_reason

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
        raise BadValueError(f"cannot compute on CUDA: {reason}", f"Choose --device cpu. {INSTALL_WARP}")
    return torch.device("cpu"), f"on the CPU ({reason})"


def use_whole_float32() -> None:
    """Let convolutions on a CUDA card keep all of float32's 24 bits.

    Torch lets them round to 11 (TF32) unless told otherwise. SSIM takes differences of blurred squares, which
    would then be noise: its C₂ is 9e-4, TF32's rounding of values near 1 is 5e-4. A setting of the process.
    """
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cuda.matmul.allow_tf32 = False
