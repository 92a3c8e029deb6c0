# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands that are told to people, who will copy them."""

import os
import shlex
import subprocess
from pathlib import Path


def as_word(path: Path) -> str:
    """A path as one word of a command line, quoted where this system's shell would take it for more."""
    return subprocess.list2cmdline([str(path)]) if os.name == "nt" else shlex.quote(str(path))
