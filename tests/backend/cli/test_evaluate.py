# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr evaluate`` with a method that needs no training: what it writes, and when."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from physhdr.backend.cli import evaluate as command
from physhdr.backend.cli import main
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.runs.run import Run
from physhdr.backend.scene import read_scene
from physhdr.backend.train.config import TrainConfig
from physhdr.bridge.errors import OutputError


class Grey(Renderer):
    """A collapsed method: grey everywhere, and so is its response."""

    lights = ("ambient",)

    def hdr(self, camera, lighting_level=1.0) -> torch.Tensor:
        return torch.full((3, camera.height, camera.width), 0.5)

    def ldr(self, camera, exposure, lighting_level=1.0) -> torch.Tensor:
        return self.hdr(camera)

    def response_curve(self) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.linspace(-8.0, 5.0, 100), torch.full((100, 3), 0.5)


@pytest.fixture
def opened(tiny_data: Path, monkeypatch):
    """Opens, instead of a trained run, grey ones: ``opened[name]`` changes that of a folder's name."""
    changes: dict[str, dict] = {}

    def open_run(folder: Path, *_) -> Run:
        run = Run(folder, folder.name, TrainConfig(iterations=1000), read_scene(tiny_data), Grey(), 1000)
        return replace(run, **changes.get(folder.name, {}))

    monkeypatch.setattr(command, "open_run", open_run)
    return changes


def written(folder: Path) -> dict:
    return json.loads((folder / "evaluation.json").read_text())


def test_a_collapsed_response_is_told_and_loses_nothing(opened, tmp_path: Path, capsys) -> None:
    assert main(["evaluate", str(tmp_path / "a")]) == 0
    assert "exposure scale not measurable" in " ".join(capsys.readouterr().out.split())
    content = written(tmp_path / "a")
    assert content["response"]["scale"] is None and content["means"]["LDR-OE"]["psnr"] > 0


def test_the_files_are_written_before_anything_is_printed(opened, tmp_path: Path, monkeypatch) -> None:
    def fail(_):
        raise RuntimeError("the terminal")

    monkeypatch.setattr(command, "to_terminal", fail)
    with pytest.raises(RuntimeError, match="the terminal"):
        main(["evaluate", str(tmp_path / "a")])
    assert written(tmp_path / "a")["means"]["LDR-OE"]


def test_the_evaluation_says_what_the_training_was(opened, tmp_path: Path) -> None:
    config = TrainConfig(iterations=1000, training_exposures=(0, 1, 2, 3, 4))
    opened["a"] = {"config": config, "iteration": 500}
    assert main(["evaluate", str(tmp_path / "a")]) == 0
    content = written(tmp_path / "a")
    assert any("training saw index 1 and 3" in message for message in content["messages"])
    conditions = content["conditions"]
    assert (conditions["iteration"], conditions["iterations"]) == (500, 1000)
    assert conditions["training_exposures"] == [0, 1, 2, 3, 4]


@pytest.mark.long
def test_against_a_run_at_another_resolution_nothing_is_ranked(
    opened, tiny_data: Path, tmp_path: Path
) -> None:
    opened["b"] = {"scene": read_scene(tiny_data, 2.0), "iteration": 500}
    assert main(["evaluate", str(tmp_path / "b")]) == 0
    assert main(["evaluate", str(tmp_path / "a"), "--against", str(tmp_path / "b")]) == 0
    text = (tmp_path / "a" / "methods.md").read_text()
    assert (
        "NOT COMPARABLE" in text and "500 of 1000 iterations" in text and "**" not in text.split("\n", 2)[2]
    )


class Dark:
    """What a training has learned: a lens that lets ``share`` of the light through."""

    def __init__(self, share: float) -> None:
        self.share = share

    def falloff(self, camera) -> torch.Tensor:
        return torch.full((1, 1, 1), self.share)


class Photographing(Grey):
    def photographed(self, camera, exposures, effects, lighting_level=1.0) -> list[torch.Tensor]:
        return [self.hdr(camera) * effect for effect in effects]


