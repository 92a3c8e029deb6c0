# SPDX-License-Identifier: GPL-3.0-or-later
"""Which runs are done, repeated, kept and taken over. A fake program trains; the schedule is the real one."""

import csv
import errno
import importlib.util
import itertools
import json
import math
import os
import shutil
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from physhdr.backend.jobs.pools import LocalPool
from physhdr.bridge.data_set import MAKER
from physhdr.bridge.errors import OutputError
from physhdr.bridge.lock import Claims
from physhdr.lab.benchmark import report, runs
from physhdr.lab.benchmark.live import progress_table
from physhdr.lab.benchmark.plan import make_plan
from physhdr.lab.benchmark.report import write_report
from physhdr.lab.benchmark.runs import Store, data_fingerprint, put_in_place, runs_of
from physhdr.lab.benchmark.schedule import Schedule

FAKE = Path(__file__).with_name("fake_physhdr.py")
_spec = importlib.util.spec_from_file_location("fake_physhdr", FAKE)
fake = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(fake)


class Bench:
    """A benchmark in ``root`` whose plan a test changes; ``lines`` are its lines for the user."""

    def __init__(self, root):
        self.root, self.lines = root, []
        for name in ("day", "night"):
            (root / name).mkdir()
            (root / name / "data.json").write_text(name)
        self.content = {"methods": ["quick"], "scenes": [str(root / "day")], "budgets": ["iterations=50"]}

    def schedule(self, weights="", **options):
        plan = make_plan(self.content, self.root)
        configs: dict[tuple[str, str], dict[str, Any]] = {}
        for method, scene in itertools.product(plan.methods, plan.scenes):
            config: dict[str, Any] = {"strength": "".join(method.assignments).partition("=")[2]}
            if method.name == "hdr-nerf":
                config["method"] = {"name": "hdr-nerf"}
            configs[method.name, scene.name] = config
        data = {scene.name: data_fingerprint(scene.data, plan.kind) for scene in plan.scenes}
        store = Store(self.root / "out", plan, configs, data, weights)
        self.lines.clear()
        program = (sys.executable, "-I", "-S", str(FAKE))
        return Schedule(store, log=self.lines.append, program=program, **options)

    def run(self, jobs=2, **options):
        schedule = self.schedule(**options)
        schedule.do_all(LocalPool(jobs))
        return schedule

    def calls(self):
        """What was trained since the last call: 'preset scene seed iterations'."""
        path = self.root / "calls.txt"
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return [line.removeprefix("train ") for line in lines]

    def left_over(self):
        """Working folders and claims: there must be none at the end."""
        return [
            path for path in (self.root / "out").rglob(".*") if path.name != ".claims" or any(path.iterdir())
        ]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def kinds(schedule):
    return [schedule.status[run].kind for run in schedule.runs]


def test_every_run_is_done_once_and_never_again(bench):
    bench.content |= {"methods": ["quick", "other"], "seeds": [0, 1], "settings": ["exp1", "exp3"]}
    bench.content["scenes"].append(str(bench.root / "night"))
    schedule = bench.run(jobs=4)
    assert kinds(schedule) == ["done"] * 16
    assert sorted(bench.calls()) == sorted(
        f"{m} {s} {k} 50"
        for m in ("quick", "other")
        for s in ("day", "night")
        for k in (0, 1)
        for _ in range(2)
    )
    folder = bench.root / "out" / "iterations-50" / "exp1" / "night" / "other" / "seed_1"
    record = json.loads((folder / "run.json").read_text())
    expected = {
        "iterations": 50,
        "cpu_seconds": 0.5,
        "seconds": 1.0,
        "gaussians": 7,
        "peak_memory": 123000000,
    }
    assert expected.items() <= record.items() and (folder / "evaluation.json").exists()
    assert kinds(bench.run()) == ["done"] * 16 and bench.calls() == [] and not bench.left_over()


