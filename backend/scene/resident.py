# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras and pictures that are copied to the computing device once and stay there.

A copy from ordinary host memory to a CUDA card makes the host wait for the card. An iteration must not do
that, or the card idles while the host prepares the next one (docs/performance.md): matrices and pictures
are copied at their first use and kept.
"""

import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ..memory import LEAST_OF_PICTURES
from .camera import Camera
from .scene import View


def picture_room_on(device: torch.device) -> int:
    """Bytes of pictures that stay on a card: a quarter of what is free there, 1 GiB at least.

    What is beyond is copied anew at each use: a card has to hold the Gaussians, too.
    """
    return max(LEAST_OF_PICTURES, torch.cuda.mem_get_info(device)[0] // 4)


@dataclass(frozen=True)
class CameraTensors:
    """A camera where the Gaussians are, in their precision.

    ``view`` ``[4, 4]``: world to camera, OpenCV axes. ``intrinsics`` ``[3, 3]``, pixels. ``position``
    ``[3]``, metres. ``half_size`` ``[2]``: half of width and height, pixels (one unit of NDC).
    """

    view: torch.Tensor
    intrinsics: torch.Tensor
    position: torch.Tensor
    half_size: torch.Tensor


# A camera never changes (frozen, compared by identity); its tensors are freed with it.
_cameras: weakref.WeakKeyDictionary[Camera, dict[tuple[torch.device, torch.dtype], CameraTensors]] = (
    weakref.WeakKeyDictionary()
)


def camera_tensors(camera: Camera, like: torch.Tensor) -> CameraTensors:
    """The camera with the device and dtype of ``like``; copied once, do not write into it."""
    kept = _cameras.setdefault(camera, {})
    key = (like.device, like.dtype)
    if key not in kept:
        K = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
        half_size = [0.5 * camera.width, 0.5 * camera.height]
        kept[key] = CameraTensors(
            view=_beside(camera.world_to_camera, like),
            intrinsics=_beside(np.array(K), like),
            position=_beside(camera.position, like),
            half_size=_beside(np.array(half_size), like),
        )
    return kept[key]


def _beside(values: np.ndarray, like: torch.Tensor) -> torch.Tensor:
    """A copy with the device and dtype of ``like``; the host continues while a card fetches it.

    Where poses are learned each iteration has a camera of its own.
    """
    host = torch.from_numpy(values.copy()).to(like.dtype)
    return host.pin_memory().to(like.device, non_blocking=True) if like.is_cuda else host.to(like.device)


class Pictures:
    """Training pictures as float images on ``device``, stored there as 8 or 16 bits a channel.

    On the CPU nothing is kept: the scene's own cache already holds the decoded pictures. ``budget`` None:
    ``picture_room_on`` the card. ``instead``: codes ``[3, H, W]`` uint16 that stand for those of a view's
    picture; None where it stays as it is.
    """

    def __init__(
        self,
        device: torch.device,
        budget: int | None = None,
        instead: Callable[[View, int], np.ndarray | None] | None = None,
    ) -> None:
        self.device = device
        self.instead = instead
        if budget is None:
            budget = picture_room_on(device) if device.type == "cuda" else LEAST_OF_PICTURES
        self.budget = budget
        self.bytes_held = 0
        self._kept: dict[tuple[View, int], torch.Tensor] = {}
        self._masks: dict[tuple[View, int], torch.Tensor] = {}

    def get(self, view: View, exposure: int) -> torch.Tensor:
        """The picture's values ``[3, H, W]``, in [0, 1] unless it is radiance; raises as ``View.image``."""
        codes = self._kept.get((view, exposure))
        if codes is None:
            other = None if self.instead is None else self.instead(view, exposure)
            if other is None:
                codes = torch.tensor(view.image(exposure), device=self.device).permute(2, 0, 1)
            else:
                codes = torch.tensor(other, device=self.device)
            if self.device.type != "cpu":
                codes = codes.contiguous()
                if self.bytes_held + codes.nbytes <= self.budget:
                    self._kept[view, exposure] = codes
                    self.bytes_held += codes.nbytes
        unit = view.sources[exposure].encoding.unit(np.dtype(str(codes.dtype).removeprefix("torch.")))
        return codes.float() / unit

    def mask(self, view: View, exposure: int) -> torch.Tensor | None:
        """Which pixels are compared, ``[H, W]`` bool; None: all. Raises what ``View.image`` raises."""
        kept = self._masks.get((view, exposure))
        if kept is not None:
            return kept
        mask = view.mask(exposure)
        if mask is None:
            return None
        result = torch.tensor(mask, device=self.device)
        if self.device.type != "cpu" and self.bytes_held + result.nbytes <= self.budget:
            self._masks[view, exposure] = result
            self.bytes_held += result.nbytes
        return result
