# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: the room that is photographed."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def room() -> ModuleType:
    """The module ``room`` beside this file (test folders are not packages)."""
    spec = importlib.util.spec_from_file_location("room", Path(__file__).with_name("room.py"))
    assert spec is not None and spec.loader is not None
    module = sys.modules["room"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
