# SPDX-License-Identifier: GPL-3.0-or-later
"""What pyproject.toml says of this copy. Standard library only: it is asked before anything is installed.

It lies beside the rooms wherever they are: in the repository, in the extension, and where pip installed them.
"""

import importlib.metadata
import tomllib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from ..bridge.errors import BadValueError, FileDamagedError

#: The package, as pip and its entry points call it.
NAME = "physhdr"
PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"


@cache
def _project() -> dict[str, Any]:
    """The table ``[project]``; raises ``FileDamagedError``."""
    try:
        return tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    except (OSError, ValueError, KeyError) as error:
        raise FileDamagedError(
            f"{PYPROJECT} cannot be read: {error}", "Install the extension again."
        ) from error


def version() -> str:
    """The version of this copy; raises ``FileDamagedError``."""
    return _project()["version"]


def entry_points_of(group: str) -> dict[str, str]:
    """Name → object of this copy's own entry points of ``group``; raises ``FileDamagedError``."""
    return _project().get("entry-points", {}).get(group, {})


def version_of(package: str) -> str:
    """The version of an installed package, without importing it; empty if it is not there."""
    with suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(package)
    return ""


def requirements(extra: str = "backend") -> list[str]:
    """What pip must install for ``extra``, as pip takes it.

    Raises ``FileDamagedError``, and ``BadValueError`` where there is no such extra.
    """
    project = _project()
    extras = project["optional-dependencies"]
    if extra not in extras:
        raise BadValueError(f"there is no extra '{extra}'", f"Choose one of {', '.join(extras)}.")
    return [*project["dependencies"], *extras[extra]]
