# SPDX-License-Identifier: GPL-3.0-or-later
"""What a benchmark takes a training to be is what ``physhdr train`` makes of the data, whatever these are."""

import json
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.lab.benchmark.plan import make_plan
from physhdr.lab.benchmark.runs import Store, data_fingerprint, differences, runs_of
from physhdr.lab.command import configuration, configurations
from physhdr.tests.backend.scene import layouts

METHODS = [
    "default",
    "baseline",
    "paper-short",
    "small := default backbone.budget=60000",
    "some := default training_exposures=0,2",
]


def write_large(root: Path) -> Path:
    """The layout of HDR-NeRF-Syn with six times the pixels for which the presets' numbers are."""
    return layouts.write_syn(root, scale=6.0)


#: What is written, and a setting that some method then has otherwise than its preset.
DATA = {
    "larger than 200×200": (write_large, "backbone.budget"),
    "photographs": (lambda root: layouts.write_colmap(root, poses=4), "training_exposures"),
    "HDR-NeRF-Real": (lambda root: layouts.write_real(root, poses=4), ""),
}


@pytest.mark.parametrize(
    ("write", "found"),
    [
        pytest.param(*case, id=name, marks=[pytest.mark.long] * (name != "photographs"))
        for name, case in DATA.items()
    ],
)
def test_a_run_is_expected_to_be_what_is_trained(write, found, tmp_path):
    root = write(tmp_path / "data")
    content = {"methods": METHODS, "scenes": [str(root)], "budgets": ["iterations=1"], "settings": ["exp1"]}
    # So that it is quick: no stereo.
    plan = make_plan(content | {"set": ["initial_points=random", "random_points=300"]}, tmp_path)
    presets = {method.name: configuration(plan, method.name) for method in plan.methods}
    configs = configurations(plan, presets, tmp_path / "out")
    store = Store(tmp_path / "out", plan, configs, {"data": data_fingerprint(root)})
    changed = []
    for run in runs_of(plan):
        out = tmp_path / run.method.name
        own = ["--seed", "0", "--exposure-mode", run.setting, "--iterations", "1", "--device", "cpu"]
        assert main(["train", str(root), *plan.training_options(run.method), *own, "--out", str(out)]) == 0
        trained = json.loads((out / "config.json").read_text())["config"]
        assert differences(store.config(run, 1), trained) == []
        preset = presets[run.method.name]
        if trained["training_exposures"] != list(preset.training_exposures):
            changed.append("training_exposures")
        if trained["backbone"]["budget"] != preset.backbone.budget:
            changed.append("backbone.budget")
    assert set(changed) == ({found} if found else set())


def test_of_data_that_cannot_be_read_the_training_says_so_not_the_plan(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "notes.txt").write_text("no data set")
    content = {"methods": ["default"], "scenes": [str(tmp_path / "data")], "budgets": ["iterations=1"]}
    plan = make_plan(content, tmp_path)
    (config,) = configurations(plan, {"default": configuration(plan, "default")}, tmp_path).values()
    assert config["backbone"]["budget"] == configuration(plan, "default").backbone.budget
