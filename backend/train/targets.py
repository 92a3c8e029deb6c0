# SPDX-License-Identifier: GPL-3.0-or-later
"""What SSIM needs of training pictures, which do not change, kept from one iteration to the next."""

from functools import partial

import torch

from ..kernels.ssim import SsimTarget
from ..methods.base import Recording
from ..scene.scene import View

#: What is kept at most. A picture's statistics are nine floats a pixel, and a border: 6.2 MB at 400×400, so
#: that 43 are kept; 24 MB at 800×800; 301 MB at 3840×2160, of which none is.
TARGET_BYTES = 1 << 28
#: Bytes for each pixel of a picture.
TARGET_PIXEL_BYTES = 36


class SsimTargets:
    """``SsimTarget`` of pictures by view, place in its bracket and size, as many as come first and fit.

    None gives way to another: all are asked for again and again in turn, so that whatever went would be
    missed before what came. But those at half size go when the first one in full is asked for.
    """

    def __init__(self, budget: int = TARGET_BYTES) -> None:
        self.budget = budget
        self.bytes_held = 0
        self._is_half = False
        self._kept: dict[tuple[View, int], SsimTarget] = {}

    def noted(self, view: View, k: int, recording: Recording, is_half: bool) -> Recording:
        """The recording with a target that is kept; as it is where none is (masks, a card)."""
        if recording.mask is not None or recording.picture.device.type != "cpu":
            return recording
        return recording.with_target(partial(self._get, view, k, recording.picture, is_half))

    def _get(self, view: View, k: int, picture: torch.Tensor, is_half: bool) -> SsimTarget:
        if is_half != self._is_half:
            self._kept.clear()
            self.bytes_held, self._is_half = 0, is_half
        target = self._kept.get((view, k))
        if target is None:
            target = SsimTarget(picture)
            if self.bytes_held + target.nbytes <= self.budget:
                self._kept[view, k] = target
                self.bytes_held += target.nbytes
        return target
