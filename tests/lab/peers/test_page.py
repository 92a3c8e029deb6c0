# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/contributing/a-method.md does what it says: its code, put where it says, is a method that trains."""

import dataclasses
import importlib.util
import re
import shlex
import sys
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.bridge import presets as named
from physhdr.lab import peers, presets

PAGE = Path(__file__).resolve().parents[3] / "docs" / "contributing" / "a-method.md"
CODE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    return [code for kind, code in CODE.findall(PAGE.read_text(encoding="utf-8")) if kind == language]


def rows(block: str, module) -> dict:
    """The row of a table in ``module`` that a block adds, after its imports."""
    names = dict(vars(module))
    imports = [line for line in block.splitlines() if line.startswith("from ")]
    exec("\n".join(imports), names)
    return eval("{" + "".join(line for line in block.splitlines() if line not in imports) + "}", names)


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """The page's five pieces of code where it puts them, for as long as a test runs."""
    source, method_row, preset_row, description, test = blocks("python")
    path = tmp_path / "my_toy.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("physhdr.lab.peers.my_toy", path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    for name, row in rows(method_row, peers).items():
        monkeypatch.setitem(peers.METHODS, name, row)
    for name, config in rows(preset_row, presets).items():
        monkeypatch.setitem(presets.PRESETS, name, config)
    (listed,) = eval(f"({description})", vars(named))
    monkeypatch.setitem(named.PRESETS, listed.name, listed)
    module.proof = test
    return module


def test_it_trains_and_is_evaluated_by_the_pages_commands(toy, tiny_data, tmp_path, capsys):
    run = tmp_path / "run"
    for line in blocks("sh")[0].splitlines():
        words = [{"DATA": str(tiny_data), "RUN": str(run)}.get(word, word) for word in shlex.split(line)]
        more = ["--iterations", "60"] if words[1] == "train" else []
        assert words[0] == "physhdr" and main(words[1:] + more) == 0
    assert "LDR-OE" in capsys.readouterr().out
    opened = open_run(run)
    assert type(opened.method) is toy.Toy and opened.iteration == 60
    assert opened.config == dataclasses.replace(presets.PRESETS["toy"], iterations=60)


def test_it_learns(toy, tiny_data):
    config = dataclasses.replace(presets.PRESETS["toy"], iterations=80, supervision="bracket")
    state = begin(read_scene(tiny_data), config)
    losses = [float(step(state)["l1"]) for _ in range(config.iterations)]
    assert sum(losses[-10:]) < 0.6 * sum(losses[:10])


def test_its_preset_is_listed(toy):
    assert named.PRESETS.keys() == PRESETS.keys()


def test_the_test_it_shows_passes(toy):
    names: dict = {}
    exec(toy.proof, names)
    tests = [value for name, value in names.items() if name.startswith("test_")]
    assert tests
    for test in tests:
        test()
