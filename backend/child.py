# SPDX-License-Identifier: GPL-3.0-or-later
"""A module of ours in a process of its own, whether the package is installed or was found by ``launch.py``.

``python -m physhdr…`` is not enough: in the environment that Blender makes, the package is not installed.
"""

import sys
from pathlib import Path

_LAUNCHER = Path(__file__).resolve().parent / "launch.py"


def child_command(module: str, *words: str) -> list[str]:
    """The command that calls ``main(words)`` of ``module``, by its whole name, and ends with what it returns.

    It runs what this process runs: this Python, this package, and this environment's cache of kernels.
    """
    return [sys.executable, "-P", str(_LAUNCHER), "module", module, *words]
