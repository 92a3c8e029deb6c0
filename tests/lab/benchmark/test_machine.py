# SPDX-License-Identifier: GPL-3.0-or-later
"""Which code a run was computed with, as its record says: a commit of ours or a version."""

import subprocess
from pathlib import Path

import pytest

from physhdr.backend.project import version
from physhdr.lab.benchmark import machine


@pytest.fixture
def repository(tmp_path):
    """A repository with one commit, and what calls git in it."""

    def git(*words: str) -> str:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
        command = ["git", "-C", str(tmp_path), *who, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    for name in ("backend/code.py", "bridge/code.py", "site-packages/physhdr/backend/code.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("one = 1\n")
    git("init")
    git("add", ".")
    git("commit", "-m", "one")
    return tmp_path.resolve(), git


def revision(monkeypatch, package: Path) -> str:
    monkeypatch.setattr(machine, "PACKAGE", package)
    return machine.this_machine()["versions"]["physhdr"]


def test_a_checkout_names_its_commit_and_whether_code_differs_from_it(repository, monkeypatch):
    root, git = repository
    commit = git("rev-parse", "HEAD")[:10]
    assert revision(monkeypatch, root) == commit
    (root / "notes.txt").write_text("no code")
    assert revision(monkeypatch, root) == commit
    (root / "bridge" / "code.py").write_text("one = 2\n")
    assert revision(monkeypatch, root) == f"{commit}+"


def test_a_strangers_repository_around_the_package_is_not_named(repository, monkeypatch):
    root, _ = repository
    assert revision(monkeypatch, root / "site-packages" / "physhdr") == version()


def test_without_a_repository_it_is_the_version(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    (tmp_path / "physhdr").mkdir()
    assert revision(monkeypatch, (tmp_path / "physhdr").resolve()) == version()
