# SPDX-License-Identifier: GPL-3.0-or-later
"""Which options of a command were given: those that would change nothing are refused, not ignored."""

from dataclasses import fields
from typing import Any


def given_of(command: Any, *names: str) -> list[str]:
    """Those of some options of a command, a dataclass, that are not as by default, as they are typed."""
    defaults = {each.name: each.default for each in fields(command)}
    return [name.replace("_", "-") for name in names if getattr(command, name) != defaults[name]]
