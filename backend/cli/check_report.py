# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of ``physhdr check``: versions, the device, seconds; or what is missing or does not work.

Standard library only, because anything else may be missing.
"""

import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ...bridge.errors import PhysHDRError


class MissingModuleError(PhysHDRError):
    """A module that the backend needs is missing or cannot be loaded."""


class CheckFailedError(PhysHDRError):
    """Everything is installed, but the backend computes wrong results."""


@dataclass
class CheckReport:
    """What the check has found so far. ``seconds``: by part.

    ``missing``: requirements of ``physhdr prepare`` that cannot be imported; training does not need them.
    """

    python: str = platform.python_version()
    executable: str = sys.executable
    version: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    device: str = ""
    why: str = ""
    loss: float = 0.0
    gaussians: int = 0
    missing: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        begun = time.perf_counter()
        yield
        self.seconds[part] = round(time.perf_counter() - begun, 2)
