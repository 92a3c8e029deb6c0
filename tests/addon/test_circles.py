# SPDX-License-Identifier: GPL-3.0-or-later
"""No module of the extension needs itself: read from the sources, imports inside functions included."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ADDON = Path(__file__).resolve().parents[2] / "addon"


def module(path: Path) -> str:
    """``addon.viewport.live``; a package by its own name."""
    parts = path.relative_to(ADDON.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path, modules: set[str]) -> set[str]:
    """The modules among ``modules`` that a file imports by a relative name."""
    package = module(path).split(".") if path.name == "__init__.py" else module(path).split(".")[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) + 1 - node.level] + (node.module.split(".") if node.module else [])
            found |= {".".join(base), *(".".join([*base, alias.name]) for alias in node.names)}
    return (found & modules) - {"addon", module(path)}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """A chain of modules whose last one is its first; empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_module_imports_itself_by_way_of_others():
    paths = {module(path): path for path in ADDON.rglob("*.py")}
    graph = {name: imports(path, set(paths)) for name, path in paths.items()}
    assert graph["addon.runtime"] >= {"addon.settings", "addon.viewport.live"}
    # A package's modules may take what stands beside them; the package imports them to register them.
    graph.pop("addon.viewport")
    assert circle(graph) == []


@pytest.mark.parametrize("line", ["from .runtime import session", "def f():\n    from . import runtime"])
def test_a_circle_is_found(tmp_path, monkeypatch, line):
    """As it was: settings took the session from runtime, which takes the folder from settings."""
    monkeypatch.setitem(globals(), "ADDON", tmp_path / "addon")
    (tmp_path / "addon").mkdir()
    for name, text in {"runtime": "from . import settings", "settings": line}.items():
        (tmp_path / "addon" / f"{name}.py").write_text(text)
    paths = {module(path): path for path in (tmp_path / "addon").glob("*.py")}
    assert len(circle({name: imports(path, set(paths)) for name, path in paths.items()})) == 3
