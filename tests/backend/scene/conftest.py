# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: small data sets in the documented layout."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


def _beside(name: str) -> ModuleType:
    """The module ``name`` beside this file (test folders are not packages)."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def small() -> ModuleType:
    """The module ``small_data_set``: our own layout."""
    return _beside("small_data_set")


@pytest.fixture(scope="session")
def layouts() -> ModuleType:
    """The module ``layouts``: all the others."""
    return _beside("layouts")


@pytest.fixture
def data_set(small: ModuleType, tmp_path: Path) -> Path:
    """A whole small data set, fresh for each test, so that a test may damage it."""
    return small.write_data_set(tmp_path / "small")
