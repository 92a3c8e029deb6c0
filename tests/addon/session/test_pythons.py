# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Python an environment was made of, and whether it is one of ours."""

import os
import sys
import venv
from pathlib import Path

import pytest

from physhdr.addon.session import pythons
from physhdr.addon.session.pythons import base_of, find_pythons, is_ours, working_python


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


@pytest.mark.skipif(os.name == "nt", reason="a script stands in for a Python")
def test_a_python_that_greets_is_one_and_what_is_none_is_no_error(tmp_path):
    """On clusters a module's wrapper says what it loads; and any program may have been chosen."""
    python = tmp_path / "python3.12"
    python.write_text(f'#!/bin/sh\necho "Loading python/3.12"\nexec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    assert working_python(str(python)) == Path(sys.executable)
    python.write_text('#!/bin/sh\necho "$@"\n')
    assert working_python(str(python)) is None


def test_ours_are_in_the_backends_folder(environment):
    python = str(environment / "bin" / "python")
    assert is_ours(environment.parent, python)
    assert not is_ours(environment.parent.parent, python)
    assert not is_ours(environment.parent, str(environment.parent / "mine" / "bin" / "python"))
    assert not is_ours(environment.parent, "")


@pytest.mark.skipif(os.name == "nt", reason="a script stands in for a Python")
def test_a_python_whose_path_cannot_be_read_is_no_error(tmp_path):
    """One that does not heed ``-X utf8`` tells Jürgen's path in Windows' code page."""
    python = tmp_path / "python3.12"
    python.write_bytes(b"#!/bin/sh\nprintf '3.12 /home/J\\374rgen/python3.12\\n'\n")
    python.chmod(0o755)
    assert working_python(str(python)) is None


def test_a_path_with_any_letters_is_found(tmp_path, monkeypatch):
    folder = tmp_path / "Юрій 🎬"
    venv.EnvBuilder(with_pip=False, symlinks=os.name != "nt").create(folder)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    monkeypatch.setenv("PYTHONIOENCODING", "cp1252")
    monkeypatch.setenv("PYTHONUTF8", "0")
    assert working_python(str(python)) == python


def test_pythons_of_windows_are_found_where_its_installers_put_them(tmp_path):
    local, programs, home = tmp_path / "Local", tmp_path / "Program Files", tmp_path / "me"
    pyenv = home / ".pyenv" / "pyenv-win" / "versions"
    for version in ("3.12.1", "3.12.4", "3.11.9"):
        (pyenv / version).mkdir(parents=True)
        (pyenv / version / "python.exe").write_text("")
    found = list(
        pythons._on_windows(
            "3.12",
            {"LOCALAPPDATA": str(local), "ProgramFiles": str(programs), "USERPROFILE": str(home)},
        )
    )
    assert found == [
        local / "Programs" / "Python" / "Python312" / "python.exe",
        local / "Python" / "pythoncore-3.12-64" / "python.exe",
        programs / "Python312" / "python.exe",
        pyenv / "3.12.4" / "python.exe",
        pyenv / "3.12.1" / "python.exe",
    ]


def test_a_python_of_the_store_is_not_offered(monkeypatch):
    store = Path(
        "C:/Users/me/AppData/Local/Microsoft/WindowsApps/PythonSoftwareFoundation.Python.3.12_q/python.exe"
    )
    other = Path("C:/Program Files/Python312/python.exe")
    monkeypatch.setattr(pythons, "_candidates", lambda version: [str(store), str(other)])
    monkeypatch.setattr(pythons, "working_python", Path)
    assert find_pythons() == [other]
