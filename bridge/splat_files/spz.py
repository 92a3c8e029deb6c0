# SPDX-License-Identifier: GPL-3.0-or-later
"""SPZ, Niantic's compressed Gaussians."""

from pathlib import Path

from .cloud import SplatCloud


def write_spz(path: Path, cloud: SplatCloud, version: int) -> None:
    """Write ``cloud`` as SPZ of ``version`` 3 or 4, atomically, in the axes that it has.

    SPZ's own are Y up: turning is the caller's (``cloud.turned``). Raises ``BadValueError`` and
    ``OutputError``.
    """
    raise NotImplementedError
