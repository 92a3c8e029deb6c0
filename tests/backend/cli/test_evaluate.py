# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr evaluate`` with a method that needs no training: what it writes, and when."""

import json
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
