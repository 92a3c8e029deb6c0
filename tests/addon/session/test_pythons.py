# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Python an environment was made of, and whether it is one of ours."""

import os
import sys
import venv
from pathlib import Path

import pytest

from physhdr.addon.session.pythons import base_of, is_ours, working_python


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("home") / "environment-0123"
    venv.EnvBuilder(with_pip=False, symlinks=os.name != "nt").create(folder)
    return folder


def test_the_base_of_an_environment_is_the_python_that_made_it(environment):
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    base = base_of(str(python))
    assert base is not None and base.exists() and environment not in base.parents
    assert os.path.samefile(base, os.path.realpath(sys.executable))
    assert base_of("") is base_of("/no/such/bin/python") is None


@pytest.mark.skipif(os.name == "nt", reason="a script stands in for a Python")
def test_a_python_that_was_mended_is_taken(tmp_path):
    """As Debian's, when its package for environments has been installed meanwhile."""
    python = tmp_path / "python3.12"
    python.write_text("#!/bin/sh\nexit 1\n")
    python.chmod(0o755)
    assert working_python(str(python)) is None
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    assert working_python(str(python)) == Path(sys.executable)


def test_ours_are_in_the_backends_folder(environment):
    python = str(environment / "bin" / "python")
    assert is_ours(environment.parent, python)
    assert not is_ours(environment.parent.parent, python)
    assert not is_ours(environment.parent, str(environment.parent / "mine" / "bin" / "python"))
    assert not is_ours(environment.parent, "")
