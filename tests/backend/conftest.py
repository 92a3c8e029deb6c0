# SPDX-License-Identifier: GPL-3.0-or-later
import importlib.util
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("tiny_scene", Path(__file__).parent / "tiny_scene.py")
tiny_scene = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(tiny_scene)


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory) -> Path:
    """A tiny data set in the documented layout; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("tiny") / "data")


@pytest.fixture(scope="session")
def two_lights_data(tmp_path_factory) -> Path:
    """A tiny data set whose lit views have levels of two lights; tests must not write into it."""
    lights = ("ambient", "pendant")
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("two") / "data", lights=lights)
