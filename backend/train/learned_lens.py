# SPDX-License-Identifier: GPL-3.0-or-later
"""The vignetting that a training has learned of its lenses, for pictures that it has not seen.

A test photo was taken by the same camera: its corners are dark for the same reason, and a picture that is
compared with it has to have them. What differs from photo to photo is another matter
(``evaluate/photos.py``).
"""

import math
from collections.abc import Sequence

import numpy as np
import torch

from ..model.camera_effects import falloff, lenses, squared_tangent
from ..scene.camera import Camera


class LearnedLenses:
    """``cameras``: of the training views. ``vignetting`` ``[L, 3]`` and ``reach`` ``[L]`` of their lenses."""

    def __init__(self, cameras: Sequence[Camera], vignetting: torch.Tensor, reach: torch.Tensor) -> None:
        self._vignetting, self._reach = vignetting.float().cpu(), reach.tolist()
        self._focal = np.array([_relative_focal(camera) for camera in cameras])
        self._lens = lenses(cameras)

    def falloff(self, camera: Camera) -> torch.Tensor:
        """``[1, H, W]``: the share of the light that arrives, by the lens of the nearest focal length."""
        lens = self._lens[int(np.abs(self._focal - _relative_focal(camera)).argmin())]
        rho = squared_tangent(camera, self._vignetting) / self._reach[lens]
        return falloff(rho, self._vignetting[lens]).exp()[None]


def lenses_of(
    learned: tuple[torch.Tensor | None, torch.Tensor | None], cameras: Sequence[Camera]
) -> LearnedLenses | None:
    """``learned``: vignetting and reach, of which there is none where no lens was learned; ``cameras``: of
    the training views."""
    vignetting, reach = learned
    return None if vignetting is None or reach is None else LearnedLenses(cameras, vignetting, reach)


def _relative_focal(camera: Camera) -> float:
    return camera.fx / math.hypot(camera.width, camera.height)
