# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera's learned response, as nodes and shaders tabulate it."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """A learned response: LDR values ``[M, 3]`` in 0…1 at rising ln(exposure × radiance) ``[M]``."""

    log_exposure: np.ndarray
    values: np.ndarray

    @cached_property
    def key(self) -> bytes:
        """Equal for equal curves; hashable."""
        return self.log_exposure.tobytes() + self.values.tobytes()

    @property
    def digest(self) -> str:
        """The same for the same response, in a few letters: models of one camera share a node tree."""
        content = np.column_stack([self.log_exposure, self.values]).astype("<f4").tobytes()
        return hashlib.sha256(content).hexdigest()[:12]

    def resampled(self, count: int) -> tuple[np.ndarray, float, float]:
        """``[count, 3]`` values at equal steps of ln(exposure), the first place and the step."""
        start, end = float(self.log_exposure[0]), float(self.log_exposure[-1])
        places = np.linspace(start, end, count)
        values = [np.interp(places, self.log_exposure, self.values[:, c]) for c in range(3)]
        return np.stack(values, axis=1), start, (end - start) / (count - 1)
