# SPDX-License-Identifier: GPL-3.0-or-later
"""What several rooms must agree on stands in ``bridge/`` and nowhere else. Read from the sources."""

import ast
import re
from pathlib import Path

import pytest

from physhdr.bridge import splatting, srgb

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("addon", "backend", "bridge", "lab", "synth")
LIMITS = [name for name in vars(splatting) if name.isupper()]
CURVE = (srgb.SLOPE, srgb.CODE_KNEE, srgb.LINEAR_KNEE, srgb.SCALE)


@pytest.fixture(scope="module")
def nodes() -> list[tuple[str, ast.AST]]:
    """Every name and constant in every module of the rooms, with the module's path."""
    return [
        (path.relative_to(ROOT).as_posix(), node)
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Name | ast.Constant)
    ]


def numbers_of(node: ast.AST) -> list[float]:
    """The number that a piece of source is, or those with a decimal point in its text: shaders are texts."""
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(value, str):
        return [float(text) for text in re.findall(r"\d+\.\d+", value)]
    return [value] if isinstance(value, float) else []


@pytest.mark.parametrize("name", LIMITS)
def test_a_splats_limit_is_given_its_value_in_one_place(nodes, name: str) -> None:
    places = {
        path
        for path, node in nodes
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id == name
    }
    assert places == {"bridge/splatting.py"}


@pytest.mark.parametrize("number", CURVE)
def test_a_number_of_the_srgb_curve_stands_in_one_place(nodes, number: float) -> None:
    assert {p for p, node in nodes if number in numbers_of(node)} == {"bridge/srgb.py"}


def test_no_path_of_a_users_is_resolved_by_pathlib() -> None:
    """Before Python 3.13 it raises RuntimeError of links in a loop; ``bridge.regular.resolved`` does not."""
    own = re.compile(r"Path\(__file__\)\.resolve\(\)")
    found = {
        path.relative_to(ROOT).as_posix()
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if ".resolve(" in own.sub("", path.read_text(encoding="utf-8"))
    }
    assert found == set()
