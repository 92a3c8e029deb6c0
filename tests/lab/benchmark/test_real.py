# SPDX-License-Identifier: GPL-3.0-or-later
"""The command with the real trainer, on a Ray cluster that it starts: a tiny run from plan to report."""

import json
import re

import pytest

from physhdr.backend.cli import main
from physhdr.lab.benchmark.plan import make_plan
from physhdr.lab.command import configuration


def command(*words):
    return main(["benchmark", *(str(word) for word in words)])


@pytest.mark.long
def test_a_tiny_benchmark_on_ray_from_plan_to_report(tiny_data, tmp_path, capsys):
    out, report = tmp_path / "out", tmp_path / "report.md"
    words = ["--methods", "short := baseline sh_degree_every=5", "--scenes", f"tiny={tiny_data}"]
    words += ["--budget", "iterations=12", "--set", "backbone.budget=500", "--out", out]
    assert command(*words, "--ray", "local", "--report", report) == 0
    folder = out / "iterations-12" / "exp3" / "tiny" / "short" / "seed_0"
    config = json.loads((folder / "config.json").read_text())["config"]
    assert config["backbone"]["budget"] == 500 and config["sh_degree_every"] == 5
    record = json.loads((folder / "run.json").read_text())
    events = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert record["cpu_seconds"] == events[-1]["cpu_seconds"] > 0 and record["iterations"] == 12
    assert record["peak_memory"] > 1e8 and record["machine"]["versions"]["torch"]
    psnr = json.loads((folder / "evaluation.json").read_text())["means"]["LDR-OE"]["psnr"]
    text = report.read_text()
    assert f"{psnr:.2f}" in text and "tiny: 32×32, 3 train, 3 test" in text and "All 1 runs are done" in text
    # The plan is in the folder: the same command without it finds everything done.
    capsys.readouterr()
    assert command("--out", out) == 0 and "1 runs, 0 to be done" in capsys.readouterr().out


def test_the_configuration_is_what_the_words_come_to(tiny_data):
    content = {"methods": ["default", "x := paper backbone.stop=0.25"], "scenes": [str(tiny_data)]}
    content |= {"budgets": ["iterations=5"], "set": ["method.tone_mapper.local=true"]}
    plan = make_plan(content, tiny_data)
    config = configuration(plan, "x")
    assert config.backbone.stop == 0.25
    default = configuration(plan, "default")
    assert default.backbone != config.backbone and default.method.tone_mapper.local is True


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("nobody", "no preset 'nobody'"),
        (
            "x := default backbone.nothing=3",
            "the method 'x': there is no setting 'backbone.nothing'",
        ),
        ("x := default backbone.stop=soon", "the method 'x': --set backbone.stop must be a number"),
    ],
)
def test_a_method_that_cannot_be_trained_is_refused_before_anything_runs(
    tiny_data, tmp_path, capsys, method, said
):
    words = ["--methods", method, "--scenes", tiny_data, "--budget", "iterations=5"]
    assert command(*words, "--out", tmp_path / "out") == 1
    message = capsys.readouterr().err
    assert re.search(said, message, re.DOTALL) and "Traceback" not in message
    assert not (tmp_path / "out").exists()