def test_a_changed_plan_repeats_what_changed_and_says_so(bench):
    bench.content |= {"methods": ["quick", "v := other strength=1"], "scenes": [str(bench.root / "day")]}
    bench.run()
    bench.calls()
    bench.content["methods"] = ["quick", "v := other strength=2"]
    bench.run()
    assert bench.calls() == ["other day 0 50"]
    assert any("v/seed_0: to be done again; changed: strength 1 → 2" in line for line in bench.lines)
    (bench.root / "day" / "data.json").write_text("brighter")
    bench.run()
    assert len(bench.calls()) == 2 and sum("changed: the data set" in line for line in bench.lines) == 2
    bench.content["budgets"].append("iterations=60")
    bench.run()
    assert sorted(bench.calls()) == ["other day 0 60", "quick day 0 60"]


def test_other_weights_of_lpips_repeat_the_evaluation_alone(bench):
    bench.run()
    bench.calls()
    bench.content["lpips_weights"] = str(FAKE)
    assert kinds(bench.run(weights="abc")) == ["done"] and bench.calls() == []
    folder = bench.root / "out" / "iterations-50" / "exp3" / "day" / "quick" / "seed_0"
    assert json.loads((folder / "evaluation.json").read_text())["weights"] == str(FAKE)
    assert json.loads((folder / "run.json").read_text())["cpu_seconds"] == 0.5 and not bench.left_over()


def test_a_training_that_is_not_what_was_asked_for_is_ended_as_soon_as_it_says_so(bench):
    bench.content["methods"] = ["hangs"]  # after its configuration, for longer than any test
    schedule = bench.schedule()
    schedule.store.configs["hangs", "day"]["strength"] = "9"
    schedule.do_all(LocalPool(1))
    (status,) = schedule.status.values()
    assert status.kind == "failed" and status.text.endswith("strength 9 → ")


def test_a_file_of_points_elsewhere_is_part_of_what_a_run_is(bench):
    """And a run from before there was that setting is the one that leaves it alone."""
    points = bench.root / "elsewhere.ply"
    points.write_bytes(b"some")
    store = bench.schedule().store
    run = runs_of(store.plan)[0]

    def known(**setting):
        configs = {("quick", "day"): store.configs["quick", "day"] | setting}
        return Store(store.out, store.plan, configs, store.data).training_fingerprint(run)

    before, first = known(), known(points_file=str(points))
    assert known(points_file=None) == before != first == known(points_file=str(points))
    points.write_bytes(b"others")
    changed = known(points_file=str(points))
    points.unlink()
    assert len({before, first, changed, known(points_file=str(points))}) == 4


def test_a_run_of_one_kind_of_plan_is_never_taken_for_one_of_the_other(bench):
    def split(*place):
        path = bench.root.joinpath("out", *place, "iterations-50", "exp3", "day", "quick", "seed_0")
        return json.loads((path / "evaluation.json").read_text())["conditions"]["split"]

    (bench.root / "day" / "transforms_train.json").write_text("{}")
    bench.run()
    bench.content["kind"] = "tune"
    assert kinds(bench.schedule()) == ["waiting"]
    schedule = bench.run()
    assert kinds(schedule) == ["done"] and not bench.left_over()
    assert (split(), split("tune")) == ("test", "val")
    report, table = write_report(schedule, bench.root / "report.md", "physhdr benchmark")
    assert (
        "validation views" in report.read_text().splitlines()[0] and str(bench.root) not in report.read_text()
    )
    assert [row["split"] for row in csv.DictReader(table.open())] == ["val"]
    bench.calls()
    del bench.content["kind"]
    assert kinds(bench.run()) == ["done"] and bench.calls() == []  # neither has replaced the other
    # Somebody evaluates the run by hand, on the other views: it is evaluated again, not trained again.
    path = bench.root / "out" / schedule.runs[0].folder.relative_to("tune") / "evaluation.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"conditions": {"split": "val"}}))
    assert kinds(bench.schedule()) == ["waiting"]
    assert kinds(bench.run()) == ["done"] and bench.calls() == [] and split() == "test"


def test_a_failure_stops_nothing_is_told_and_tried_again_when_asked(bench):
    bench.content |= {"methods": ["fails_once", "quick"], "budgets": ["cpu-seconds=1"], "seeds": [0, 1]}
    schedule = bench.run(jobs=1)
    # Seed 0 of the first searches for the iterations of both of its seeds.
    assert kinds(schedule) == ["failed", "done", "blocked", "done"]
    assert any("failed: error: the flux is out of order" in line for line in bench.lines)
    path, _ = write_report(schedule, bench.root / "report.md", "physhdr benchmark")
    text = path.read_text()
    assert "`physhdr train` ended with 3" in text and "it begins well\n  error: the flux" in text
    assert "Runs without a result: fails_once (2 of 2)" in text and "2 of 4 runs are done" in text
    bench.calls()
    assert kinds(bench.run()) == ["failed", "done", "blocked", "done"] and bench.calls() == []
    assert kinds(bench.run(retry=True)) == ["done"] * 4
    assert all(call.startswith("fails_once") for call in bench.calls()) and not bench.left_over()


