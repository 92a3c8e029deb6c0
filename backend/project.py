# SPDX-License-Identifier: GPL-3.0-or-later
"""What pyproject.toml says of this copy. Standard library only: it is asked before anything is installed.

It lies beside the package in the repository and in the extension; where the package was installed by pip
alone, the installed metadata say the same.
"""

import importlib.metadata
import re
import tomllib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from ..bridge.errors import FileDamagedError

PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"
NAME = "physhdr"


@cache
def _project() -> dict[str, Any] | None:
    """The table ``[project]``; ``None`` where there is no file."""
    if not PYPROJECT.is_file():
        return None
    try:
        return tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    except (OSError, ValueError, KeyError) as error:
        raise FileDamagedError(
            f"{PYPROJECT} cannot be read: {error}", "Install the extension again."
        ) from error


def version() -> str:
    """The version of this copy."""
    project = _project()
    return project["version"] if project else version_of(NAME)


def version_of(package: str) -> str:
    """The version of an installed package, without importing it; empty if it is not there."""
    with suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(package)
    return ""


def requirements(extra: str = "backend") -> list[str]:
    """What pip must install for ``extra``, as pip takes it; raises ``FileDamagedError``."""
    project = _project()
    if project:
        return [*project["dependencies"], *project["optional-dependencies"][extra]]
    marker = re.compile(r"""\s*;\s*extra\s*==\s*['"](\w+)['"]""")
    found = importlib.metadata.requires(NAME) or []
    wanted = [(marker.sub("", each), marker.search(each)) for each in found]
    return [each for each, mark in wanted if mark is None or mark[1] == extra]
