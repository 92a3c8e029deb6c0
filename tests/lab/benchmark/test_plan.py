# SPDX-License-Identifier: GPL-3.0-or-later
"""A plan from a file, from flags and back; what is refused, each with one clear message."""

import errno
import itertools
import shutil
import tomllib
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.bridge.errors import PhysHDRError
from physhdr.lab.benchmark.plan import Method, make_plan, read_plan, write_plan
from physhdr.lab.command import Benchmark, configuration

ROOT = Path(__file__).parents[3]
PLAN = """
methods = ["default", 'bold := default backbone.threshold=4e-4 "points_file=a b"']
scenes = ["rooms/bath", "night=rooms/bath"]
settings = ["exp3", "exp1"]
seeds = [0, 1]
budgets = ["iterations=1000", "cpu-seconds=2.5"]
set = ["backbone.budget=30000", "half_size_until=0.1"]
margins_of = ["bold"]
[[ladder]]
name = "one \\"step\\""
steps = ["default", "bold"]
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "rooms" / "bath").mkdir(parents=True)
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml"


def test_a_plan_survives_being_written(file, tmp_path):
    plan = make_plan(read_plan(file), Path.cwd())
    assert plan.methods[1].assignments == ("backbone.threshold=4e-4", "points_file=a b")
    assert plan.scenes[1].name == "night" and plan.scenes[1].data == tmp_path / "rooms" / "bath"
    assert plan.assignments == ("backbone.budget=30000", "half_size_until=0.1")
    write_plan(plan, tmp_path / "elsewhere" / "plan.toml")
    assert make_plan(read_plan(tmp_path / "elsewhere" / "plan.toml"), Path.cwd()) == plan


def test_assignments_are_read_with_their_quotes(file):
    texts = ["points_file='my points.ply'", r'points_file="C:\my points\#1.ply"', "training_exposures=0 2 4"]
    plan = make_plan(read_plan(file) | {"set": texts}, Path.cwd())
    expected = ("points_file=my points.ply", r"points_file=C:\my points\#1.ply", "training_exposures=0 2 4")
    assert plan.assignments == expected
    options = [word for text in expected for word in ("--set", text)]
    assert plan.training_options(plan.methods[0]) == ("--preset", "default", *options)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"default", ', '"../x", ', "'../x' cannot be the name of a method"),
        ('"default", ', '"bold", ', "has the method 'bold' 2 times"),
        ('"default", ', '"x := default seed=3", ', "the method 'x' sets seed"),
        ('"default", ', '"Bold", ', "methods 'Bold' and 'bold' differ only in case"),
        ('"rooms/bath"', '"Night=rooms"', "scenes 'Night' and 'night' differ only in case"),
        ('"default", ', '"x. := default", ', "'x.' cannot be the name of a method"),
        ('"default", ', '"aux := default", ', "'aux' cannot be the name of a method: .* it is a device"),
        ('"rooms/bath"', '"Com1.5=rooms"', "'Com1.5' cannot be the name of a scene: .* it is a device"),
        ('"rooms/bath"', '"rooms/nowhere"', "there is no data set"),
        ('"rooms/bath"', '"~nobody-of-this-name/bath"', "there is no data set"),
        ('"rooms/bath"', '"night=rooms"', "has the scene 'night' 2 times"),
        ('"exp1"', '"exp2"', "no setting 'exp2'"),
        ("[0, 1]", "[0, -1]", "'seeds' cannot be read"),
        ("[0, 1]", "[]", "the plan has no seed"),
        ('"cpu-seconds=2.5"', '"hours=3"', "'hours=3' is not a budget"),
        ('"cpu-seconds=2.5"', '"cpu-seconds=nan"', "is not a budget"),
        ('"iterations=1000"', '"iterations=2.5"', "whole numbers"),
        ("half_size_until=0.1", "seed=3", "--set seed=3 cannot be used"),
        ("half_size_until=0.1", "points_file='a b", "--set points_file='a b cannot be read: No closing quot"),
        ('margins_of = ["bold"]', 'margins_of = ["shy"]', "no method 'shy'"),
        ('"default", "bold"]', '"default", "shy"]', "no method 'shy'"),
        ("settings =", "seetings =", "a plan has no 'seetings'"),
        ("methods = [", "methods = [[", "is not a plan"),
    ],
)
def test_what_cannot_be_run_is_refused(file, old, new, said):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(PhysHDRError, match=said):
        make_plan(read_plan(file), Path.cwd())


PLANS = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "lab" / "plans").rglob("*.toml"))


@pytest.mark.parametrize("name", PLANS)
def test_our_plans_can_be_run(name, tmp_path):
    (tmp_path / name).parent.mkdir(parents=True)
    file = Path(shutil.copy(ROOT / name, tmp_path / name))
    for scene in tomllib.loads(file.read_text())["scenes"]:
        (file.parent / scene).mkdir(parents=True)  # the data sets are made by make report
    plan = make_plan(read_plan(file), Path.cwd())
    configs = {method.name: configuration(plan, method.name) for method in plan.methods}
    alike = [(a, b) for a, b in itertools.combinations(configs, 2) if configs[a] == configs[b]]
    assert not alike  # every option of a variant changes something


def test_a_method_keeps_paths_as_windows_writes_them():
    calibration, points = r"calibration=C:\data\night\cal.json", r'points_file="D:\my points\#1.ply"'
    method = Method.parsed(f"""cal := default {calibration} {points} x="it's" """)
    assert method.assignments == (calibration, r"points_file=D:\my points\#1.ply", "x=it's")
    assert Method.parsed(str(method)) == method
    with pytest.raises(PhysHDRError, match="No closing quot"):
        Method.parsed("x := default points_file='a b")


def test_a_method_is_a_preset_under_its_own_name():
    assert Method.parsed("paper") == Method("paper", "paper")
    assert str(Method.parsed("paper")) == "paper"
    assert str(Method.parsed("x:=paper 'a=b c'")) == "x := paper 'a=b c'"


def test_a_plan_written_by_hand_stays_as_it_is(tiny_data, tmp_path, monkeypatch, capsys):
    """Reporting does not change it, nor does a command that asks for the same."""
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "tiny").symlink_to(tiny_data)
    written = """# Why these: they are quick.
