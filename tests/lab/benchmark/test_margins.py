# SPDX-License-Identifier: GPL-3.0-or-later
"""Paired differences against SciPy's own test, and what may be called ahead."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from physhdr.backend.evaluate.comparison import ComparedRun
from physhdr.lab.benchmark.margins import margin

KEY = "LDR-OE.psnr"


def entries(method, values, part="LDR-OE", name="psnr"):
    """One for each (scene, seed) of ``values`` ``[scenes, seeds]``; NaN: not there."""
    return [
        ComparedRun(method, f"scene {i}", "exp3", k, {"means": {part: {name: float(value)}}})
        for i, scene in enumerate(np.atleast_2d(values))
        for k, value in enumerate(scene)
        if np.isfinite(value)
    ]


def test_the_interval_is_of_students_test_over_scenes():
    rng = np.random.default_rng(3)
    theirs = rng.normal(35.0, 2.0, (4, 3))
    difference = np.array([0.3, 0.5, 0.2, 0.4])[:, None] + rng.normal(0.0, 0.05, (4, 3))
    found = margin([*entries("a", theirs + difference), *entries("b", theirs)], "a", "b", KEY)
    test = ttest_1samp(difference.mean(1), 0.0)
    assert found.mean == pytest.approx(difference.mean())
    assert found.interval == pytest.approx(tuple(test.confidence_interval(0.95)))
    assert found.spread == pytest.approx(np.sqrt(difference.var(1, ddof=1).mean()))
    assert (found.pairs, found.scenes, found.standing) == (12, 4, "ahead")
    assert (test.pvalue < 0.05) == (found.standing == "ahead")
    back = margin([*entries("a", theirs + difference), *entries("b", theirs)], "b", "a", KEY)
    assert back.standing == "behind" and back.mean == pytest.approx(-found.mean)


def test_scenes_that_disagree_are_told_apart_by_no_number_of_seeds():
    """A hundred seeds make each scene's difference certain, and say nothing of the next scene."""
    rng = np.random.default_rng(4)
    theirs = rng.normal(35.0, 1.0, (4, 100))
    difference = np.array([1.0, -0.6, 0.8, -0.2])[:, None] + rng.normal(0.0, 0.01, (4, 100))
    found = margin([*entries("a", theirs + difference), *entries("b", theirs)], "a", "b", KEY)
    assert ttest_1samp(difference.ravel(), 0.0).pvalue < 1e-5  # as if they were 400 scenes
    assert found.standing == "undecided"


def test_cameras_in_one_room_are_no_further_rooms():
    """Six data sets of two rooms that disagree: as six they would be ahead."""
    difference = np.array([1.1, 1.0, 1.2, 0.9, 0.1, 0.2])
    theirs = np.full((6, 1), 35.0)
    runs = [*entries("a", theirs + difference[:, None]), *entries("b", theirs)]
    runs = [replace(run, shows="dog" if run.scene < "scene 4" else "sofa") for run in runs]
    assert ttest_1samp(difference, 0.0).pvalue < 0.05
    rooms = np.array([difference[:4].mean(), difference[4:].mean()])
    found = margin(runs, "a", "b", KEY)
    assert found.mean == pytest.approx(rooms.mean()) and (found.scenes, found.rooms) == (6, 2)
    assert found.interval == pytest.approx(tuple(ttest_1samp(rooms, 0.0).confidence_interval(0.95)))
    assert found.standing == "undecided"
    dog = margin([run for run in runs if run.room == "dog"], "a", "b", KEY)
    of_cameras = ttest_1samp(difference[:4], 0.0).confidence_interval(0.95)
    assert dog.interval == pytest.approx(tuple(of_cameras)) and (dog.scenes, dog.rooms) == (4, 1)


def test_rooms_whose_folders_are_called_alike_are_several():
    """``dataset.json`` or not, a capture is often in a folder ``data``: the plan has names for them."""
    difference = np.array([0.9, 0.1, -0.6])
    runs = [*entries("a", 30.0 + difference[:, None]), *entries("b", np.full((3, 1), 30.0))]
    for run in runs:
        run.evaluation["conditions"] = {"scene": "data"}
    found = margin(runs, "a", "b", KEY)
    assert found.interval == pytest.approx(tuple(ttest_1samp(difference, 0.0).confidence_interval(0.95)))
    assert (found.scenes, found.rooms) == (3, 3)
    for run in runs:  # of a published benchmark, in two layouts: one room by its name
        layout = run.scene in ("scene 0", "scene 1")
        name = "Desk" if run.scene == "scene 0" else "desk"
        run.evaluation["conditions"] = {"scene": name, "data_set": "HDR-NeRF-Syn" if layout else "Plenoxels"}
    found = margin(runs, "a", "b", KEY)
    assert (found.scenes, found.rooms) == (3, 2) and found.mean == pytest.approx((0.5 - 0.6) / 2)


def test_of_one_scene_the_seeds_decide_and_of_one_run_nothing():
    three = np.array([[0.21, 0.25, 0.19]])
    theirs = np.full((1, 3), 30.0)
    found = margin([*entries("a", theirs + three), *entries("b", theirs)], "a", "b", KEY)
    assert found.interval == pytest.approx(tuple(ttest_1samp(three[0], 0.0).confidence_interval(0.95)))
    assert found.standing == "ahead"
    one = margin([*entries("a", theirs[:, :1] + 5.0), *entries("b", theirs[:, :1])], "a", "b", KEY)
    assert (one.interval, one.spread, one.standing) == (None, None, "one run")
    assert margin(entries("a", theirs), "a", "b", KEY) is None


def test_only_runs_that_both_have_are_paired_and_each_scene_counts_once():
    ours = np.array([[31.0, 33.0, 35.0], [40.0, np.nan, np.nan]])
    theirs = np.array([[30.0, 30.0, np.nan], [39.5, 39.0, 39.0]])
    found = margin([*entries("a", ours), *entries("b", theirs)], "a", "b", KEY)
    assert found.pairs == 3 and found.mean == pytest.approx(((1.0 + 3.0) / 2 + 0.5) / 2)


def test_of_lpips_less_is_ahead():
    theirs = np.full((4, 1), 0.05)
    ours = theirs - np.array([[0.01], [0.011], [0.009], [0.01]])
    runs = [*entries("a", ours, name="lpips"), *entries("b", theirs, name="lpips")]
    found = margin(runs, "a", "b", "LDR-OE.lpips")
    assert found.mean < 0.0 and found.standing == "ahead"
