# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: small data sets in the documented layout."""

from pathlib import Path
from types import ModuleType

import pytest

from physhdr.tests.backend.scene import small_data_set


@pytest.fixture(scope="session")
def small() -> ModuleType:
    return small_data_set


@pytest.fixture
def data_set(small: ModuleType, tmp_path: Path) -> Path:
    """A whole small data set, fresh for each test, so that a test may damage it."""
    return small.write_data_set(tmp_path / "small")