def test_no_report_says_where_things_lie(bench):
    """Of messages, logs and options: a data set by its name in the plan, the benchmark's folder as OUT."""
    (bench.root / "day-2").mkdir()
    (bench.root / "day-2" / "data.json").write_text("{}")
    checkout, at = Path(report.__file__).parents[2], bench.root
    bench.content |= {
        "methods": ["quick", "fails", f"v := other strength={at}/day/truth"],
        "scenes": [f"noon={at}/day", str(at / "day-2")],
        "note": "One scene alone.",
    }
    schedule = bench.run()
    path = at / "out" / "iterations-50" / "exp3" / "noon" / "quick" / "seed_0" / "evaluation.json"
    message = f"{at}/day/a, {at}/day-2/a, {at}/out/a, {checkout}/a, {Path.home()}/a; not /else{at}/day"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"messages": [message]}))
    path, table = write_report(schedule, at / "report.md", "physhdr benchmark --out out")
    text, rows = path.read_text(), table.read_text()
    assert text.startswith("# Benchmark\n\nOne scene alone.\n\nWritten by ")
    assert f"noon/a, day-2/a, OUT/a, physhdr/a, ~/a; not /else{at}/day" in text
    assert "method v: `v := other strength=noon/truth`" in text and "strength=noon/truth" in rows
    everything = (text + rows).replace(f"/else{at}", "")
    assert not any(str(place) in everything for place in (at, checkout, Path.home()))


def test_a_job_may_move_its_folder_away_while_it_is_looked_at(bench, monkeypatch):
    """A job's process does so when it is done, and its scheduler looks into the folder at any moment."""
    schedule = bench.schedule()
    work = bench.root / "work"
    schedule._jobs[schedule.runs[0]] = replace(schedule._job(schedule.runs[0], alone=True), work=work)
    for listing in ("scandir", "listdir"):
        listed = getattr(os, listing)

        def vanishing(path, listed=listed):
            if Path(path) == work:
                work.rename(bench.root / "final")
            return listed(path)

        monkeypatch.setattr(os, listing, vanishing)
    work.mkdir()
    schedule._watch()
    assert not work.exists() and schedule.status[schedule.runs[0]].iteration == 0


def test_an_interruption_leaves_what_is_done_and_nothing_half_done(bench):
    bench.content["methods"] = ["quick", "hangs"]
    schedule = bench.schedule()
    shown = []

    def interrupt_when_it_hangs():
        shown.append(progress_table(schedule))
        hanging = schedule.status[schedule.runs[1]]
        if schedule.status[schedule.runs[0]].kind == "done" and hanging.iterations:
            assert (hanging.kind, hanging.iteration, hanging.iterations) == ("running", 1, 50)
            assert fakes_running(bench.root)
            raise KeyboardInterrupt

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        schedule.do_all(LocalPool(2), interrupt_when_it_hangs)
    assert time.monotonic() - begun < 30 and shown and not bench.left_over()
    assert not fakes_running(bench.root)
    assert kinds(bench.schedule()) == ["done", "waiting"]