methods = ["baseline", "paper"]
scenes = ["tiny=../tiny"]
budgets = ["iterations=5"]
set = ["downscale=2"]
"""
    (out / "plan.toml").write_text(written)
    assert main(["benchmark", "--out", str(out), "--report-only", "--methods", "paper"]) == 0
    text = (out / "report.md").read_text()
    assert "paper (1 of 1)" in text
    # What was given instead of the plan's stands in the command that makes the report again.
    assert "`physhdr benchmark --methods paper --out OUT`" in text
    words = ["--report-only", "--device", "cpu", "--threads-per-job", "2"]
    assert main(["benchmark", "--out", str(out), *words]) == 0
    said = "`physhdr benchmark --device cpu --threads-per-job 2 --out OUT`"
    assert said in (out / "report.md").read_text()
    monkeypatch.setattr(Benchmark, "_do_runs", lambda *_: None)
    assert main(["benchmark", "--out", str(out)]) == 0
    assert (out / "plan.toml").read_text() == written
    assert main(["benchmark", "--out", str(out), "--methods", "paper"]) == 0  # another plan is kept
    assert 'methods = ["paper"]' in (out / "plan.toml").read_text()


def test_no_threads_are_refused_by_the_flag_as_by_the_plan(tiny_data, tmp_path, capsys):
    words = ["--methods", "paper", "--scenes", str(tiny_data), "--budget", "iterations=5"]
    assert main(["benchmark", *words, "--threads-per-job", "0", "--out", str(tmp_path / "out")]) == 1
    assert "--threads-per-job is 0" in capsys.readouterr().err


def test_what_the_disk_refuses_is_one_clear_message(tiny_data, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device", "/somewhere/file")

    monkeypatch.setattr("physhdr.lab.command.data_fingerprint", full)
    words = ["--methods", "paper", "--scenes", str(tiny_data), "--budget", "iterations=5"]
    assert main(["benchmark", *words, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ") and "No space left" in said and "/somewhere/file" in said


def test_what_the_example_sets_acts_on_every_method(tiny_data):
    """``set`` in lab/benchmarking.md and in the help."""
    content = {"methods": ["default", "default-scaffold", "hdr-nerf", "gausshdr", "hdr-gs"]}
    content |= {"scenes": [str(tiny_data)], "budgets": ["iterations=5"], "set": ["downscale=2"]}
    plan = make_plan(content, tiny_data)
    assert all(configuration(plan, method.name).downscale == 2 for method in plan.methods)
