# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: the room that is photographed, DNGs and HEIC."""

from importlib import import_module
from types import ModuleType

import pytest

HERE = "physhdr.tests.backend.scene.capture"


@pytest.fixture(scope="session")
def room() -> ModuleType:
    return import_module(f"{HERE}.room")


@pytest.fixture(scope="session")
def dng() -> ModuleType:
    return import_module(f"{HERE}.dng")


@pytest.fixture(scope="session")
def heic() -> ModuleType:
    return import_module(f"{HERE}.heic")