def fakes_running(root):
    """Command lines of fake programs of this test that are alive."""
    lines = []
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(process.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue
    return [line for line in lines if str(FAKE) in line and str(root) in line]


def test_two_commands_share_the_runs(bench):
    bench.content |= {"seeds": list(range(6))}
    schedules = [bench.schedule(), bench.schedule()]
    threads = [threading.Thread(target=s.do_all, args=(LocalPool(2),)) for s in schedules]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert [kinds(s) for s in schedules] == [["done"] * 6] * 2
    assert sorted(bench.calls()) == [f"quick day {k} 50" for k in range(6)] and not bench.left_over()


def test_two_commands_where_nothing_can_be_locked_do_the_runs_twice_and_say_so(bench, monkeypatch):
    monkeypatch.setitem(sys.modules, "filelock", None)
    schedules = [bench.schedule(), bench.schedule()]
    threads = [threading.Thread(target=s.do_all, args=(LocalPool(1),)) for s in schedules]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert [kinds(s) for s in schedules] == [["done"]] * 2 and not bench.left_over()
    assert (
        len([line for line in bench.lines if "cannot be locked (this Python has no filelock)" in line]) == 2
    )


def test_what_a_dead_command_left_is_taken_over(bench):
    folder = bench.root / "out" / "iterations-50" / "exp3" / "day" / "quick"
    (folder / ".seed_0-dead").mkdir(parents=True)
    claims = bench.root / "out" / ".claims"
    claims.mkdir()
    # A dead process's claim, which nobody holds a lock on.
    owner = {"host": os.uname().nodename, "pid": os.getpid(), "token": "x"}
    (claims / "iterations-50__exp3__day__quick__seed_0").write_text(json.dumps(owner))
    (claims / "iterations-50__exp3__day__quick__seed_7").write_text(json.dumps(owner))
    assert kinds(bench.run()) == ["done"] and not bench.left_over()


def test_a_run_that_another_command_took_over_is_theirs_and_no_failure(bench):
    """As where somebody deletes the hidden folders: our claim is gone, our working folder, too."""
    bench.run()
    finished = bench.root / "finished"
    (bench.root / "out" / "iterations-50" / "exp3" / "day" / "quick" / "seed_0").rename(finished)
    bench.content["methods"] = ["hangs"]
    schedule = bench.schedule()
    run = schedule.runs[0]
    folder, claim = bench.root / "out" / run.folder, bench.root / "out" / ".claims" / run.claim
    seen, theirs = [], Claims(claim.parent, pytest.fail)

    def they_take_it_over_and_finish_it():
        status = schedule.status[run]
        if status.iteration and "theirs" not in seen:
            seen.append("theirs")
            claim.unlink()
            assert theirs.take(run.claim)
            for work in folder.parent.glob(".seed_0-*"):
                shutil.rmtree(work)
        if status.kind == "elsewhere" and not folder.exists():
            assert claim.exists()  # our giving up has not removed theirs
            shutil.copytree(finished, folder)
            theirs.release(run.claim)
        seen.append(status.kind)
        assert len(seen) < 200

    schedule.do_all(LocalPool(1), they_take_it_over_and_finish_it)
    assert "elsewhere" in seen and "failed" not in seen and kinds(schedule) == ["done"]
    assert any("another command took over" in line for line in bench.lines) and not bench.left_over()


def test_a_file_in_the_way_fails_what_needs_the_place_and_nothing_else(bench):
    bench.content["budgets"] = ["iterations=50", "iterations=60"]
    (bench.root / "out").mkdir()
    (bench.root / "out" / "iterations-50").write_text("in the way")
    schedule = bench.run()
    assert kinds(schedule) == ["failed", "done"] and not bench.left_over()
    assert any("failed: " in line and "Not a directory" in line for line in bench.lines)
    text = write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()
    assert "Not a directory" in text


def test_a_training_that_cannot_be_put_in_place_is_kept_and_not_repeated(bench, monkeypatch):
    """As on Windows while a console stands in the folder of the former result."""
    bench.content |= {"budgets": ["cpu-seconds=3"], "methods": ["convex"]}
    run = bench.run().runs[0]
    folder = bench.root / "out" / run.folder
    former = (folder / "run.json").read_text()
    (bench.root / "day" / "data.json").write_text("brighter")
    rename = os.rename

    def refuse(source, target):
        if Path(source) == folder:
            raise PermissionError(errno.EACCES, "The process cannot access the file", str(source))
        rename(source, target)

    with monkeypatch.context() as held:
        held.setattr(os, "rename", refuse)
        assert kinds(bench.run()) == ["failed"]
    (kept,) = bench.left_over()
    (line,) = [line for line in bench.lines if "failed: " in line]
    assert "cannot put the result into" in line and f"its training is in {kept}: close" in line
    assert (folder / "run.json").read_text() == former
    bench.calls()
    assert kinds(bench.run()) == ["done"] and bench.calls() == [] and not bench.left_over()
    assert (folder / "run.json").read_text() != former and (folder / "evaluation.json").exists()


def test_a_kept_training_is_removed_once_it_would_be_done_otherwise(bench, monkeypatch):
    refuse = OSError(errno.EACCES, "The process cannot access the file")
    with monkeypatch.context() as held:
        held.setattr(runs, "patiently", lambda move: (_ for _ in ()).throw(refuse))
        assert kinds(bench.run()) == ["failed"]
    assert len(bench.left_over()) == 1
    (bench.root / "day" / "data.json").write_text("brighter")
    bench.calls()
    assert kinds(bench.run()) == ["done"] and len(bench.calls()) == 1 and not bench.left_over()


def test_no_training_is_kept_or_promised_where_nothing_can_be_locked(bench, monkeypatch):
    """The next command looks for none there, for another may be at it: each would leave one more."""
    monkeypatch.setitem(sys.modules, "filelock", None)
    refuse = OSError(errno.EACCES, "The process cannot access the file")
    monkeypatch.setattr(runs, "patiently", lambda move: (_ for _ in ()).throw(refuse))
    assert kinds(bench.run()) == ["failed"] and not bench.left_over()
    (line,) = [line for line in bench.lines if "failed: " in line]
    assert "cannot put the result into" in line and "its training" not in line


@pytest.mark.parametrize("locks", [True, False])
def test_an_interrupted_evaluation_leaves_a_training_where_the_next_command_looks_for_it(
    bench, monkeypatch, locks
):
    if not locks:
        monkeypatch.setitem(sys.modules, "filelock", None)
    bench.content["methods"] = ["hangs_evaluated"]
    schedule = bench.schedule()
    folder = bench.root / "out" / schedule.runs[0].folder

    def interrupt_once_it_is_trained():
        if list(folder.parent.glob(".seed_0-*/run.json")):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        schedule.do_all(LocalPool(1), interrupt_once_it_is_trained)
    assert not fakes_running(bench.root)
    assert len(bench.left_over()) == (1 if locks else 0)


def test_a_result_that_cannot_be_replaced_stays_in_its_place(tmp_path, monkeypatch):
    work, final = tmp_path / ".seed_0-1", tmp_path / "seed_0"
    for folder in (work, final):
        folder.mkdir()
        (folder / "whose").write_text(folder.name)
    rename = os.rename

    def refuse(source, target):
        if Path(source) == work:
            raise PermissionError(errno.EACCES, "The process cannot access the file", str(source))
        rename(source, target)

    with monkeypatch.context() as held:
        held.setattr(os, "rename", refuse)
        with pytest.raises(OutputError, match=r"cannot put the result into .*seed_0: The process"):
            put_in_place(work, final)
    assert sorted(tmp_path.iterdir()) == [work, final]
    assert [(folder / "whose").read_text() for folder in (work, final)] == [work.name, final.name]
    put_in_place(work, final)
    assert sorted(tmp_path.iterdir()) == [final] and (final / "whose").read_text() == work.name


def test_a_damaged_evaluation_is_done_again_alone(bench):
    bench.content["methods"] = ["quick", "other"]
    bench.run()
    bench.calls()
    path = bench.root / "out" / "iterations-50" / "exp3" / "day" / "quick" / "seed_0" / "evaluation.json"
    path.write_text(path.read_text()[:40])
    assert kinds(bench.schedule()) == ["waiting", "done"]
    assert kinds(bench.run()) == ["done"] * 2 and bench.calls() == []
    assert json.loads(path.read_text())["means"]


def test_what_an_evaluation_prints_comes_below_its_training(bench):
    """Also where it fails: why a training went as it did is asked long after."""
    bench.run()
    folder = bench.root / "out" / "iterations-50" / "exp3" / "day" / "quick" / "seed_0"

    def commands():
        lines = (folder / "benchmark.log").read_text().splitlines()
        return [line.split()[2] for line in lines if line.startswith("$ physhdr ")]

    assert commands() == ["train", "evaluate"]
    assert kinds(bench.run(evaluate_again=True)) == ["done"]
    assert commands() == ["train", "evaluate", "evaluate"]
    (folder / "preset").unlink()  # without which the fake program cannot evaluate
    assert kinds(bench.run(evaluate_again=True)) == ["failed"]
    assert commands() == ["train", "evaluate", "evaluate", "evaluate"]
    assert "FileNotFoundError" in (folder / "benchmark.log").read_text()
    assert bench.left_over() == []


def test_no_two_runs_share_a_claim(bench):
    """The names of folders may hold what stands between them in a claim's name."""
    names = ["a", "a_", "a__b", "a__b__c", "_b", "b", "b__c", "c", "_c", "__", "_"]
    bench.content["methods"] = [f"{name} := quick" for name in names]
    bench.content["scenes"] = [f"{name}={bench.root / 'day'}" for name in names]
    runs = bench.schedule().runs
    assert len({run.claim for run in runs}) == len(runs) == len(names) ** 2
    bench.content |= {"methods": ["paper-short"], "scenes": [f"my_room={bench.root / 'day'}"]}
    claim = bench.schedule().runs[0].claim
    assert claim == "iterations-50__exp3__my_room__paper-short__seed_0"


def test_equal_cpu_seconds_are_found_from_the_run_at_equal_iterations(bench):
    bench.content |= {
        "methods": ["convex", "slow"],
        "seeds": [0, 1],
        "budgets": ["iterations=50", "cpu-seconds=3"],
    }
    schedule = bench.run()
    calls = bench.calls()
    counts = {
        m: [int(c.split()[-1]) for c in calls if c.startswith(f"{m} day 1")] for m in ("convex", "slow")
    }
    found = counts["convex"][-1]
    assert fake.cpu_seconds("convex", found) == pytest.approx(3.0, rel=0.05)
    # Seed 1 does not search: one training a budget. Nobody needs a pilot.
    assert sorted(counts["convex"]) == sorted([50, found]) and not any(c.endswith(" 20") for c in calls)
    # 50 iterations of the slow one cost 35 s: four fit, and that is said.
    assert sorted(counts["slow"]) == [4, 50]
    text = write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()
    assert "slow on day, exp3 is so slow that 4 iterations are all that fit" in text
    assert "slow took 93% to 93% of the 3 CPU seconds" in text and "convex took" not in text


def test_without_a_completed_run_a_pilot_comes_first_and_does_not_count(bench):
    bench.content |= {"methods": ["convex"], "budgets": ["cpu-seconds=3"]}
    schedule = bench.run()
    calls = bench.calls()
    assert calls[0] == "convex day 0 20" and kinds(schedule) == ["done"]
    record = schedule.store.record(schedule.runs[0])
    assert record.cpu_seconds == pytest.approx(3.0, rel=0.05)
    assert record.iterations == int(calls[-1].split()[-1])
    folder = bench.root / "out" / schedule.runs[0].folder
    assert not list(folder.glob("trial_*")) and (folder / "evaluation.json").exists()


def verdicts(bench, schedule):
    text = write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()
    return [line for line in text.splitlines() if line.startswith("- LDR-OE: ")]


def set_psnr(bench, schedule, psnr):
    """``psnr(run)`` of every part of every run's evaluation."""
    for run in schedule.runs:
        path = bench.root / "out" / run.folder / "evaluation.json"
        content = json.loads(path.read_text())
        for part in ("LDR-OE", "LDR-NE", "HDR"):
            content["means"][part] = {"psnr": psnr(run)}
        path.write_text(json.dumps(content))


def test_one_run_decides_no_lead(bench):
    bench.content |= {"methods": ["quick", "other"], "seeds": [0]}
    schedule = bench.run(jobs=2)
    set_psnr(bench, schedule, lambda run: 35.0 + (run.method.name == "quick"))
    assert verdicts(bench, schedule) == ["- LDR-OE: one run only, over `other`"]


def test_a_lead_is_told_by_name_with_the_pairs_that_are_missing(bench):
    methods = ["quick", "other", "v := other strength=1", "w := other strength=2"]
    bench.content |= {"methods": methods, "seeds": [0, 1, 2]}
    schedule = bench.run(jobs=4)
    level = {"quick": 35.0, "other": 34.0, "v": 36.0, "w": 35.0}
    set_psnr(
        bench, schedule, lambda run: level[run.method.name] + 0.01 * (run.seed * len(run.method.name) % 3)
    )
    assert verdicts(bench, schedule) == ["- LDR-OE: ahead of `other`; undecided against `w`; behind `v`"]
    gone = next(run for run in schedule.runs if run.method.name == "other" and run.seed == 2)
    (bench.root / "out" / gone.folder / "evaluation.json").unlink()
    (said,) = verdicts(bench, bench.schedule())
    assert said.endswith("; pairs are missing: `other` (2 of 3)")
    bench.content["methods"] = ["quick"]
    assert not verdicts(bench, bench.schedule())  # nothing to compare it with
    bench.content |= {"methods": ["quick", "other"], "margins_of": ["quick", "other"]}
    text = write_report(bench.schedule(), bench.root / "report.md", "physhdr benchmark")[0].read_text()
    assert "`quick`: there is no other method that it could be ahead of." in text


def test_intervals_over_cameras_of_one_room_say_so(bench):
    bench.content |= {"methods": ["quick", "other"]}
    bench.content["scenes"].append(str(bench.root / "night"))

    def reported(**of: str) -> str:
        """With data sets of these built-in scenes, whose evaluations call them alike."""
        for name, scene in of.items():
            info = {"format": "physhdr-dataset", "version": 1, "scene": scene, "generator": {"name": MAKER}}
            (bench.root / name / "dataset.json").write_text(json.dumps(info))
        schedule = bench.run(jobs=4)
        set_psnr(bench, schedule, lambda run: 30.0 + (run.method.name == "other"))
        for run in schedule.runs:
            file = bench.root / "out" / run.folder / "evaluation.json"
            content = json.loads(file.read_text())
            content["conditions"]["scene"] = "garden"
            file.write_text(json.dumps(content))
        return write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()

    said = "2 data sets of one room: the intervals are over these and say nothing about other rooms"
    assert said not in reported() and said not in reported(day="interior", night="bathroom")
    assert f"\n- {said}\n- LDR-OE: " in reported(night="interior")


def test_three_budgets_of_a_kind_are_told_side_by_side(bench):
    bench.content |= {"methods": ["quick", "other"], "seeds": [0, 1]}
    bench.content["budgets"] = ["iterations=20", "iterations=10", "iterations=30"]
    schedule = bench.run(jobs=4)
    set_psnr(bench, schedule, lambda run: run.budget.amount + run.seed + 0.25 * (run.method.name == "other"))
    text = write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()
    lines = text[text.index("## Over iterations") :].splitlines()
    assert lines[4] == "| LDR-OE PSNR | 10 | 20 | 30 |"
    assert lines[6:8] == ["| quick | 10.50 | 20.50 | 30.50 |", "| other | 10.75 | 20.75 | 30.75 |"]
    bench.content["budgets"] = ["iterations=20", "iterations=10"]
    text = write_report(bench.schedule(), bench.root / "report.md", "physhdr benchmark")[0].read_text()
    assert "## Over" not in text


def test_a_mean_of_fewer_runs_than_others_says_of_how_many(bench):
    """One scene of two failed: what is left, the hard one, is no fall of the method."""
    bench.content["budgets"] = ["iterations=10", "iterations=20", "iterations=30"]
    bench.content["scenes"].append(str(bench.root / "night"))
    schedule = bench.run(jobs=4)
    set_psnr(bench, schedule, lambda run: run.budget.amount + 10.0 * (run.scene.name == "day"))
    lost = next(run for run in schedule.runs if run.scene.name == "day" and run.budget.amount == 30)
    shutil.rmtree(bench.root / "out" / lost.folder)
    text = write_report(bench.schedule(), bench.root / "report.md", "physhdr benchmark")[0].read_text()
    lines = text[text.index("## Over iterations") :].splitlines()
    assert lines[6] == "| quick | 15.00 | 25.00 | 30.00 (1 of 2 runs) |"


def test_a_mean_over_scenes_is_over_those_of_all_data_sets(bench):
    """A published one beside scenes of one's own: the gain beside the mean is over both."""
    bench.content |= {"methods": ["quick", "other"], "ladder": [{"name": "up", "steps": ["quick", "other"]}]}
    bench.content["scenes"].append(str(bench.root / "night"))
    schedule = bench.run(jobs=4)
    set_psnr(
        bench, schedule, lambda run: 40.0 - 20.0 * (run.scene.name == "night") + (run.method.name == "other")
    )
    for run in schedule.runs:
        path = bench.root / "out" / run.folder / "evaluation.json"
        content = json.loads(path.read_text())
        content["conditions"]["data_set"] = "HDR-NeRF-Syn" if run.scene.name == "day" else ""
        path.write_text(json.dumps(content))
    text = write_report(schedule, bench.root / "report.md", "physhdr benchmark")[0].read_text()
    steps = text[text.index("**all scenes**") :].splitlines()
    assert steps[4].startswith("| quick | – | 30.00 |") and steps[5].startswith("| other | 2 | 31.00 | +1.00")


def test_a_method_without_gaussians_shows_none(bench):
    """Its training tells the parameters of its networks, and early records hold them."""
    bench.content |= {"methods": ["quick", "hdr-nerf"], "budgets": ["iterations=1234567"]}
    schedule = bench.run()
    assert [schedule.store.record(run).gaussians for run in schedule.runs] == [7, 0]
    path = bench.root / "out" / schedule.runs[1].folder / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"gaussians": 46926}))
    report, table = write_report(schedule, bench.root / "report.md", "physhdr benchmark")
    text = report.read_text()
    assert [row["gaussians"] for row in csv.DictReader(table.open())] == ["7", ""]
    assert "46,926" not in text and "| 7.00 |" in text
    assert "budget 1234567 iterations: `--iterations 1234567`" in text and "e+06" not in text


