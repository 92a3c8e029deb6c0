# SPDX-License-Identifier: GPL-3.0-or-later
"""`make gui-test`: Debian comes from where the system's apt takes it, and what is missing is said."""

import importlib.util
import platform
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
OF_OTHERS = """\
Types: deb
URIs: https://packages.example.org/apt
Suites: nodistro
Components: main
"""
DEB822 = """\
# Debian's own, as its installer writes it.
Types: deb deb-src
URIs: https://old.example.org/debian
Suites: bookworm
Components: main
Enabled: no

Types: deb
URIs: https://security.example.org/debian-security
Suites: bookworm-security
Components: main

Types: deb
URIs: https://near.example.org/debian/
Suites: bookworm
 bookworm-updates
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
"""
ONE_LINE = """\
# deb https://off.example.org/debian bookworm main
deb-src https://source.example.org/debian bookworm main
deb https://security.example.org/debian-security bookworm-security main
deb [arch=amd64 signed-by=/a/key] https://line.example.org/debian bookworm main contrib  # near
"""


@pytest.fixture
def gui(monkeypatch):
    """The tool as a module, on a Debian that has apt."""
    spec = importlib.util.spec_from_file_location("gui_test", ROOT / "tools" / "gui_test.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.delenv("PHYSHDR_DEBIAN_MIRROR", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    debian = {"ID": "debian", "VERSION_CODENAME": "bookworm"}
    monkeypatch.setattr(platform, "freedesktop_os_release", lambda: debian)
    return module


def settings(folder: Path, **files: str) -> Path:
    (folder / "sources.list.d").mkdir()
    for name, text in files.items():
        place = folder if name == "sources_list" else folder / "sources.list.d"
        (place / name.replace("_", ".")).write_text(text)
    return folder


def test_both_forms_of_apts_settings_are_read(gui, tmp_path):
    (tmp_path / "a").mkdir()
    new = settings(tmp_path / "a", a_sources=OF_OTHERS, debian_sources=DEB822)
    assert gui.mirror(new) == "https://near.example.org/debian"
    (tmp_path / "b").mkdir()
    old = settings(tmp_path / "b", sources_list=ONE_LINE, a_sources=OF_OTHERS)
    assert gui.mirror(old) == "https://line.example.org/debian"


def test_the_users_own_word_goes_first(gui, tmp_path, monkeypatch):
    monkeypatch.setenv("PHYSHDR_DEBIAN_MIRROR", "https://mine.example.org/debian")
    assert gui.mirror(tmp_path) == "https://mine.example.org/debian"


def test_where_nothing_names_debian_it_says_so(gui, tmp_path, monkeypatch):
    others = settings(tmp_path, a_sources=OF_OTHERS)
    with pytest.raises(gui.Skip, match="name no archive of Debian"):
        gui.mirror(others)
    monkeypatch.setattr(platform, "freedesktop_os_release", lambda: {"ID": "ubuntu"})
    (tmp_path / "sources.list").write_text(ONE_LINE)
    with pytest.raises(gui.Skip, match="PHYSHDR_DEBIAN_MIRROR"):
        gui.mirror(tmp_path)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(gui.Skip, match="no apt"):
        gui.mirror(tmp_path)


def test_an_archive_that_does_not_answer_is_named(gui, tmp_path):
    (tmp_path / "dists" / "sid").mkdir(parents=True)
    address = tmp_path.as_uri()
    with pytest.raises(gui.Skip, match=f"{address} cannot be reached"):
        gui.require_answer(address)
    (tmp_path / "dists" / "sid" / "Release").write_text("Suite: unstable\n")
    gui.require_answer(address)
