# SPDX-License-Identifier: GPL-3.0-or-later
"""`make dist`: both distributions hold what they must, of what git knows, and it says what they lack."""

import importlib.util
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PYPROJECT = """\
[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "physhdr"
version = "3.2.1"

[tool.setuptools]
package-dir = { physhdr = "." }
include-package-data = false
packages = ["physhdr", "physhdr.backend"]

[tool.setuptools.package-data]
physhdr = ["py.typed", "pyproject.toml", "blender_manifest.toml", "locks/*.txt"]
"physhdr.backend" = ["*.csv"]
"""


@pytest.fixture
def dist():
    spec = importlib.util.spec_from_file_location("build_dist_tool", ROOT / "tools" / "build_dist.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def project(dist, tmp_path) -> Path:
    """A small project of this one's shape, in a repository, with something that git does not know."""
    root = tmp_path / "project"
    files = dict.fromkeys(dist.READ, "") | {
        "pyproject.toml": PYPROJECT,
        "MANIFEST.in": "graft docs\ngraft locks\ninclude py.typed blender_manifest.toml\n",
        "__init__.py": "",
        "backend/__init__.py": "",
        "backend/trainer.py": "",
        "backend/published.csv": "",
        "docs/page.md": "",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    subprocess.run(["git", "init", "--quiet", root], check=True)
    subprocess.run(["git", "-C", root, "add", "."], check=True)
    (root / "backend" / "mine.py").write_text("")
    return root


def test_it_builds_of_what_git_knows(dist, project, tmp_path):
    source, wheel = dist.build(project, tmp_path / "out")
    assert (source.name, wheel.name) == ("physhdr-3.2.1.tar.gz", "physhdr-3.2.1-py3-none-any.whl")
    with tarfile.open(source) as archive:
        names = archive.getnames()
    assert "physhdr-3.2.1/docs/page.md" in names and "physhdr-3.2.1/backend/mine.py" not in names
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {"physhdr/backend/trainer.py", "physhdr/backend/published.csv", "physhdr/py.typed"} <= set(names)
    assert not [name for name in names if "docs" in name or "mine" in name]
    assert not (project / "build").exists()


@pytest.mark.parametrize(
    ("name", "before", "after", "told"),
    [
        (
            "MANIFEST.in",
            "graft docs\n",
            "",
            "the source distribution lacks docs/page.md\n  Name them in MANIFEST.in",
        ),
        ("pyproject.toml", ', "physhdr.backend"]', "]", "the wheel lacks backend/__init__.py"),
        ("pyproject.toml", '"*.csv"', "", "the wheel lacks backend/published.csv"),
    ],
    ids=["source", "package", "data"],
)
def test_what_is_missing_is_named(dist, project, tmp_path, name, before, after, told):
    text = (project / name).read_text()
    assert before in text
    (project / name).write_text(text.replace(before, after))
    if name == "pyproject.toml":  # in the source distribution all the same
        (project / "MANIFEST.in").write_text("graft backend\n" + (project / "MANIFEST.in").read_text())
    with pytest.raises(dist.BuildError) as error:
        dist.build(project, tmp_path / "out")
    assert told in str(error.value)
    assert not list((tmp_path / "out").iterdir())


def test_outside_a_checkout_it_says_so(dist, tmp_path):
    with pytest.raises(dist.BuildError, match="git lists no files"):
        dist.build(tmp_path, tmp_path / "out")


def test_without_git_it_says_what_to_install(dist, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(dist.BuildError, match=r"git, .* cannot be run: No such file.*\n  Install it"):
        dist.build(tmp_path, tmp_path / "out")


@pytest.mark.long
def test_of_this_checkout_nothing_is_missing(dist, tmp_path):
    try:
        dist.tracked(ROOT)
    except dist.BuildError:
        pytest.skip("this is not a checkout")
    dist.build(ROOT, tmp_path / "out")
