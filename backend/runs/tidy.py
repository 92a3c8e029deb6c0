# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training of large pictures does between iterations, to hold no more memory than it needs."""

from ..simd import give_back_freed_memory
from ..train.state import State

#: From so many pixels of a view on. Below, what lies unused in the heap is little.
LARGE_PIXELS = 500_000
#: Iterations between two times: as often as Gaussians grow. Taking the pages anew costs a hundredth of that.
EVERY = 100


class Tidying:
    """Called after every iteration of ``state``."""

    def __init__(self, state: State) -> None:
        self._state = state
        pixels = max(view.camera.width * view.camera.height for view in state.views)
        self._wanted = state.device.type == "cpu" and pixels >= LARGE_PIXELS

    def __call__(self) -> float:
        """Returns for how long the training was held up by somebody else: never."""
        if self._wanted and self._state.iteration % EVERY == 0:
            give_back_freed_memory()
        return 0.0
