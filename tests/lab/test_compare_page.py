# SPDX-License-Identifier: GPL-3.0-or-later
"""lab/compare.md does what it says: its folder is measured, its method trains, its commands exist."""

import dataclasses
import importlib.util
import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import torch

from physhdr.backend.cli import _command, main
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.lab import peers, presets
from physhdr.lab.benchmark.external import FIELDS
from physhdr.lab.benchmark.plan import PLACEHOLDERS, make_plan

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "lab" / "compare.md"
CODE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def module_of(path: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


#: How the other page's rows of tables become entries.
rows = module_of(ROOT / "tests/lab/peers/test_page.py", "test_page").rows
small = module_of(ROOT / "tests/backend/scene/small_data_set.py", "small_data_set")


def blocks(language: str) -> list[str]:
    return [code for kind, code in CODE.findall(PAGE.read_text(encoding="utf-8")) if kind == language]


def commands() -> list[list[str]]:
    """Every command of the page, its words; lines that go on are joined."""
    text = "\n".join(blocks("sh")).replace("\\\n", " ")
    return [shlex.split(line, comments=True) for line in text.splitlines() if line.strip()]


# ---- as pictures -----------------------------------------------------------------------------------------


def test_the_scripts_folder_is_measured_by_the_pages_command(tmp_path, monkeypatch, capsys):
    """With a renderer that knows the truth; its pictures are as good as 8 bits can be."""
    data = small.write_data_set(tmp_path / "data")
    theirs = tmp_path / "theirs"
    renderer = ModuleType("my_renderer")
    renderer.radiance = lambda pose, angle: small.radiance(round(pose[0, 3]))
    renderer.develop = lambda light, seconds: small.to_8_bit(small.response(light * seconds))
    monkeypatch.setitem(sys.modules, "my_renderer", renderer)
    (script,) = (block for block in blocks("python") if "my_renderer" in block)
    places = {"data/benchmark/dog": data, "results/theirs/dog/exp3/seed_0": theirs}
    for name, place in places.items():
        assert f'"{name}"' in script
        script = script.replace(f'"{name}"', repr(str(place)))
    exec(compile(script, str(PAGE), "exec"), {})
    (words,) = (
        words for words in commands() if words[1:3] == ["evaluate", "--pictures"] and "RUN" not in words
    )
    words = [str(places.get(word, word)) for word in words]
    assert words[0] == "physhdr" and main(words[1:]) == 0
    evaluation = json.loads((theirs / "evaluation.json").read_text())
    assert evaluation["conditions"]["exposure_mode"] == "exp3" and len(evaluation["ldr"]) == 10
    for part in ("LDR-OE", "LDR-NE", "HDR"):
        assert evaluation["means"][part]["psnr"] == 100.0, part


def test_what_the_page_says_of_files_is_what_is_read():
    text = PAGE.read_text(encoding="utf-8")
    cost = json.loads(re.search(r"^\| `cost.json` \| `(.*?)` \|", text, re.MULTILINE).group(1))
    assert cost.keys() == FIELDS.keys()
    assert set(re.findall(r"`\{(\w+)\}`", text)) == set(PLACEHOLDERS)


def test_the_plans_rows_name_a_method(tmp_path):
    (tmp_path / "dog").mkdir()
    content = tomllib.loads(blocks("toml")[0])
    content |= {
        "scenes": ["dog"],
        "budgets": ["iterations=5"],
        "seeds": [0, 1, 2],
        "settings": ["exp1", "exp3"],
    }
    (method,) = make_plan(content, tmp_path).methods
    values = {"scene": "dog", "setting": "exp3", "seed": 0, "budget": "iterations-5"}
    assert method.pictures_of(values).parts[-5:] == ("results", "theirs", "dog", "exp3", "seed_0")


# ---- as a method -----------------------------------------------------------------------------------------


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The page's three pieces of code where it puts them, for as long as a test runs."""
    source, method_row, preset_row = (block for block in blocks("python") if "my_renderer" not in block)
    (tmp_path / "my_method.py").write_text(source)
    name = "physhdr.lab.peers.my_method"
    spec = importlib.util.spec_from_file_location(name, tmp_path / "my_method.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    for key, row in rows(method_row, peers).items():
        monkeypatch.setitem(peers.METHODS, key, row)
    for key, config in rows(preset_row, presets).items():
        monkeypatch.setitem(presets.PRESETS, key, config)
    return module


def test_the_method_trains_by_the_pages_command_and_is_evaluated(mine, tiny_data, tmp_path, capsys):
    (line,) = re.findall(r"`(physhdr train [^`]*)`", PAGE.read_text(encoding="utf-8"))
    run = tmp_path / "run"
    words = [{"DATA": str(tiny_data), "RUN": str(run)}.get(word, word) for word in shlex.split(line)]
    assert main([*words[1:], "--iterations", "20", "--set", "method.dark_weight=0.5"]) == 0
    opened = open_run(run)
    assert type(opened.method) is mine.MyMethod and opened.config.method.dark_weight == 0.5
    assert main(["evaluate", str(run)]) == 0


def test_its_further_term_is_one_of_the_loss(mine, tiny_data):
    """Beside those of the baseline, which it leaves as they are."""
    scene = read_scene(tiny_data)
    configs = [PRESETS[name] for name in ("mine", "baseline")]
    trainers = [begin(scene, dataclasses.replace(config, iterations=3)) for config in configs]
    ours, theirs = (step(state) for state in trainers)
    assert float(ours.pop("dark")) > 0.0 and ours.keys() == theirs.keys()
    assert all(torch.equal(torch.as_tensor(ours[k]), torch.as_tensor(theirs[k])) for k in ours)


# ---- the commands ----------------------------------------------------------------------------------------


def test_every_command_is_understood(monkeypatch):
    found = [words for words in commands() if words[0] == "physhdr"]
    assert {words[1] for words in found} == {"render", "evaluate", "benchmark"}
    for words in found:
        assert dataclasses.is_dataclass(_command(words[1:]))
    tools = [words[1:] for words in commands() if words[0] == ".venvs/backend/bin/python"]
    scenes = module_of(ROOT / "lab" / "tools" / "benchmark_data.py", "benchmark_data").SAMPLES
    for tool, *words in tools:
        assert (ROOT / tool).is_file()
        assert tool != "lab/tools/benchmark_data.py" or set(words) <= scenes.keys()
    (words,) = (words for words in found if "--plan" in words)
    plan = tomllib.loads((ROOT / words[words.index("--plan") + 1]).read_text(encoding="utf-8"))
    methods = words[words.index("--methods") + 1 : words.index("--external")]
    assert len(methods) == 2 and set(methods) <= set(plan["methods"]), "peers train as in the plan"
