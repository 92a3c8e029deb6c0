# SPDX-License-Identifier: GPL-3.0-or-later
"""The tree as a stranger finds it: one version, all packages, pages that tell the truth, nothing private."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
ROOMS = ("addon", "backend", "bridge", "lab", "synth")
DOOR = ["CONTRIBUTING.md", *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("docs/contributing/*.md"))]
#: Names that the pages give to what a reader is going to make.
TO_BE_MADE = re.compile(r"\bmy_|^DATA|preview\.png|^runs/|^data/|^dist/|^\.venvs/")

#: What no file may name. Each pattern, and an example, which shows that it can be found.
PRIVATE = {
    "a folder of somebody's machine": (
        # Homebrew is where it is on every Mac.
        r"(?<![\w.}$-])/(?:work|root|opt(?!/homebrew/)|mnt|var/tmp|home/(?!me\b)\w+|Users/(?!me\b)\w+)/\w",
        "/ro" + "ot/data",
    ),
    "what only we can open": (r"(?<![\w/])shared[/]", "shar" + "ed/data.md"),
    "an issue's number": (r"(?i)\bissues? #?\d+\b", "Iss" + "ue 3"),
    "a mirror or an index of packages": (
        r"https?://(?!download\.pytorch\.org\b|127\.0\.0\.1\b|\{)[^\s\"'`)>]*(?:/simple|/whl)\b"
        r"|\bdeb\.debian\.org\b|\bpypi\.org\b|\bfiles\.pythonhosted\.org\b",
        "https://deb.deb" + "ian.org/debian",
    ),
}


def tracked() -> dict[str, str]:
    """Every text file that git knows, by its name."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this is not a checkout")
    found = {}
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.is_file() and b"\0" not in (content := path.read_bytes())[:8192]:
            found[name] = content.decode("utf-8", errors="replace")
    return found


@pytest.fixture(scope="module")
def files() -> dict[str, str]:
    return tracked()


@pytest.mark.parametrize("what", PRIVATE)
def test_no_file_names(what, files):
    pattern, example = PRIVATE[what]
    assert re.search(pattern, example)
    found = [
        f"{name}:{number}: {line.strip():.100}"
        for name, text in files.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if re.search(pattern, line)
    ]
    assert not found, "\n".join(found)


def test_the_packages_that_are_installed_are_all_that_there_are():
    named = PROJECT["tool"]["setuptools"]["packages"]
    inits = [path for room in ROOMS for path in (ROOT / room).rglob("__init__.py")]
    folders = [path.parent.relative_to(ROOT) for path in inits]
    assert sorted(named) == sorted(["physhdr", *(".".join(("physhdr", *each.parts)) for each in folders)])


def test_hooks_before_a_commit_fetch_nothing_and_run_what_lint_runs():
    text = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert set(re.findall(r"repo: (\S+)", text)) == {"local"}
    assert set(re.findall(r"language: (\S+)", text)) == {"system"}
    entries = re.findall(r"entry: \.venvs/backend/bin/(.+)", text)
    assert [entry.removesuffix(" --force-exclude") for entry in entries] == [
        "ruff check",
        "ruff format --check",
        "pyright",
    ]


def test_the_version_is_pyprojects_everywhere():
    version = PROJECT["project"]["version"]
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == version
    [cited] = re.findall(
        r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert cited == version
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = changelog.partition("\n## ")[2].partition("\n## ")[0]
    assert version in newest
    pages = "".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "README.md", ROOT / "docs" / "guide.md")
    )
    assert set(re.findall(r"physhdr-(\d+\.\d+\.\d+)", pages)) <= {version}  # the zip to be installed
    assert manifest["license"] == [f"SPDX:{PROJECT['project']['license']}"]


@pytest.mark.parametrize("page", DOOR)
def test_what_the_door_names_is_there(page):
    """Files and folders, in commands too, and `make` targets; tests/test_docs.py follows the links."""
    text = (ROOT / page).read_text(encoding="utf-8")
    words = set(
        re.findall(r"(?<![\w/.-])[\w.*-]+(?:/[\w.*-]*)+(?![\w/])|\b[\w.-]+\.(?:py|toml|cff)\b", plain(text))
    )
    missing = [word for word in words if not TO_BE_MADE.search(word) and not is_there(word.rstrip("."), page)]
    assert not missing, f"{page} names {sorted(missing)}"
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"(?:^|`)make ([a-z-]+)", plain(text), re.MULTILINE)) <= targets


def plain(text: str) -> str:
    """What the page has in code: between backticks, and its blocks of commands."""
    return "\n".join(re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL))


def is_there(word: str, page: str) -> bool:
    """Whether ``word`` is a path, or the name of a file in a folder that the page names."""
    if any(ROOT.glob(word.rstrip("/"))):
        return True
    folders = set(re.findall(r"[\w.-]+(?:/[\w.-]+)*/", (ROOT / page).read_text(encoding="utf-8")))
    return any(any((ROOT / folder).glob(word.rstrip("/"))) for folder in folders)
