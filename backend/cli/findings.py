# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``physhdr check`` finds: versions, the device, seconds; or what is missing or does not work.

Standard library only: what is missing may be anything else.
"""

import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ...bridge.errors import PhysHDRError


class MissingModuleError(PhysHDRError):
    """A module that the backend needs is not there, or cannot be loaded."""


class CheckFailedError(PhysHDRError):
    """Everything is there, but the backend does not compute what it should."""


@dataclass
class Findings:
    """What the check found; grows while it runs. ``seconds``: by part.

    ``missing``: requirements of ``physhdr prepare`` that cannot be imported; training does without them.
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
