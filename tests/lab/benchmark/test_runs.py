# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of an earlier PhysHDR stand for those of today where only settings came since."""

import json
import shutil

import pytest

from physhdr.lab.benchmark.plan import make_plan
from physhdr.lab.benchmark.runs import (
    Record,
    Search,
    Store,
    data_fingerprint,
    fingerprint,
    runs_of,
    write_json,
)
from physhdr.lab.command import configuration, configurations

#: Settings that the earlier program had not.
SINCE = {"schedule_for": 0, "far_shell": "auto"}


@pytest.fixture
def store(tiny_data, tmp_path):
    """Of two seeds at equal seconds; seed 0 is done by the earlier program, with its search."""
    content = {
        "methods": ["default"],
        "scenes": [str(tiny_data)],
        "budgets": ["cpu-seconds=3"],
        "seeds": [0, 1],
    }
    plan = make_plan(content, tmp_path)
    out = tmp_path / "out"
    configs = configurations(plan, {"default": configuration(plan, "default")}, out)
    data = {scene.name: data_fingerprint(scene.data) for scene in plan.scenes}
    store = Store(out, plan, configs, data)
    run = runs_of(plan)[0]
    (whole,) = configs.values()
    earlier = {key: value for key, value in whole.items() if key not in SINCE}
    shared = {
        key: value
        for key, value in earlier.items()
        if key not in ("iterations", "seed", "exposure_mode", "points_file")
    }
    training = fingerprint([shared, data[run.scene.name]])
    costs = {"cpu_seconds": 3.0, "seconds": 3.0, "gaussians": 60, "peak_memory": None}
    where = {"threads": 1, "device": "auto", "training": training}
    folder = store.out / run.folder
    folder.mkdir(parents=True)
    own = {"iterations": 90, "seed": 0, "exposure_mode": "exp3"}
    (folder / "config.json").write_text(json.dumps({"config": earlier | own}))
    write_json(folder / "run.json", Record(iterations=90, evaluation="", **costs, **where))
    write_json(store.out / run.group / "search.json", Search(iterations=90, measurements=[], **where))
    return store


def test_settings_that_came_since_leave_runs_done(store):
    first, second = runs_of(store.plan)
    assert store.training_fingerprint(first) != store.record(first).training
    assert store.is_trained(first) and store.changes(first) == []
    assert store.iterations(first) == store.iterations(second) == 90  # the search need not be repeated


@pytest.mark.parametrize("name", [*SINCE, "initial_opacity"])
def test_a_setting_with_another_value_does_not(store, name):
    first, second = runs_of(store.plan)
    store.configs["default", first.scene.name][name] = {
        "schedule_for": 2500,
        "far_shell": "on",
        "initial_opacity": 0.1,
    }[name]
    assert not store.is_trained(first) and store.iterations(second) is None
    (said,) = store.changes(first)
    assert name in said


def test_nor_other_data(store):
    first, second = runs_of(store.plan)
    store.data[first.scene.name] = "other"
    assert not store.is_trained(first) and store.iterations(second) is None


#: Of a data set: folders and files whose names sort otherwise as parts than as text, and what nobody reads.
FILES = (
    *("transforms_train.json", "images/b.png", "images/a/0.png", "images.txt", "train/r_0.png"),
    *("train/more/r_1.png", "points3d.ply", "passes/x.exr", ".hidden/y", "images/.z"),
)


def data_set(root):
    for name in FILES:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    return root


def test_a_fingerprint_stays_that_of_the_runs_there_are(tmp_path):
    root = data_set(tmp_path)
    assert data_fingerprint(root) == "63295767af2afdc4"  # as written before links were followed
    assert data_fingerprint(root, "tune") == "3b53caa1906f0529"


@pytest.mark.parametrize("kind", ["report", "tune"])
def test_what_lies_behind_a_linked_folder_counts(kind, tmp_path):
    plain, linked = data_set(tmp_path / "plain"), tmp_path / "linked"
    shutil.copytree(plain, linked)
    for name in ("images/a", "images", "train/more", "train"):  # each folder is one of another disk
        (linked / name).rename(tmp_path / name.replace("/", "_"))
        (linked / name).symlink_to(tmp_path / name.replace("/", "_"), target_is_directory=True)
    known = data_fingerprint(linked, kind)
    assert known == data_fingerprint(plain, kind)
    (tmp_path / "train_more" / "r_1.png").write_bytes(b"taken anew")
    assert data_fingerprint(linked, kind) != known


def test_a_data_set_of_linked_folders_alone_has_files(tmp_path):
    (tmp_path / "data").mkdir()
    for name in ("images", "train"):
        (tmp_path / "data" / name).symlink_to(data_set(tmp_path / "plain") / name, target_is_directory=True)
    assert len(data_fingerprint(tmp_path / "data")) == 16


def test_links_in_a_circle_end(tmp_path):
    root, other, plain = data_set(tmp_path / "data"), tmp_path / "other", data_set(tmp_path / "plain")
    known = data_fingerprint(root)
    (root / "images" / "loop").symlink_to(root / "images", target_is_directory=True)
    (root / "images" / "up").symlink_to(tmp_path, target_is_directory=True)
    assert data_fingerprint(root) == known
    other.mkdir()
    (other / "file").write_bytes(b"1")
    (other / "back").symlink_to(root, target_is_directory=True)
    (root / "over").symlink_to(other, target_is_directory=True)  # over/file counts, over/back does not
    (plain / "over").mkdir()
    (plain / "over" / "file").write_bytes(b"1")
    assert data_fingerprint(root) == data_fingerprint(plain)
