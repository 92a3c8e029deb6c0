# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: the room that is photographed, DNGs and HEIC."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def beside(name: str) -> ModuleType:
    """A module beside this file (test folders are not packages)."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def room() -> ModuleType:
    return beside("room")


@pytest.fixture(scope="session")
def dng() -> ModuleType:
    return beside("dng")


@pytest.fixture(scope="session")
def heic() -> ModuleType:
    return beside("heic")
