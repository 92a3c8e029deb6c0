# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that only some commands need, which the user may not have installed."""

import importlib
import sys
from types import ModuleType

from ..bridge.errors import PhysHDRError


class PackageMissingError(PhysHDRError):
    """An optional package is not installed."""


def needed(module: str, package: str, what: str) -> ModuleType:
    """Import ``module`` of PyPI's ``package``; raises ``PackageMissingError``: ``what`` needs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise PackageMissingError(
            f"{what} needs {package}, which cannot be imported: {error}",
            f"Install it: {sys.executable} -m pip install {package}",
        ) from error
