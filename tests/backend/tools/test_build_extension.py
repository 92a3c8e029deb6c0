# SPDX-License-Identifier: GPL-3.0-or-later
"""No wheel is bundled but the pinned one: not one that lies there already, not one that gets into the zip."""

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
NAMES = ("thing-1.2-py3-none-any.whl", "other-3.0-py3-none-any.whl")
CONTENT = {name: name.encode() * 9 for name in NAMES}
HASHES = {name: hashlib.sha256(content).hexdigest() for name, content in CONTENT.items()}


@pytest.fixture(scope="module")
def tool():
    path = ROOT / "tools" / "build_extension.py"
    spec = importlib.util.spec_from_file_location("build_extension", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def project(tmp_path):
    """A project that bundles two wheels, both there."""
    (tmp_path / "wheels").mkdir()
    (tmp_path / "tools").mkdir()
    (tmp_path / "blender_manifest.toml").write_text(f"wheels = {[f'./wheels/{name}' for name in NAMES]}")
    pins = [f"{'=='.join(name.split('-')[:2])} --hash=sha256:{HASHES[name]}" for name in NAMES]
    (tmp_path / "tools" / "wheels.txt").write_text("\n".join(["# What is bundled.", *pins, ""]))
    for name, content in CONTENT.items():
        (tmp_path / "wheels" / name).write_bytes(content)
    return tmp_path


def test_wheels_that_are_as_pinned_are_taken_and_missing_ones_named(tool, project):
    pinned = tool.pinned_wheels(project)
    assert pinned == HASHES and tool.check_wheels(project, pinned) == []
    (project / "wheels" / NAMES[0]).unlink()
    assert tool.check_wheels(project, pinned) == [NAMES[0]]


@pytest.mark.parametrize("name", [NAMES[0], "stranger-1.0-py3-none-any.whl", "folder/x.txt"])
def test_a_file_in_wheels_that_is_not_pinned_is_named_with_the_remedy(tool, project, name):
    path = project / "wheels" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"evil")
    with pytest.raises(tool.BuildError) as refused:
        tool.check_wheels(project, tool.pinned_wheels(project))
    assert str(path) in refused.value.message and f"rm '{path}'" in refused.value.remedy


def test_manifest_and_pins_must_name_the_same(tool, project):
    pins = project / "tools" / "wheels.txt"
    whole = pins.read_text()
    pins.write_text(whole.replace("thing==1.2", "thing==1.3"))
    with pytest.raises(tool.BuildError, match=NAMES[0]):
        tool.pinned_wheels(project)
    pins.write_text(whole + f"third==1.0 --hash=sha256:{'0' * 64}\n")
    with pytest.raises(tool.BuildError, match="different wheels"):
        tool.pinned_wheels(project)


@pytest.mark.parametrize(
    "inside",
    [
        {NAMES[0]: b"evil"},
        {NAMES[0]: None},
        {"stranger-1.0-py3-none-any.whl": b"evil"},
        {"notes.txt": b"evil"},
    ],
)
def test_a_zip_with_any_other_wheel_is_refused_by_its_name(tool, tmp_path, inside):
    path = tmp_path / "made.zip"
    for content, fits in ((CONTENT, True), (CONTENT | inside, False)):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("backend/launch.py", "")
            for name, data in content.items():
                if data is not None:
                    archive.writestr(f"wheels/{name}", data)
        if fits:
            tool.check_zip(path, HASHES)
        else:
            with pytest.raises(tool.BuildError, match=next(iter(inside))):
                tool.check_zip(path, HASHES)


def test_the_build_of_a_tampered_checkout_fails_and_leaves_no_zip(tmp_path):
    """`printf evil > wheels/plyfile-….whl`, then the tool as `make extension` runs it; no network."""
    for name in ("blender_manifest.toml", "tools/wheels.txt", "tools/build_extension.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "wheels").mkdir()
    pins = (ROOT / "tools" / "wheels.txt").read_text().split("\n# ")[-1]
    [plyfile] = [line.split(" ")[0] for line in pins.splitlines() if line.startswith("plyfile")]
    evil = tmp_path / "wheels" / f"{plyfile.replace('==', '-')}-py3-none-any.whl"
    evil.write_bytes(b"evil")
    command = [sys.executable, tmp_path / "tools" / "build_extension.py"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1 and evil.name in done.stderr and "rm '" in done.stderr
    assert not list(tmp_path.rglob("*.zip"))