@pytest.mark.long
def test_the_sheets_compare_as_the_table_does(opened, tiny_data, tmp_path: Path, monkeypatch) -> None:
    every = [(view, k) for view in read_scene(tiny_data).test for k in range(len(view.exposures))]
    halves = [view.values(k)[:, : view.camera.width // 2].mean() for view, k in every]
    share = 2.0 * sum(halves) / len(halves)  # of grey, 0.5: the nearest to the pictures' left halves
    told = []
    for name in ("comparison_sheet", "method_sheet"):
        draw = getattr(command, name)
        monkeypatch.setattr(command, name, lambda *a, draw=draw, **b: told.append(b) or draw(*a, **b))
    opened["a"] = {"method": Photographing(), "lenses": Dark(share)}
    opened["b"] = {"method": Photographing(), "lenses": Dark(100.0)}
    assert main(["evaluate", str(tmp_path / "b")]) == 0
    assert main(["evaluate", str(tmp_path / "a"), "--against", str(tmp_path / "b")]) == 0
    of_b, of_a, both = told
    assert of_b["falloff"] is None and of_a["falloff"](None).item() == pytest.approx(share)
    assert both["falloffs"]["a"](None).item() == pytest.approx(share) and both["falloffs"]["b"] is None


@pytest.mark.long
def test_against_a_run_it_is_not_found_again_what_its_file_says(opened, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(
        command, "falloff_there", lambda renderer, views, falloff: searched.append(views) or True
    )
    opened["a"] = opened["b"] = {"method": Photographing(), "lenses": Dark(0.5)}
    for name in ("a", "b"):
        assert main(["evaluate", str(tmp_path / name)]) == 0
    for said, searches in ((False, 0), (None, 1)):
        searched: list = []
        content = written(tmp_path / "b")
        content["conditions"]["vignetting"] = said  # None: of a version that did not say so
        (tmp_path / "b" / "evaluation.json").write_text(json.dumps(content))
        assert main(["evaluate", str(tmp_path / "a"), "--against", str(tmp_path / "b")]) == 0
        assert len(searched) == searches


# ---- pictures that another program made ------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(tiny_data: Path, tmp_path_factory) -> Path:
    """A short training and, in ``theirs/`` beside it, its pictures of the test views."""
    run = tmp_path_factory.mktemp("trained") / "run"
    words = ["--iterations", "30", "--set", "sh_degree_every=5"]
    assert main(["train", str(tiny_data), "--out", str(run), *words]) == 0
    assert main(["render", str(run), "--split", "test", "--out", str(run.parent / "theirs")]) == 0
    assert main(["evaluate", str(run)]) == 0
    return run


@pytest.mark.long
def test_a_runs_own_pictures_are_measured_as_the_run_is(trained, tiny_data, tmp_path, capsys) -> None:
    theirs, out = trained.parent / "theirs", tmp_path / "out"
    words = ["--pictures", str(theirs), "--data", str(tiny_data), "--exposure-mode", "exp3"]
    assert main(["evaluate", *words, "--out", str(out), "--against", str(trained)]) == 0
    ours, found = written(trained), written(out)
    for part in ("LDR-OE", "LDR-NE", "HDR", "HDR, scale aligned"):
        assert found["means"][part] == ours["means"][part], part
    assert found["relit_means"] == ours["relit_means"] and found["scale_ratio"] == ours["scale_ratio"]
    of_training = ("iteration", "iterations", "training_exposures")  # which nobody knows of pictures
    told = {key: value for key, value in ours["conditions"].items() if key not in of_training}
    assert told.items() <= found["conditions"].items()
    assert all(found["conditions"][key] is None for key in of_training)
    assert not (theirs / "evaluation.json").exists() and (out / "comparison.png").exists()
    table = (out / "methods.md").read_text()
    assert "| theirs |" in table and "| default |" in table and "NOT COMPARABLE" not in table
    assert (out / "methods.png").exists()


def test_their_results_are_written_beside_the_pictures(trained, tiny_data, tmp_path, capsys) -> None:
    theirs = shutil.copytree(trained.parent / "theirs", tmp_path / "theirs")
    shutil.rmtree(theirs / "test_hdr")
    shutil.rmtree(theirs / "relit")
    assert main(["evaluate", "--pictures", str(theirs), "--data", str(tiny_data), "--json"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last == {"result": {"folder": str(theirs), "split": "test"}}
    assert (
        written(theirs)["means"]["HDR"] is None
        and written(theirs)["conditions"]["exposure_mode"] == "unknown"
    )
    # What an evaluation left there is none of the pictures: it can be done again, beside others, too.
    words = ["evaluate", "--pictures", str(theirs), "--data", str(tiny_data), "--exposure-mode", "exp3"]
    assert main([*words, "--against", str(trained)]) == 0
    assert "| theirs |" in (theirs / "methods.md").read_text()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "the folder of a run or --pictures"),
        (["RUN", "--pictures", "THEIRS"], "the folder of a run or --pictures"),
        (["--pictures", "THEIRS"], "--pictures needs the data set"),
        (["RUN", "--downscale", "2"], "--downscale only works with --pictures"),
        (["RUN", "--exposure-mode", "exp1"], "--exposure-mode only works with --pictures"),
        (["--pictures", "DATA", "--data", "DATA"], "is the data set itself"),
        (["--pictures", "THEIRS", "--data", "DATA", "--split", "val"], "has no validation views"),
        (["--pictures", "NOWHERE", "--data", "DATA"], "there is no folder of pictures"),
        (["--pictures", "THEIRS", "--data", "DATA", "--downscale", "2"], "r_0_0.png is 32×32, .* at 16×16"),
    ],
)
def test_what_does_not_go_together(trained, tiny_data, words, said, capsys) -> None:
    places = {"RUN": trained, "THEIRS": trained.parent / "theirs", "DATA": tiny_data, "NOWHERE": "nowhere"}
    assert main(["evaluate", *(str(places.get(word, word)) for word in words)]) == 1
    assert re.search(said, capsys.readouterr().err)


def test_all_views_are_rendered_as_they_are_evaluated(trained, tiny_data, tmp_path, capsys) -> None:
    render = ["render", str(trained), "--split", "test", "--out"]
    assert main([*render, str(tmp_path / "a"), "--view", "test/0"]) == 1
    assert "--view has no effect on all views of a --split" in capsys.readouterr().err
    assert main([*render[:2], "--split", "val", "--out", str(tmp_path / "a")]) == 1
    assert "has no validation views" in capsys.readouterr().err
    assert main([*render, str(tiny_data)]) == 1
    assert "is the data set" in capsys.readouterr().err and not (tmp_path / "a").exists()


def test_on_a_full_disk_the_evaluation_that_was_there_stays_whole(opened, tmp_path, monkeypatch, capsys):
    """New numbers beside old pictures would be taken for one evaluation."""
    out = tmp_path / "results"
    call = ["evaluate", str(tmp_path / "run"), "--out", str(out)]
    assert main(call) == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    opened["run"] = {"iteration": 7}

    def full(path, _):
        raise OutputError(f"cannot write {path}: No space left on device", "Free some space.")

    monkeypatch.setattr(command, "write_png", full)
    assert main(call) == 1
    assert "No space left" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.iterdir()} == before
