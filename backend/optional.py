# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that only some commands need, which the user may not have installed."""

import importlib
from types import ModuleType

from ..bridge.errors import PhysHDRError
from .shell import pip_install


class PackageMissingError(PhysHDRError):
    """An optional package is not installed."""


def needed(module: str, package: str, what: str) -> ModuleType:
    """Import ``module`` of PyPI's ``package``; raises ``PackageMissingError``: ``what`` needs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise PackageMissingError(
            f"{what} needs {package}, which cannot be imported: {error}",
            f"Install it: {pip_install(package)}",
        ) from error
