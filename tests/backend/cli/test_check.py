# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr check``: what training needs is an error, what photos need is told and does not stop it."""

import subprocess
import sys
from pathlib import Path

import pytest

from physhdr.backend.cli import check as checks
from physhdr.backend.cli import trial_step
from physhdr.backend.cli.check_report import MissingModuleError
from physhdr.backend.project import requirements

LAUNCHER = Path(checks.__file__).parents[1] / "launch.py"


@pytest.fixture
def quick(monkeypatch):
    """No kernels are compiled and nothing is trained: imports alone."""
    monkeypatch.setattr(trial_step, "compile_for_presets", lambda compiled: None)
    monkeypatch.setattr(trial_step, "one_step", lambda device: (0.5, 10))


def test_all_that_photos_need_is_found(quick):
    found = checks.check(lambda fraction, message: None)
    assert found.missing == [] and found.versions["pycolmap"]


def test_a_package_that_photos_need_is_missing_and_training_works(quick, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    found = checks.check(lambda fraction, message: None)
    [missing] = found.missing
    assert missing in requirements("prepare") and missing.startswith("pycolmap")
    assert any("photos cannot be prepared" in warning for warning in found.warnings)
    assert found.device and "pycolmap" not in found.versions


def test_a_package_for_photos_of_another_version_is_told(quick, monkeypatch):
    real = checks.version_of
    monkeypatch.setattr(checks, "version_of", lambda name: "0.1" if name == "pycolmap" else real(name))
    found = checks.check(lambda fraction, message: None)
    assert found.missing == []
    assert [text for text in found.warnings if text.startswith("pycolmap 0.1 was not tested")]


def test_a_package_that_training_needs_is_an_error(quick, monkeypatch):
    monkeypatch.setitem(sys.modules, "plyfile", None)
    with pytest.raises(MissingModuleError, match="plyfile") as error:
        checks.check(lambda fraction, message: None)
    assert error.value.code == "missing_module"


@pytest.mark.parametrize(
    ("extra", "status", "told"), [("prepare", 0, "pycolmap"), ("nope", 1, "no extra 'nope'")]
)
def test_what_pip_has_to_install_is_listed_before_anything_is_installed(extra, status, told):
    done = subprocess.run(
        [sys.executable, "-I", str(LAUNCHER), "requirements", extra], capture_output=True, text=True
    )
    assert done.returncode == status
    assert told in (done.stderr if status else done.stdout) and "Traceback" not in done.stderr
