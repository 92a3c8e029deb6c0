# SPDX-License-Identifier: GPL-3.0-or-later
"""The locks are what pyproject.toml asks for; what installs takes nothing else; how they are renewed."""

import importlib.util
import re
import shutil
import sys
import tomllib
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[3]
LOCKS = ROOT / "locks"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
#: What is installed together, for which extras.
TOGETHER = {
    ("backend.txt", "torch.txt"): ["backend"],
    ("backend.txt", "torch.txt", "develop.txt"): ["backend", "test", "develop"],
    ("backend.txt", "torch.txt", "torch-cuda.txt", "warp.txt"): ["backend", "warp"],
    ("backend.txt", "torch.txt", "torch-cuda12.txt", "warp12.txt"): ["backend", "warp"],
    ("bpy.txt", "blender.txt"): ["blender"],
}
SYSTEMS = [("linux", "x86_64"), ("linux", "aarch64"), ("win32", "AMD64"), ("darwin", "arm64")]
INSTALLING = [
    "addon/scripts/install_backend.py",
    "tools/setup.py",
    "tools/lock.py",
    "tools/build_extension.py",
]


def loaded(name: str):
    """A tool as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def lock():
    return loaded("lock")


def environment_of(python: str, system: tuple[str, str]) -> dict[str, str]:
    """What markers of requirements are evaluated in there."""
    return default_environment() | {
        "python_version": python,
        "python_full_version": f"{python}.9",
        "sys_platform": system[0],
        "platform_machine": system[1],
    }


def pinned(lock, files, python: str, system: tuple[str, str]) -> dict[str, str]:
    """Package → the one version that pip installs there."""
    environment = environment_of(python, system)
    found: dict[str, str] = {}
    for file in files:
        for pin in lock.parse((LOCKS / file).read_text()):
            requirement = Requirement(pin.requirement)
            if requirement.marker is None or requirement.marker.evaluate(environment):
                name = canonicalize_name(requirement.name)
                assert found.setdefault(name, pin.version) == pin.version, f"{file}: two versions of {name}"
    return found


@pytest.mark.parametrize("system", SYSTEMS, ids="-".join)
@pytest.mark.parametrize("files", TOGETHER, ids=lambda files: files[-1])
def test_every_requirement_has_a_pin_that_it_allows(lock, files, system):
    extras = [
        each for extra in TOGETHER[files] for each in PROJECT["project"]["optional-dependencies"][extra]
    ]
    wanted = list(map(Requirement, [*PROJECT["project"]["dependencies"], *extras]))
    wanted += map(
        Requirement, PROJECT["build-system"]["requires"]
    )  # built without isolation: it must be there
    for python in ["3.13"] if "bpy.txt" in files else ["3.11", "3.12", "3.13", "3.14"]:
        pins = pinned(lock, files, python, system)
        environment = environment_of(python, system)
        for requirement in wanted:
            if requirement.marker is not None and not requirement.marker.evaluate(environment):
                continue
            version = pins.get(canonicalize_name(requirement.name))
            assert version and requirement.specifier.contains(version), f"{requirement}: {version} is pinned"


@pytest.mark.parametrize("path", sorted(LOCKS.glob("*.txt")), ids=lambda path: path.name)
def test_every_pin_has_hashes_and_no_lock_names_a_place(lock, path):
    pins = lock.parse(path.read_text())
    assert pins and "://" not in path.read_text() and "--index" not in path.read_text()
    for pin in pins:
        assert pin.hashes, pin.requirement
        assert all(re.fullmatch(r"[0-9a-f]{64}", each) for each in pin.hashes), pin.requirement


def test_torchs_lock_has_every_build_that_is_offered(lock):
    """A file for each system and Python: for the processor everywhere, with CUDA where the index has one."""
    text = (LOCKS / "torch.txt").read_text()
    [pin] = lock.parse(text)
    rows = {name: digest for digest, name in re.findall(r"^# ([0-9a-f]{64})  (\S+)$", text, re.MULTILINE)}
    assert set(rows.values()) <= set(pin.hashes)
    for python in ("311", "312", "313", "314"):
        for build, system in [
            ("+cpu", "manylinux_2_28_x86_64"),
            ("+cpu", "manylinux_2_28_aarch64"),
            ("+cpu", "win_amd64"),
            ("", "macosx_14_0_arm64"),
            ("+cu130", "manylinux_2_28_x86_64"),
            ("+cu130", "manylinux_2_28_aarch64"),
            ("+cu130", "win_amd64"),
            ("+cu126", "manylinux_2_28_x86_64"),
            ("+cu126", "manylinux_2_28_aarch64"),
            ("+cu126", "win_amd64"),
        ]:
            assert f"torch-{pin.version}{build}-cp{python}-cp{python}-{system}.whl" in rows


def test_the_locks_for_cuda_12_are_of_the_locked_torch_and_of_cuda_12(lock):
    """By names and versions: a library for CUDA 13 would be fetched, and never be loaded."""
    [torch] = lock.parse((LOCKS / "torch.txt").read_text())
    text = (LOCKS / "torch-cuda12.txt").read_text()
    asked = re.findall(r"^# torch (\S+)\+cu126 asks for (.+)$", text, re.MULTILINE)
    pins = pinned(lock, ["torch-cuda12.txt"], "3.12", ("linux", "x86_64"))
    assert asked and {version for version, _ in asked} == {torch.version}
    for requirement in map(Requirement, (each for _, each in asked)):
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)])
    for name in (
        "cublas",
        "cuda-nvrtc",
        "cuda-runtime",
        "cudnn",
        "cufft",
        "cusolver",
        "cusparse",
        "nvjitlink",
    ):
        assert f"nvidia-{name}-cu12" in pins
    of_13 = pinned(lock, ["torch-cuda.txt"], "3.12", ("linux", "x86_64"))
    assert {name for name in pins if pins[name] == of_13.get(name)} <= {"cuda-pathfinder", "triton"}
    assert (
        pinned(lock, ["torch-cuda12.txt"], "3.12", ("win32", "AMD64")) == {}
    )  # Windows' wheel has all in it
    assert pinned(lock, ["warp12.txt"], "3.12", ("linux", "x86_64"))["warp-lang"].startswith("1.17.")


def test_the_bundled_wheels_are_those_that_blenders_side_is_tested_with(lock):
    bundled = {Requirement(line.split(" --hash")[0]).name: line for line in wheels()}
    pins = {pin.name: pin for pin in lock.parse((LOCKS / "blender.txt").read_text())}
    for name, line in bundled.items():
        version, digest = re.fullmatch(r"\S+==(\S+) --hash=sha256:(\S+)", line).groups()
        assert pins[name].version == version and digest in pins[name].hashes


def wheels() -> list[str]:
    return [line for line in (ROOT / "tools" / "wheels.txt").read_text().splitlines() if line[:1].isalnum()]


@pytest.mark.parametrize("name", INSTALLING)
def test_what_installs_names_no_index_but_pytorchs_and_adds_none(name):
    text = (ROOT / name).read_text()
    hosts = {urlsplit(url).hostname for url in re.findall(r"https?://[^\s\"'`)]+", text)}
    assert hosts <= {"download.pytorch.org"}
    assert not re.search(r"extra-index-url|find-links [^\s]*/|trusted-host", text)


def test_what_changed_is_said(lock):
    before = "a==1 --hash=sha256:aa\nb==1 --hash=sha256:bb\nc==1 --hash=sha256:cc\nd==1 --hash=sha256:dd\n"
    after = "a==1 --hash=sha256:aa\nb==2 --hash=sha256:b2\nc==1 \\\n    --hash=sha256:cc"
    after += " \\\n    --hash=sha256:c2\n"
    after += 'e==3 ; sys_platform == "linux" --hash=sha256:ee\n'
    assert lock.changes("x.txt", before, after) == [
        "x.txt: d 1 is gone",
        "x.txt: b 1 → 2",
        "x.txt: c 1: 1 files more, 0 fewer",
        'x.txt: e 3 ; sys_platform == "linux" is new',
    ]
    with pytest.raises(lock.LockError, match="pins no version"):
        lock.parse("a>=1 --hash=sha256:aa")


def test_pytorchs_page_is_read_and_its_rows_stay_where_it_cannot_be(lock, tmp_path, monkeypatch, capsys):
    """Of the page: this version, the systems and Pythons that are served, files that it gives a hash for."""
    names = {
        "torch-2.13.0%2Bcpu-cp312-cp312-win_amd64.whl": True,
        "torch-2.13.0-cp314-cp314-macosx_14_0_arm64.whl": True,
        "torch-2.13.0%2Bcpu-cp310-cp310-win_amd64.whl": False,
        "torch-2.13.0%2Bcpu-cp313-cp313-linux_s390x.whl": False,
        "torch-2.13.1%2Bcpu-cp312-cp312-win_amd64.whl": False,
    }
    hashes = {name: f"{number:064x}" for number, name in enumerate(names, 1)}
    page = tmp_path / "page.html"
    page.write_text(
        "".join(f'<a href="/whl/cpu/{name}#sha256={hashes[name]}">x</a>\n' for name in names)
        + '<a href="/whl/cpu/torch-2.13.0%2Bcpu-cp311-cp311-win_amd64.whl">no hash</a>'
    )
    pin = lock.Pin("torch==2.13.0", ("f" * 64,))
    monkeypatch.setattr(lock, "PYTORCH_PAGES", (page.as_uri(),))
    text = lock.torch_lock(pin, "")
    [locked] = lock.parse(text)
    assert set(locked.hashes) == {"f" * 64, *(hashes[name] for name, wanted in names.items() if wanted)}
    monkeypatch.setattr(lock, "PYTORCH_PAGES", ((tmp_path / "gone.html").as_uri(),))
    assert lock.torch_lock(pin, text) == text
    assert "cannot be read" in capsys.readouterr().err
    [other] = lock.parse(lock.torch_lock(lock.Pin("torch==2.14.0", ("e" * 64,)), text))
    assert other.hashes == ("e" * 64,)  # another version's files are not carried over


def test_what_torch_for_cuda_12_asks_for_is_read_from_the_index_and_kept(lock, tmp_path, monkeypatch, capsys):
    """Of its wheel for Linux on x86-64 and of this version; of that, what no other build asks for."""
    wheel = "torch-2.13.0%2Bcu126-cp312-cp312-manylinux_2_28_x86_64.whl"
    digest = "a" * 64
    page = tmp_path / "page.html"
    names = [wheel.replace("x86_64", "aarch64"), wheel.replace("2.13.0", "2.13.1"), wheel]
    page.write_text("".join(f'<a href="{name}#sha256={digest}">x</a>\n' for name in names))
    (tmp_path / (wheel.replace("%2B", "+") + ".metadata")).write_text(
        "Name: torch\nRequires-Dist: filelock\nRequires-Dist: triton==3.7.1; platform_system == 'Linux'\n"
        "Requires-Dist: nvidia-cudnn-cu12==9.10.2.21; platform_system == 'Linux'\n"
    )
    monkeypatch.setattr(lock, "CUDA12_PAGE", page.as_uri())
    asked = [
        "triton==3.7.1; platform_system == 'Linux'",
        "nvidia-cudnn-cu12==9.10.2.21; platform_system == 'Linux'",
    ]
    assert lock.asked_by_cuda12("2.13.0", "# torch 2.13.0+cu126 asks for nvidia-old\n") == asked
    monkeypatch.setattr(lock, "CUDA12_PAGE", (tmp_path / "gone.html").as_uri())
    former = "".join(f"# torch 2.13.0+cu126 asks for {each}\n" for each in asked)
    assert lock.asked_by_cuda12("2.13.0", former) == asked
    assert "cannot be read" in capsys.readouterr().err
    with pytest.raises(lock.LockError, match=r"lists no torch 2\.15\.0"):
        lock.asked_by_cuda12("2.15.0", former)


def test_where_it_cannot_resolve_nothing_is_changed(lock, tmp_path, monkeypatch, capsys):
    """As where an environment cannot be made, or the network is away."""
    shutil.copytree(LOCKS, tmp_path / "locks")
    monkeypatch.setattr(lock, "LOCKS", tmp_path / "locks")
    monkeypatch.setattr(lock.venv.EnvBuilder, "create", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["lock.py"])
    assert lock.main() == 1 and "Nothing was changed" in capsys.readouterr().err
    assert all((tmp_path / "locks" / path.name).read_bytes() == path.read_bytes() for path in LOCKS.glob("*"))
