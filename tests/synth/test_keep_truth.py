# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool that keeps truth makes what make_scene.py makes, in as many goes as one likes."""

import importlib.util
import json
import shutil
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.synth import dataset, exr, stored_truth, truth
from physhdr.synth.errors import ConflictError

ROOT = Path(__file__).parents[2]
PASS = 8


@pytest.fixture
def tool(monkeypatch, tmp_path):
    """lab/tools/keep_truth.py, for tiny pictures of the ball."""
    spec = importlib.util.spec_from_file_location("keep_truth", ROOT / "lab" / "tools" / "keep_truth.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setattr(truth, "PASS", PASS)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PASS", PASS)
    monkeypatch.setattr(module, "DATA", tmp_path / "kept")
    monkeypatch.setattr(module, "SIZE", (32, 24))
    monkeypatch.setattr(module, "VIEWS", 5)
    monkeypatch.setattr(module, "VALIDATION_VIEWS", {"ball": 1})
    monkeypatch.setattr(module, "DENOISE", False)
    return module


def test_truth_in_two_goes_is_that_of_one_data_set(tool, tmp_path, small):
    tool.work_on("ball", [PASS], False, tmp_path / "work")
    told = json.loads((tmp_path / "kept/ball" / stored_truth.TRUTH_FILE).read_text())
    assert told["samples"] == PASS and "reference_floor" not in told and "devices" not in told
    shutil.rmtree(tmp_path / "work")  # another machine: only what is kept is there
    tool.work_on("ball", [PASS, PASS], True, tmp_path / "work")
    told = json.loads((tmp_path / "kept/ball" / stored_truth.TRUTH_FILE).read_text())
    assert told["samples"] == 2 * PASS and told["reference_floor"]["samples"] == 4 * PASS
    names = {path.name for path in (tmp_path / "kept/ball").iterdir()}
    assert names == {"truth.json", "test_000.exr", "test_001.exr", "val_000.exr"}

    at_once = replace(small, validation_views=1, lit_views=0, relit_views=0, test_samples=2 * PASS)
    dataset.make(tmp_path / "data", replace(at_once, reference_samples=0))
    for split, k in (("test", 0), ("test", 1), ("val", 0)):
        rendered = exr.read(tmp_path / f"data/{split}_hdr/hdr_{k:03d}.exr")
        radiance, facts = stored_truth.read(tmp_path / "kept/ball" / stored_truth.file_name(split, k))
        # Rounded once after the first go, and once after the second.
        np.testing.assert_allclose(radiance, rendered, rtol=2.0**-8, atol=1e-5)
        assert facts["passes"] == [PASS, PASS] and facts["samples"] == 2 * PASS
    floor = json.loads((tmp_path / "data/dataset.json").read_text())["noise_floor"]
    assert told["noise_floor"]["view"] == floor["view"] == 1

    taking = replace(at_once, test_samples=None, test_truth=str(tmp_path / "kept/ball"))
    dataset.make(tmp_path / "taken", taking)
    taken = json.loads((tmp_path / "taken/dataset.json").read_text())
    assert taken["noise_floor"] == {**told["noise_floor"], "exposures": told["exposures"]}
    assert taken["test_samples"] == 2 * PASS


def test_nothing_is_rendered_twice(tool, tmp_path, capsys):
    tool.work_on("ball", [PASS], False, tmp_path / "work")
    capsys.readouterr()
    before = {path: path.read_bytes() for path in (tmp_path / "kept").rglob("*.exr")}
    tool.work_on("ball", [PASS], False, tmp_path / "work")
    assert "CPU s" not in capsys.readouterr().out
    assert before == {path: path.read_bytes() for path in (tmp_path / "kept").rglob("*.exr")}


def test_what_is_kept_catches_up_with_the_work_folder(tool, tmp_path):
    """As a process leaves it that is killed between the two, or a checkout of an older state."""
    file = tmp_path / "kept/ball/test_000.exr"
    tool.work_on("ball", [PASS], False, tmp_path / "work")
    first = file.read_bytes()
    tool.work_on("ball", [PASS, PASS], False, tmp_path / "work")
    second = file.read_bytes()
    assert first != second
    file.write_bytes(first)
    tool.work_on("ball", [PASS, PASS], False, tmp_path / "work")
    assert file.read_bytes() == second
    file.unlink()
    tool.work_on("ball", [PASS, PASS], False, tmp_path / "work")
    assert file.read_bytes() == second


