# SPDX-License-Identifier: GPL-3.0-or-later
"""`make lint`: three systems, of two of them the files that can differ there; one failure fails it."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
IDENTITY = ("-c", "user.name=A", "-c", "user.email=a@b.c")


@pytest.fixture
def lint():
    spec = importlib.util.spec_from_file_location("lint_tool", ROOT / "tools" / "lint.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_files_that_may_differ_on_another_system_are_found(lint, tmp_path):
    texts = {
        "import": "import os\n",
        "from": "def f():\n    from subprocess import Popen\n",
        "asks": "import sys\nif sys.platform == 'win32':\n    pass\n",
        "owner": "print(path.owner())\n",
        "other": "import osgeo, sys\nfrom pathlib import Path\nprint(sys.argv, 'import os')\n",
    }
    (tmp_path / "bridge").mkdir()
    for name, text in texts.items():
        (tmp_path / "bridge" / f"{name}.py").write_text(text)
    found = {Path(name).stem for name in lint.files_that_differ(tmp_path)}
    assert found == texts.keys() - {"other"}


@pytest.mark.parametrize("whole", [True, False])
def test_pyright_looks_as_on_each_system(lint, whole):
    commands = {name: command for name, command in lint.checks(whole=whole).items() if "pyright" in name}
    systems = {command[command.index("--pythonplatform") + 1]: command for command in commands.values()}
    assert systems.keys() == {"Linux", "Windows", "Darwin"}
    assert all((command[-1].endswith(".py")) != whole for name, command in systems.items() if name != "Linux")
    assert systems["Linux"][-1] == "Linux"  # every file that pyproject.toml includes


def test_the_quick_ones_and_the_others_are_all(lint, monkeypatch):
    monkeypatch.setattr(lint, "changed_files", lambda root: ["bridge/srgb.py"])
    quick, others = lint.checks(quick=True), lint.checks(others=True)
    assert quick | others == lint.checks()
    assert quick["pyright"][-2:] == ["Linux", "bridge/srgb.py"] and not any("ruff" in name for name in others)
    monkeypatch.setattr(lint, "changed_files", lambda root: [])
    assert lint.checks(quick=True).keys() == quick.keys() - {"pyright"}  # without files it looks at all


def test_what_changed_is_what_the_branch_it_follows_lacks(lint, tmp_path):
    def git(*words: str) -> None:
        subprocess.run(
            ["git", *IDENTITY, "-C", str(tmp_path / "mine"), *words], check=True, capture_output=True
        )

    def write(name: str) -> None:
        (tmp_path / "mine" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "mine" / name).write_text(f"# {name}, {lint.changed_files(tmp_path / 'mine')}\n")

    (tmp_path / "mine").mkdir()
    git("init", "-b", "main", ".")
    for name in ("bridge/same.py", "bridge/removed.py", "bridge/edited.py", "tests/test_it.py"):
        write(name)
    git("add", ".")
    git("commit", "-m", "theirs")
    assert lint.changed_files(tmp_path / "mine") == []  # it follows none
    git("branch", "theirs")
    git("branch", "--set-upstream-to", "theirs")
    write("lab/committed.py")
    git("add", ".")
    git("commit", "-m", "mine")
    for name in ("bridge/edited.py", "tests/test_it.py", "addon/new.py", "docs/page.md"):
        write(name)
    (tmp_path / "mine" / "bridge" / "removed.py").unlink()
    assert lint.changed_files(tmp_path / "mine") == ["addon/new.py", "bridge/edited.py", "lab/committed.py"]


@pytest.mark.parametrize("failing", ["first", "second", None])
def test_one_failure_fails_it_and_all_are_told(lint, monkeypatch, capsys, failing):
    def checks(**options: bool) -> dict[str, list[str]]:
        return {
            name: [sys.executable, "-c", f"print('it is {name}'); raise SystemExit({int(name == failing)})"]
            for name in ("first", "second")
        }

    monkeypatch.setattr(lint, "checks", checks)
    monkeypatch.setattr(sys, "argv", ["lint.py"])
    assert lint.main() == (0 if failing is None else 1)
    told = capsys.readouterr().out
    assert "it is first" in told and "it is second" in told
    assert told.count("passed") == (2 if failing is None else 1)
