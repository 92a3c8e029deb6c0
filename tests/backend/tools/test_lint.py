# SPDX-License-Identifier: GPL-3.0-or-later
"""`make lint`: three systems, of two of them the files that can differ there; one failure fails it."""

import importlib.util
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


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


def test_the_quick_ones_and_the_others_are_all(lint):
    quick, others = lint.checks(quick=True), lint.checks(others=True)
    assert {*quick, *others} - {"pyright, the rest"} == lint.checks().keys()
    words = [word for command in quick.values() for word in command]
    assert "Linux" in words and not {"Windows", "Darwin"} & set(words)
    # As on Linux, each file that pyproject.toml includes once: by its name, or by a folder that comes later.
    shipped = {word for word in quick["pyright"] if word.endswith(".py")}
    later = others["pyright, the rest"][others["pyright, the rest"].index("Linux") + 1 :]
    included = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pyright"]["include"]
    for path in (path.relative_to(ROOT) for room in included for path in (ROOT / room).rglob("*.py")):
        assert (str(path) in shipped) != any(path.is_relative_to(folder) for folder in later), path
    assert shipped and all((ROOT / folder).is_dir() for folder in later)


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