def test_the_two_floors_are_those_of_pictures_made_by_hand(tool, tmp_path):
    """A second truth and a reference that are the first times a factor: the floors are that factor's."""
    tool.work_on("ball", [PASS], True, tmp_path / "work")
    work = tmp_path / "work/ball"
    first, facts = stored_truth.read(work / "test_001.exr")
    text = {"physhdr": json.dumps(facts)}
    (work / "again.exr").write_bytes(exr.encode_rgb(first * 1.1, text))
    many = {"physhdr": json.dumps({**facts, "passes": [PASS] * 8})}
    for k in (0, 1):
        (work / f"reference_{k}.exr").write_bytes(exr.encode_rgb(first * (0.8 + 0.1 * k), many))
    tool.work_on("ball", [PASS], True, tmp_path / "work")
    told = json.loads((tmp_path / "kept/ball" / stored_truth.TRUTH_FILE).read_text())
    at = told["exposures"].index(2.0)
    pictures = (first, first * 1.1, first * 0.8, first * 0.9)
    best, again, half, other = ((2 * x / (1 + 2 * x)) ** (1 / 2.2) for x in pictures)
    for floor, errors in (
        ("noise_floor", (best - again) ** 2),
        ("reference_floor", (best - half) * (best - other)),
    ):
        assert told[floor]["psnr"][at] == pytest.approx(-10 * np.log10(errors.mean()), abs=0.05)


def test_passes_weigh_as_much_as_they_have_samples(tool, tmp_path):
    """The mean of three passes, against these passes rendered one by one."""
    tool.work_on("ball", [8, 24, 16], False, tmp_path / "work")
    mean, facts = stored_truth.read(tmp_path / "work/ball/test_000.exr")
    pictures = []
    with (
        tool.built("ball") as stage,
        tool.settings.applied(stage.scene, tool.settings.ground_truth((32, 24), 8, threads=1)),
        tool.renderer(stage, False) as camera,
    ):
        for k, samples in enumerate(facts["passes"]):
            seed = truth.pass_seed(tool.view_seed(0, "test_000"), k)
            pose = np.array(facts["camera_to_world"])
            done = truth.TruthRenderer(camera, samples).once(samples, pose, seed, tmp_path / "scratch.exr")
            pictures.append(samples * done.radiance({}).astype(np.float64))
    np.testing.assert_allclose(mean, sum(pictures) / 48, rtol=1e-5, atol=1e-6)
    with pytest.raises(ConflictError, match=r"has the passes \[8, 24, 16\]"):
        tool.work_on("ball", [8, 24, 8, 8], False, tmp_path / "work")


def test_what_a_gpu_rendered_is_told(tool, tmp_path, monkeypatch):
    monkeypatch.setattr(tool.device, "chosen", lambda _: nullcontext())  # Cycles then takes the CPU
    tool.work_on("ball", [PASS], False, tmp_path / "work", "GPU")
    tool.work_on("ball", [PASS, PASS], False, tmp_path / "work")
    assert json.loads((tmp_path / "kept/ball" / stored_truth.TRUTH_FILE).read_text())["devices"] == [
        "CPU",
        "GPU",
    ]
    assert stored_truth.read(tmp_path / "kept/ball/test_000.exr")[1]["devices"] == ["CPU", "GPU"]


def test_benchmark_data_ask_for_the_validation_views_that_are_kept():
    wanted = []
    for name in ("keep_truth", "benchmark_data"):
        spec = importlib.util.spec_from_file_location(name, ROOT / "lab" / "tools" / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        wanted.append(module.VALIDATION_VIEWS)
    assert wanted[0] == wanted[1]


@pytest.mark.parametrize("scene", sorted(path.name for path in (ROOT / "lab" / "data").glob("*/")))
def test_what_is_kept_has_the_passes_that_it_says(scene):
    """Of every view, in its own header: once views of a second pass were told of that had not come along."""
    folder = ROOT / "lab" / "data" / scene
    told = json.loads((folder / stored_truth.TRUTH_FILE).read_text())
    facts = {path.name: stored_truth.read(path)[1] for path in sorted(folder.glob("*.exr"))}
    assert len(facts) == 17 + told["validation_views"]
    assert min((each["passes"] for each in facts.values()), key=sum) == told["passes"]
    assert told["samples"] == sum(told["passes"])
    assert told["cpu_seconds"] == pytest.approx(sum(each["cpu_seconds"] for each in facts.values()), abs=1.0)
