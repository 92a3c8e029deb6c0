# SPDX-License-Identifier: GPL-3.0-or-later
"""`make setup`: pip installs what is locked or nothing, torch from its index first; a new lock is seen."""

import hashlib
import importlib.util
import os
import shutil
import sys
import venv
import zipfile
from pathlib import Path

import pip
import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def setup(tmp_path, monkeypatch):
    """tools/setup.py as a module, its project in an empty folder, pip without any index."""
    spec = importlib.util.spec_from_file_location("setup_tool", ROOT / "tools" / "setup.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in [name for name in os.environ if name.startswith("PIP_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_CACHE_DIR", "1")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENVS", tmp_path / ".venvs")
    monkeypatch.setattr(module, "LOCKS", tmp_path / "locks")
    monkeypatch.setattr(module, "PYTORCH", "http://127.0.0.1:1/whl/cpu")  # nobody listens there
    monkeypatch.setattr(module, "BRIEFLY", ("--retries", "0", "--timeout", "1"))
    (tmp_path / "locks").mkdir()
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'x'\n")
    return module


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    folder = tmp_path_factory.mktemp("environment") / "e"
    venv.EnvBuilder(symlinks=True).create(folder)
    [site] = folder.glob("lib/python3*/site-packages")
    shutil.copytree(Path(pip.__file__).parent, site / "pip")  # what ensurepip does takes seconds
    return folder


def wheel(folder: Path, name: str, requires: str = "") -> str:
    """Version 1.0 of an empty package; returns its SHA-256."""
    info = f"{name}-1.0.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
    files = {
        f"{name}.py": "",
        f"{info}/METADATA": metadata + (f"Requires-Dist: {requires}\n" if requires else ""),
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    files[f"{info}/RECORD"] = "".join(f"{each},,\n" for each in files)
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for each, text in files.items():
            archive.writestr(each, text)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def lock(setup, name: str, **pins: str) -> None:
    lines = [f"{package}==1.0 --hash=sha256:{digest}\n" for package, digest in pins.items()]
    (setup.LOCKS / name).write_text("".join(lines))


def test_a_lock_that_changes_sets_up_anew(setup):
    lock(setup, "backend.txt", thing="0" * 64)
    before = setup.fingerprint("python")
    assert setup.fingerprint("python") == before
    lock(setup, "backend.txt", thing="1" * 64)
    assert setup.fingerprint("python") != before


def test_a_checkout_that_was_moved_sets_up_anew(setup, tmp_path, monkeypatch):
    """What is installed of it names its former place."""
    before = setup.fingerprint("python")
    moved = tmp_path / "moved"
    moved.mkdir()
    shutil.copy2(tmp_path / "pyproject.toml", moved)
    monkeypatch.setattr(setup, "ROOT", moved)
    assert setup.fingerprint("python") != before


def test_an_environment_of_another_place_or_one_half_made_is_not_whole(setup, environment, tmp_path):
    assert setup.is_whole(environment)
    link = tmp_path / "link"
    link.symlink_to(environment)
    assert setup.is_whole(link)  # as .venvs may be one
    copy = tmp_path / "copy"
    shutil.copytree(environment, copy, symlinks=True)
    assert not setup.is_whole(copy)  # its scripts run the former's Python
    assert not setup.is_whole(half_made(tmp_path)) and not setup.is_whole(tmp_path / "none")


def half_made(folder: Path) -> Path:
    """An environment as ensurepip leaves it when it is interrupted."""
    half = folder / ".venvs" / "backend"
    venv.EnvBuilder(symlinks=True).create(half)
    (half / "leftover").touch()
    return half


@pytest.mark.long
def test_an_environment_that_is_half_made_is_made_anew(setup, tmp_path):
    half = half_made(tmp_path)
    lock(setup, "backend.txt")
    setup.make_environment("backend", sys.executable, ("backend.txt",))
    assert setup.is_whole(half) and not (half / "leftover").exists()


def test_pip_installs_into_the_environment_where_its_settings_say_for_the_user(
    setup, environment, tmp_path, monkeypatch
):
    files = tmp_path / "files"
    digest = wheel(files, "mine")
    lock(setup, "mine.txt", mine=digest)
    settings = tmp_path / "pip.conf"
    settings.write_text(f"[global]\nuser = true\nno-index = true\nfind-links = {files}\n")
    monkeypatch.setenv("PIP_CONFIG_FILE", str(settings))
    install = [environment / "bin" / "python", "-m", "pip", "install", *setup.LOCKED]
    done = setup.run([*install, *setup.from_locks("mine.txt")])
    assert done.returncode == 0, done.stderr
    assert list(environment.glob("lib/python3*/site-packages/mine.py"))


def test_a_hash_that_differs_stops_it_with_the_reason(setup, environment, tmp_path, monkeypatch, capsys):
    wheel(tmp_path / "files", "thing")
    lock(setup, "blender.txt", thing="0" * 64)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "files"))
    (tmp_path / ".venvs").mkdir()
    (tmp_path / ".venvs" / "blender").symlink_to(environment)
    assert setup.make_environment("blender", sys.executable, ("blender.txt",)) == 1
    told = capsys.readouterr().err
    assert "thing==1.0" in told and "not the file that was locked" in told and "make lock" in told
    assert not (environment / "physhdr.stamp").exists()


@pytest.mark.long
def test_torch_comes_by_pips_own_settings_where_pytorchs_index_cannot_be_reached(
    setup, environment, tmp_path, monkeypatch, capsys
):
    """And its CUDA libraries, if it asks for them: by their lock. A file with another hash never comes."""
    files = tmp_path / "files"
    torch, library = wheel(files, "torch", "nvidia_thing"), wheel(files, "nvidia_thing")
    page = tmp_path / "index" / "torch"
    page.mkdir(parents=True)
    (page / "index.html").write_text(
        f'<a href="{next(files.glob("torch-*")).as_uri()}">torch-1.0-py3-none-any.whl</a>'
    )
    page = tmp_path / "index" / "nvidia-thing"
    page.mkdir(parents=True)
    name = next(files.glob("nvidia*"))
    (page / "index.html").write_text(f'<a href="{name.as_uri()}">{name.name}</a>')
    monkeypatch.setenv("PIP_INDEX_URL", (tmp_path / "index").as_uri())
    lock(setup, "torch-cuda.txt", nvidia_thing=library)
    command = [environment / "bin" / "python", "-m", "pip", "--disable-pip-version-check"]
    lock(setup, "torch.txt", torch="0" * 64)
    assert "DO NOT MATCH" in setup.install_torch("backend", [*command, "install"]).stderr
    lock(setup, "torch.txt", torch=torch)
    done = setup.install_torch("backend", [*command, "install"])
    assert done.returncode == 0, done.stderr
    assert "from where pip is set up to look" in capsys.readouterr().out
    assert setup.complete("backend", command).returncode == 0
    assert "fetching its libraries" in capsys.readouterr().out
    assert "nvidia_thing==1.0" in setup.run([*command, "freeze"]).stdout.replace("-", "_")
