# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods of which only pictures are there: in a plan, evaluated once, in the tables and the margins."""

import csv
import json
import shutil
import sys
from pathlib import Path

import pytest

from physhdr.backend.cli import main
from physhdr.backend.jobs.pools import LocalPool
from physhdr.backend.scene import read_scene
from physhdr.bridge.errors import BadValueError, FileDamagedError, PhysHDRError
from physhdr.lab.benchmark.external import pictures_digest, read_cost
from physhdr.lab.benchmark.live import progress_table
from physhdr.lab.benchmark.plan import make_plan, read_plan, write_plan
from physhdr.lab.benchmark.report import write_report
from physhdr.lab.benchmark.runs import Store, data_fingerprint
from physhdr.lab.benchmark.schedule import Schedule

FAKE = Path(__file__).with_name("fake_physhdr.py")

# ---- in a plan ------------------------------------------------------------------------------------------

PLAN = """
methods = ["default"]
scenes = ["rooms/bath"]
settings = ["exp3", "exp1"]
seeds = [0, 1]
budgets = ["iterations=1000"]
set = ["downscale=2", "backbone.budget=3"]
margins_of = ["theirs"]
[[external]]
name = "theirs"
folder = "../of others/{scene}/{setting}/seed_{seed}/{budget}"
[[ladder]]
name = "both"
steps = ["default", "theirs"]
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "plans" / "rooms" / "bath").mkdir(parents=True)
    (tmp_path / "plans" / "plan.toml").write_text(PLAN)
    return tmp_path / "plans" / "plan.toml"


def test_an_external_method_is_one_of_the_plans(file, tmp_path):
    plan = make_plan(read_plan(file), Path.cwd())
    ours, theirs = plan.methods
    assert plan.trained == (ours,) and str(theirs) == "theirs"
    values = {"scene": "bath", "setting": "exp1", "seed": 1, "budget": "iterations-1000"}
    assert (
        theirs.pictures_of(values) == tmp_path / "of others" / "bath" / "exp1" / "seed_1" / "iterations-1000"
    )
    assert theirs.place == tmp_path / "of others"
    assert plan.picture_options == ("--downscale", "2")
    write_plan(plan, tmp_path / "elsewhere" / "plan.toml")
    assert make_plan(read_plan(tmp_path / "elsewhere" / "plan.toml"), Path.cwd()) == plan


def test_a_plan_may_have_nothing_but_pictures(file, tmp_path):
    text = file.read_text().replace('methods = ["default"]\n', "").split("[[ladder]]")[0]
    file.write_text(text)
    plan = make_plan(read_plan(file), Path.cwd())
    assert [method.name for method in plan.methods] == ["theirs"] and plan.trained == ()
    write_plan(plan, tmp_path / "plan.toml")
    assert make_plan(read_plan(tmp_path / "plan.toml"), Path.cwd()) == plan


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("{budget}", "{method}", r"has the unknown placeholder \{method\}\n.*\{scene\}, \{setting\}"),
        ("seed_{seed}", "all", r"the plan has 2 seeds, the folder of 'theirs' no \{seed\}"),
        ("{setting}", "all", r"the plan has 2 settings, the folder of 'theirs' no \{setting\}"),
        ('folder = "../of', 'path = "../of', "an external method is a name and a folder"),
        ('name = "theirs"', 'name = "default"', "has the method 'default' 2 times"),
        ('name = "theirs"', 'name = "../x"', "cannot be the name of a method"),
        ("[[external]]", "[external]", "'external' cannot be read|an external method is a name and a folder"),
    ],
)
def test_what_an_external_method_cannot_be(file, old, new, said):
    text = file.read_text().split("[[ladder]]")[0].replace('margins_of = ["theirs"]\n', "")
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(PhysHDRError, match=said):
        make_plan(read_plan(file), Path.cwd())


# ---- what the pictures cost, and which they are ---------------------------------------------------------


def test_costs_are_taken_as_they_are_told(tmp_path):
    assert read_cost(tmp_path) == {}
    costs = {"cpu_seconds": 61.5, "seconds": 40, "iterations": 3000.0, "gaussians": None, "memory_MB": 900}
    (tmp_path / "cost.json").write_text(json.dumps(costs))
    assert read_cost(tmp_path) == {
        "cpu_seconds": 61.5,
        "seconds": 40.0,
        "iterations": 3000,
        "peak_memory": 900_000_000,
    }


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ('{"cpu_second": 3}', BadValueError, "'cpu_second', but may say cpu_seconds, seconds, iterations"),
        ('{"seconds": "3"}', BadValueError, "seconds is '3'"),
        ('{"seconds": -1}', BadValueError, "seconds is -1"),
        ('{"seconds": true}', BadValueError, "seconds is True"),
        ('{"seconds": NaN}', BadValueError, "seconds is nan"),
        ("[]", FileDamagedError, "not an object"),
    ],
)
def test_costs_that_mean_nothing_are_refused(tmp_path, text, error, said):
    (tmp_path / "cost.json").write_text(text)
    with pytest.raises(error, match=said):
        read_cost(tmp_path)


def test_pictures_are_known_by_what_evaluation_reads(tmp_path):
    def put(name, text="a"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)

    for name in ("test/r_0_0.png", "test_hdr/hdr_000.exr", "val/r_0_0.png", "val_hdr/hdr_000.exr"):
        put(name)
    report, tune = (pictures_digest(tmp_path, kind) for kind in ("report", "tune"))
    for name in ("evaluation.json", "comparison.png", "methods.png", "model.pth", "log.txt", ".old/a.png"):
        put(name)  # an evaluation's own, and what is no picture
    assert pictures_digest(tmp_path, "report") == report and pictures_digest(tmp_path, "tune") == tune
    put("test/r_0_0.png", "b")
    assert pictures_digest(tmp_path, "report") != report and pictures_digest(tmp_path, "tune") == tune
    put("cost.json", "{}")
    assert pictures_digest(tmp_path, "tune") != tune


# ---- evaluated once, and reported ------------------------------------------------------------------------


class Bench:
    """A benchmark of ``quick`` and of pictures in ``of others``, whose plan a test changes."""

    def __init__(self, root: Path) -> None:
        self.root, self.lines = root, []
        for name in ("day", "night"):
            (root / name).mkdir()
            (root / name / "data.json").write_text(name)
        self.content = {
            "methods": ["quick"],
            "scenes": [str(root / "day"), str(root / "night")],
            "budgets": ["iterations=50"],
            "seeds": [0, 1],
            "set": ["downscale=2"],
            "external": [{"name": "theirs", "folder": "of others/{scene}/seed_{seed}"}],
        }

    def pictures(self, scene: str, seed: int, psnr: float, **cost: float) -> Path:
        folder = self.root / "of others" / scene / f"seed_{seed}"
        (folder / "test").mkdir(parents=True, exist_ok=True)
        (folder / "test" / "r_0_0.png").write_text(str(psnr))
        if cost:
            (folder / "cost.json").write_text(json.dumps(cost))
        return folder

    def run(self, **options) -> Schedule:
        plan = make_plan(self.content, self.root)
        data = {scene.name: data_fingerprint(scene.data, plan.kind) for scene in plan.scenes}
        trained = [(method.name, scene.name) for method in plan.trained for scene in plan.scenes]
        configs = {each: {"strength": ""} for each in trained}
        store = Store(self.root / "out", plan, configs, data)
        self.lines.clear()
        schedule = Schedule(
            store, log=self.lines.append, program=(sys.executable, "-I", "-S", str(FAKE)), **options
        )
        schedule.do_all(LocalPool(2))
        return schedule

    def calls(self) -> list[str]:
        """Which pictures were evaluated since the last call: 'folder scene setting downscale'."""
        path = self.root / "calls.txt"
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return sorted(line.removeprefix("evaluate ") for line in lines if line.startswith("evaluate"))

    def report(self, schedule: Schedule) -> tuple[str, list[dict[str, str]]]:
        path, table = write_report(schedule, self.root / "report.md", "physhdr benchmark")
        with table.open() as file:
            return path.read_text(), list(csv.DictReader(file))


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def kinds(schedule: Schedule) -> dict[str, str]:
    """The status of each run of theirs, 'scene seed'."""
    external = [run for run in schedule.runs if run.pictures]
    return {f"{run.scene.name} {run.seed}": schedule.status[run].kind for run in external}


def test_pictures_are_evaluated_once_and_stand_in_the_tables(bench):
    bench.pictures("day", 0, 37.0, cpu_seconds=61.5, iterations=3000, gaussians=20000, memory_MB=950)
    bench.pictures("day", 1, 37.5)
    bench.pictures("night", 0, 36.0)
    schedule = bench.run()
    assert kinds(schedule) == {"day 0": "done", "night 0": "done", "day 1": "done", "night 1": "absent"}
    assert bench.calls() == ["seed_0 day exp3 2", "seed_0 night exp3 2", "seed_1 day exp3 2"]
    text, rows = bench.report(schedule)
    theirs = {(row["scene"], row["seed"]): row for row in rows if row["method"] == "theirs"}
    assert len(theirs) == 3 and len(rows) == 7
    known = theirs["day", "0"]
    assert (known["LDR-OE.psnr"], known["cpu_seconds"], known["iterations"]) == ("37.0", "61.5", "3000")
    assert (known["gaussians"], known["peak_memory"], known["preset"]) == ("20000", "950000000", "")
    unknown = theirs["night", "0"]
    assert (
        unknown["cpu_seconds"] == unknown["gaussians"] == unknown["peak_memory"] == unknown["threads"] == ""
    )
    # quick has 35 + 0.1 a seed: −2 and −2.4 on day, −1 on night, of which seed 1 is missing.
    row = next(line for line in text.splitlines() if line.startswith("| theirs | 3 |"))
    assert row.startswith("| theirs | 3 | -1.60 ")
    assert "Runs without a result: theirs (1 of 4)" in text and "pairs are missing: `theirs` (3 of 4)" in text
    assert (
        "`iterations-50/exp3/night/theirs/seed_1`: not run: there is no folder of others/night/seed_1" in text
    )
    assert "method theirs: another program's pictures" in text and str(bench.root) not in text
    assert progress_table(schedule).renderables
    again = bench.run()
    assert kinds(again)["day 0"] == "done" and not bench.calls() and not bench.lines


def test_new_pictures_and_new_costs_are_measured_again(bench):
    folder = bench.pictures("day", 0, 37.0)
    bench.content["seeds"], bench.content["scenes"] = [0], [str(bench.root / "day")]
    bench.run()
    bench.calls()
    (folder / "test" / "r_0_0.png").write_text("38.0")
    schedule = bench.run()
    assert bench.calls() == ["seed_0 day exp3 2"]
    assert any(
        "done again; changed: its pictures, their costs or the data set" in line for line in bench.lines
    )
    assert bench.report(schedule)[1][1]["LDR-OE.psnr"] == "38.0"
    (folder / "cost.json").write_text('{"seconds": 5}')
    schedule = bench.run()
    assert bench.calls() and bench.report(schedule)[1][1]["seconds"] == "5.0"
    (bench.root / "day" / "data.json").write_text("brighter")
    bench.run()
    assert bench.calls()
    bench.run(evaluate_again=True)
    assert bench.calls()
    shutil.rmtree(folder)
    schedule = bench.run()
    assert kinds(schedule) == {"day 0": "absent"} and len(bench.report(schedule)[1]) == 1


def test_pictures_that_cannot_be_measured_stop_nothing(bench):
    folder = bench.pictures("day", 0, 37.0)
    (folder / "test" / "r_0_0.png").unlink()
    bench.pictures("night", 0, 36.0, cpu_second=3)
    bench.content["seeds"] = [0]
    schedule = bench.run()
    assert kinds(schedule) == {"day 0": "failed", "night 0": "failed"}
    assert [schedule.status[run].kind for run in schedule.runs if not run.pictures] == ["done", "done"]
    text, _ = bench.report(schedule)
    assert "error: of others/day/seed_0/test/r_0_0.png is missing" in text and "has 'cpu_second', but" in text
    bench.calls()
    assert kinds(bench.run())["day 0"] == "failed" and not bench.calls()  # as it was: not tried again
    (folder / "test" / "r_0_0.png").write_text("39")
    assert kinds(bench.run()) == {"day 0": "done", "night 0": "failed"}


def test_a_budget_of_cpu_seconds_neither_waits_for_pictures_nor_they_for_a_search(bench):
    bench.pictures("day", 0, 37.0, cpu_seconds=9.0)
    bench.content |= {"seeds": [0], "budgets": ["cpu-seconds=1"], "scenes": [str(bench.root / "day")]}
    schedule = bench.run()
    assert kinds(schedule) == {"day 0": "done"} and not list((bench.root / "out").rglob("theirs/search.json"))
    text, _ = bench.report(schedule)
    assert "theirs took 900% to 900% of the 1 CPU seconds" in text


# ---- the command ----------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_command_measures_pictures_as_evaluate_does(tiny_data, tmp_path, capsys):
    """The data set's own pictures under another name: nothing is nearer to the truth."""
    theirs = tmp_path / "theirs" / "tiny" / "seed_0"
    for name in ("test", "test_hdr", "relit"):
        shutil.copytree(tiny_data / name, theirs / name)
    words = ["--external", f"theirs={tmp_path}/theirs/{{scene}}/seed_{{seed}}", "--seeds", "0,1"]
    words += ["--scenes", f"tiny={tiny_data}", "--budget", "iterations=5", "--out", str(tmp_path / "out")]
    assert main(["benchmark", *words]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of 2 runs skipped: there is no folder" in said and "tiny/seed_1" in said
    run = tmp_path / "out" / "iterations-5" / "exp3" / "tiny" / "theirs" / "seed_0"
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert evaluation["means"]["LDR-NE"]["psnr"] == evaluation["means"]["HDR"]["psnr"] == 100.0
    assert evaluation["conditions"]["exposure_mode"] == "exp3" and len(evaluation["relit"]) == 2
    assert len(evaluation["views"]) == len(read_scene(tiny_data).test)
    assert main(["benchmark", "--out", str(tmp_path / "out")]) == 0  # by the plan that was kept
    assert "| theirs | 100.00 |" in (tmp_path / "out" / "report.md").read_text()


def test_a_report_states_the_size_that_was_compared_and_no_noise_of_another(tiny_data, tmp_path):
    data = shutil.copytree(tiny_data, tmp_path / "tiny")
    info = json.loads((data / "dataset.json").read_text())
    floor = {"psnr": [42.0] * 5, "hdr_psnr": 41.0}
    (data / "dataset.json").write_text(json.dumps(info | {"noise_floor": floor}))
    words = ["--external", f"theirs={tmp_path}/theirs", "--scenes", f"tiny={data}"]
    words += ["--budget", "iterations=5", "--out", str(tmp_path / "out"), "--report-only"]
    lines = []
    for more in ([], ["--set", "downscale=2"], ["--set", "downscale=1"]):
        assert main(["benchmark", *words, *more]) == 0
        text = (tmp_path / "out" / "report.md").read_text()
        lines.append(next(line for line in text.splitlines() if line.startswith("- scene tiny")))
    whole, half, stated = lines
    assert whole == stated and "32×32" in whole and "agree to" in whole
    assert "16×16" in half and "agree to" not in half


@pytest.mark.long
def test_a_report_alone_loses_no_run_that_was_evaluated(tiny_data, tmp_path, capsys):
    """Neither by weights of LPIPS that the plan names since, nor where nothing is done of a changed plan."""
    theirs, out = tmp_path / "theirs", tmp_path / "out"
    for name in ("test", "test_hdr"):
        shutil.copytree(tiny_data / name, theirs / name)
    words = ["--external", f"theirs={theirs}", "--scenes", f"tiny={tiny_data}", "--budget", "iterations=5"]
    assert main(["benchmark", *words, "--out", str(out)]) == 0
    weights = tmp_path / "weights.npz"
    weights.write_bytes(b"other ones")
    again = ["benchmark", "--out", str(out), "--report-only"]
    assert main([*again, "--lpips-weights", str(weights)]) == 0
    good = (out / "report.md").read_text(), (out / "report.csv").read_text()
    assert "| theirs | 100.00 |" in good[0] and len(good[1].splitlines()) == 2
    assert "- 1 of 1 runs were evaluated with other LPIPS weights, or without\n" in good[0]

    (theirs / "cost.json").write_text('{"seconds": 3}')  # its run is another one now
    capsys.readouterr()
    assert main(again) == 1
    assert "no run of this plan is done: not replacing" in " ".join(capsys.readouterr().out.split())
    assert ((out / "report.md").read_text(), (out / "report.csv").read_text()) == good
    assert main([*again, "--report", str(tmp_path / "elsewhere.md")]) == 1
    assert main(again[:-1]) == 0 and "| theirs | 3.00 |" in (out / "report.md").read_text()