def test_the_report_tells_margins_and_gains_as_numpy_computes_them(bench):
    bench.content |= {
        "methods": ["quick", "other", "longest_name"],
        "seeds": [0, 1, 2],
        "margins_of": ["longest_name"],
    }
    bench.content |= {"ladder": [{"name": "up", "steps": ["quick", "other", "longest_name"]}]}
    bench.content["scenes"].append(str(bench.root / "night"))
    schedule = bench.run(jobs=4)
    rng = np.random.default_rng(0)
    values = {}
    for run in schedule.runs:  # evaluations whose numbers we know
        psnr = values[run.method.name, run.scene.name, run.seed] = rng.normal(35.0, 1.0, 3)
        path = bench.root / "out" / run.folder / "evaluation.json"
        content = json.loads(path.read_text())
        for part, value in zip(("LDR-OE", "LDR-NE", "HDR"), psnr, strict=True):
            content["means"][part]["psnr"] = value
        path.write_text(json.dumps(content))
    path, table = write_report(schedule, bench.root / "report.md", "physhdr benchmark")
    text = path.read_text()

    assert "\n- all was dark\n- longest_name: it has seen the truth\n" in text

    def differences(method, other):  # [scene, seed, part]
        scenes = [[(scene, seed) for seed in (0, 1, 2)] for scene in ("day", "night")]
        return np.array([[values[(method, *k)] - values[(other, *k)] for k in runs] for runs in scenes])

    def cells(values):  # [scene, seed]
        low, high = ttest_1samp(values.mean(1), 0.0).confidence_interval(0.95)
        spread = math.sqrt(values.var(1, ddof=1).mean())
        return f"{values.mean():+.2f} [{low:+.2f}, {high:+.2f}] | ± {spread:.2f} |"

    d = differences("longest_name", "quick")
    row = next(line for line in text.splitlines() if line.startswith("| quick | 6 |"))
    for k in range(3):
        assert cells(d[:, :, k]) in row
    gain = differences("other", "quick")[:, :, 2]
    step = next(
        line for line in text.splitlines() if line.startswith("| other | 6 |") and line.count("|") > 14
    )
    assert cells(gain) in step
    by_scene = [line for line in text.splitlines() if line.startswith("| other | 3 |")]
    for line, d in zip(by_scene, gain, strict=True):  # a table for each scene
        low, high = ttest_1samp(d, 0.0).confidence_interval(0.95)
        assert f"{d.mean():+.2f} [{low:+.2f}, {high:+.2f}] | ± {d.std(ddof=1):.2f} |" in line
    of_seed = [np.mean([values["other", s, k][2] for s in ("day", "night")]) for k in (0, 1, 2)]
    main = next(line for line in text.splitlines() if line.startswith("| other | "))
    assert f"{np.mean(of_seed):.2f}" in main and f"± {np.std(of_seed, ddof=1):.2f}" in main
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 18 and float(rows[0]["LDR-OE.psnr"]) == values["quick", "day", 0][0]
