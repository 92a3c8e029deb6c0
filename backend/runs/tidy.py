# SPDX-License-Identifier: GPL-3.0-or-later
"""Releases unused memory between iterations when training on large pictures."""

from ..simd import give_back_freed_memory
from ..train.state import State

#: Pixels of a view from which this pays: below, little of the heap is unused.
LARGE_PIXELS = 500_000
#: Iterations between releases: as often as Gaussians grow. Reallocating pages costs a hundredth of that.
EVERY = 100


class Tidying:
    """Called after every iteration of ``state``."""

    def __init__(self, state: State) -> None:
        self._state = state
        pixels = max(view.camera.width * view.camera.height for view in state.views)
        self._wanted = state.device.type == "cpu" and pixels >= LARGE_PIXELS

    def __call__(self) -> float:
        """Returns the seconds of a pause: none."""
        if self._wanted and self._state.iteration % EVERY == 0:
            give_back_freed_memory()
        return 0.0
