# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: small data sets in the documented layout."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def small() -> ModuleType:
    """The module ``small_data_set`` of tests/backend/scene (test folders are not packages)."""
    path = Path(__file__).parents[1] / "scene" / "small_data_set.py"
    spec = importlib.util.spec_from_file_location("small_data_set", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def data_set(small: ModuleType, tmp_path: Path) -> Path:
    """A whole small data set, fresh for each test, so that a test may damage it."""
    return small.write_data_set(tmp_path / "small")
