# SPDX-License-Identifier: GPL-3.0-or-later
import importlib.util
import os
import shlex
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from physhdr.backend.model.tone_mapper import ToneMapper


def _module(name: str) -> ModuleType:
    """``NAME.py`` beside this file."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_fuzzing = _module("stress/damage")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--as-on-windows", action="store_true", help="files as on Windows (tests/stress/windows_semantics.py)"
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--as-on-windows"):
        config.pluginmanager.register(_module("stress/windows_semantics").Plugin())


#: Seconds that a read may take where a reader that opens a FIFO would wait for ever.
PATIENCE = 20


@pytest.fixture(scope="session")
def fuzzing() -> ModuleType:
    """``tests/stress/damage.py``: ``mutations``, ``json_mutations`` and the values that they put in."""
    return _fuzzing


@pytest.fixture(scope="session")
def viewer() -> ModuleType:
    """``tests/viewer.py``: what a viewer of standard PLYs draws. It needs torch."""
    return _module("viewer")


@pytest.fixture(scope="session", autouse=True)
def equal_warm_starts_are_one() -> Iterator[None]:
    """Fits the same response from the same beginning once: the fit takes longer than a tiny training."""
    if importlib.util.find_spec("torch") is None:  # in Blender
        yield
        return
    from physhdr.backend.model import tone_mapper

    fit = tone_mapper.ToneMapper.warm_start
    fitted = {}

    def warm_start(self: "ToneMapper", seed: int) -> None:
        curves = (self.w1, self.b1, self.w2, self.b2)
        begun = (curve.detach().cpu().numpy().tobytes() for curve in curves)
        key = (seed, self.config.warm_start_steps, *begun)
        if key not in fitted:
            fit(self, seed)
            fitted[key] = [curve.detach().clone() for curve in curves]
        for curve, values in zip(curves, fitted[key], strict=True):
            curve.data.copy_(values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tone_mapper.ToneMapper, "warm_start", warm_start)
        yield


@pytest.fixture(scope="session", autouse=True)
def kernels_run_on_one_thread() -> None:
    """Pictures are too small for more, which only wait for each other; results are the same bits."""
    if importlib.util.find_spec("torch") is not None:
        from physhdr.backend.simd import set_threads

        set_threads(1)


@pytest.fixture
def never_waits() -> Iterator[None]:
    """Fails a test that waits for ever, as a read of a FIFO does, instead of hanging the suite."""

    def too_long(*_: object) -> None:
        # No OSError, which the readers turn into their own errors.
        pytest.fail(f"it has waited for {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="session")
def splat_transform() -> Callable[..., None]:
    """Runs splat-transform (npm: @playcanvas/splat-transform) with paths and options, or skips.

    It is the command in PHYSHDR_SPLAT_TRANSFORM, such as ``node …/splat-transform/bin/cli.mjs``, or the one
    on PATH.
    """
    command = shlex.split(os.environ.get("PHYSHDR_SPLAT_TRANSFORM", "")) or ["splat-transform"]
    if shutil.which(command[0]) is None:
        pytest.skip("no splat-transform: neither PHYSHDR_SPLAT_TRANSFORM nor PATH has it")

    def run(*words: object) -> None:
        done = subprocess.run([*command, "-w", *map(str, words)], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr + done.stdout

    return run


@pytest.fixture(scope="session")
def tiny_scene() -> ModuleType:
    """``tests/backend/tiny_scene.py``, which writes data sets of a few Gaussians. It needs torch."""
    return _module("backend/tiny_scene")


@pytest.fixture(scope="session")
def lossless() -> ModuleType:
    """``tests/backend/lossless.py``: what is read back from a lossless PLY."""
    return _module("backend/lossless")


@pytest.fixture(scope="session")
def tiny_data(tiny_scene, tmp_path_factory) -> Path:
    """A tiny data set in the documented layout; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("tiny") / "data")


@pytest.fixture(scope="session")
def larger_data(tiny_scene, tmp_path_factory) -> Path:
    """``tiny_data`` of 128×128, where kernels for whole pictures run; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("larger") / "data", size=128)


@pytest.fixture(scope="session")
def validation_data(tiny_scene, tmp_path_factory) -> Path:
    """``tiny_data`` with three validation views; tests must not write into it."""
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("validation") / "data", validation=3)


@pytest.fixture(scope="session")
def two_lights_data(tiny_scene, tmp_path_factory) -> Path:
    """A tiny data set whose lit views have levels of two lights; tests must not write into it."""
    lights = ("ambient", "pendant")
    return tiny_scene.write_tiny_scene(tmp_path_factory.mktemp("two") / "data", lights=lights)
