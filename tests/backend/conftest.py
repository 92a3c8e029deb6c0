# SPDX-License-Identifier: GPL-3.0-or-later
import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


def _module(name: str) -> ModuleType:
    """``NAME.py`` beside this file."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tiny_scene = _module("tiny_scene")


@pytest.fixture(scope="session")
def lossless() -> ModuleType:
    """``tests/backend/lossless.py``: what is read back from a lossless PLY."""
    return _module("lossless")


@pytest.fixture(scope="session")
def tiny_data(tmp_path_factory) -> Path:
    """A tiny data set in the documented layout; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("tiny") / "data")


@pytest.fixture(scope="session")
def larger_data(tmp_path_factory) -> Path:
    """``tiny_data`` of 128×128, where kernels for whole pictures run; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("larger") / "data", size=128)


@pytest.fixture(scope="session")
def validation_data(tmp_path_factory) -> Path:
    """``tiny_data`` with three validation views; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("validation") / "data", validation=3)


@pytest.fixture(scope="session")
def two_lights_data(tmp_path_factory) -> Path:
    """A tiny data set whose lit views have levels of two lights; tests must not write into it."""
    lights = ("ambient", "pendant")
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("two") / "data", lights=lights)
