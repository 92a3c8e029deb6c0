# SPDX-License-Identifier: GPL-3.0-or-later
"""Where this user's programs cache what they can make again."""

import os
import sys
from pathlib import Path


def user_cache() -> Path:
    """The folder in which programs of this system cache what they can make again, with our name."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or os.path.expanduser("~")
    elif sys.platform == "darwin":
        base = os.path.expanduser("~/Library/Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "physhdr"
