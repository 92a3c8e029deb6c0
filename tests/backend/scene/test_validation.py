# SPDX-License-Identifier: GPL-3.0-or-later
"""Validation views: read from our layout, never trained from, watched and evaluated instead of test views."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.response import check_response, learned_response, true_response
from physhdr.backend.evaluate.sheets import comparison_sheet
from physhdr.backend.runs.monitor import view_monitor
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import run
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileMissingError
from physhdr.bridge.run_folder import CHECKPOINT_FILE


@pytest.fixture
def with_validation(small: ModuleType, data_set: Path) -> Path:
    """The small data set with validation views at poses 5 and 6."""
    small.write_split(data_set, "val", {5: 1.0, 6: 1.0}, dotted_keys=True)
    return data_set


def remove_test(root: Path) -> None:
    for name in ("test", "test_hdr", "relit"):
        shutil.rmtree(root / name)
    for name in ("transforms_test.json", "exposure_test.json"):
        (root / name).unlink()


# ---- reading -----------------------------------------------------------------------------------------------


def test_the_reader_knows_validation_views(small: ModuleType, with_validation: Path) -> None:
    scene = read_scene(with_validation)
    assert [view.name for view in scene.validation] == ["val/r_5", "val/r_6"]
    assert (len(scene.train), len(scene.test), len(scene.lit)) == (3, 2, 2)
    view = scene.find("val", 6)
    expected = small.to_8_bit(small.response(small.radiance(6) * view.exposures[3]))
    assert (view.image(3) == expected).all() and view.camera.position[0] == 6.0
    assert list(scene.splits) == ["train", "test", "lit", "val", "lit_test"] and not scene.lit_test
    with pytest.raises(BadValueError, match="no pose 1 in split 'val'"):
        scene.find("val", 1)


def test_half_a_validation_split_is_an_error_in_our_data_alone(small, with_validation: Path) -> None:
    (with_validation / "exposure_val.json").unlink()
    with pytest.raises(FileMissingError, match=r"exposure_val\.json is missing"):
        read_scene(with_validation)
    (with_validation / "dataset.json").unlink()  # NeRF's own data have such a file, without exposures
    assert read_scene(with_validation).validation == []


def test_no_view_is_of_pictures_elsewhere(with_validation: Path) -> None:
    """Not of those of the test either: a plan that tunes is shown links, and ``val/..`` leads out of them."""
    for name in ("transforms_val.json", "exposure_val.json"):
        path = with_validation / name
        path.write_text(path.read_text().replace("val/r_5", "val/../test/r_1"))
    with pytest.raises(
        BadValueError, match=r"transforms_val\.json: the file 'val/\.\./test/r_1_0\.png'"
    ) as caught:
        read_scene(with_validation)
    assert "without '..'" in caught.value.hint


@pytest.mark.parametrize("write", ["write_syn", "write_real", "write_gausshdr", "write_nerfstudio"])
def test_other_layouts_have_none(layouts: ModuleType, tmp_path: Path, write: str) -> None:
    root = getattr(layouts, write)(tmp_path / "data")
    scene = read_scene(tmp_path / "data" if root is None else root)
    assert scene.validation == [] and scene.splits["val"] == [] and scene.train


# ---- training ----------------------------------------------------------------------------------------------


def trained(data: Path, out: Path) -> dict[str, torch.Tensor]:
    state = begin(read_scene(data), replace(PRESETS["default"], iterations=20))
    for _ in run(state, out, monitor=view_monitor(state.plan.seen.scene)):
        pass
    return load_checkpoint(out / CHECKPOINT_FILE)[0]


def test_no_training_sees_them(tiny_data: Path, validation_data: Path, tmp_path: Path) -> None:
    """The same weights, stereo's points included, without them, with them, and with others in their place."""
    spoiled = tmp_path / "spoiled"
    shutil.copytree(validation_data, spoiled)
    rng = np.random.default_rng(1)
    pictures = sorted(spoiled.glob("val/*.png"))
    assert len(pictures) == 3 * 5
    for path in pictures:
        Image.fromarray(rng.integers(0, 256, (32, 32, 4), np.uint8)).save(path)
    without, given, others = (
        trained(data, tmp_path / name)
        for name, data in (("without", tiny_data), ("given", validation_data), ("others", spoiled))
    )
    assert without.keys() == given.keys() == others.keys()
    for name, tensor in without.items():
        assert torch.equal(tensor, given[name]) and torch.equal(tensor, others[name]), name


class Flat(Renderer):
    """Half grey, whatever is asked; its response is a straight line."""

    lights = ("ambient",)

    def hdr(self, camera, lighting_level=1.0) -> torch.Tensor:
        return torch.full((3, camera.height, camera.width), 0.5)

    def ldr(self, camera, exposure, lighting_level=1.0) -> torch.Tensor:
        return self.hdr(camera)


def test_progress_is_watched_on_a_validation_view(with_validation: Path) -> None:
    scene = read_scene(with_validation)
    remove_test(with_validation)
    measure = view_monitor(scene)
    assert measure is not None
    told = measure(Flat())
    view = scene.find("val", 6)
    error = view.image(2).astype(np.float64) / 255.0 - 0.5
    assert told["PSNR"] == pytest.approx(-10 * np.log10(np.mean(error**2)), abs=1e-4) and "HDR scale" in told


def test_what_is_no_number_is_not_watched(with_validation: Path, tmp_path: Path) -> None:
    """A view that is masked altogether has neither a PSNR nor a scale."""
    scene = read_scene(with_validation)
    Image.fromarray(np.zeros(scene.validation[0].image(0).shape[:2], np.uint8)).save(tmp_path / "mask.png")
    hidden = [
        replace(view, sources=tuple(replace(each, mask_path=tmp_path / "mask.png") for each in view.sources))
        for view in scene.validation
    ]
    measure = view_monitor(replace(scene, validation=hidden))
    assert measure is not None and measure(Flat()) == {}


def test_a_view_that_cannot_be_watched_is_told_once_and_ends_no_training(with_validation: Path) -> None:
    scene, said = replace(read_scene(with_validation), validation=[]), []
    remove_test(with_validation)
    measure = view_monitor(scene, said.append)
    assert measure is not None
    assert [measure(Flat()) for _ in range(3)] == [{}, {}, {}]
    (line,) = said
    assert "no longer measuring" in line and "view test/r_3 " in line and "is missing" in line


# ---- evaluating --------------------------------------------------------------------------------------------


class Oracle(Flat):
    """Renders the small data set's own radiance, and knows its response."""

    def __init__(self, small: ModuleType) -> None:
        self.small = small

    def hdr(self, camera, lighting_level=1.0) -> torch.Tensor:
        return torch.from_numpy(self.small.radiance(round(float(camera.position[0])))).permute(2, 0, 1)

    def ldr(self, camera, exposure, lighting_level=1.0) -> torch.Tensor:
        return torch.from_numpy(self.small.response(exposure * self.hdr(camera).numpy()))

    def response_curve(self):
        x = np.linspace(-8.0, 6.0, 400)
        code = self.small.response(np.exp(x))
        return torch.from_numpy(x), torch.from_numpy(np.repeat(code[:, None], 3, axis=1))


def test_the_protocol_on_validation_views_opens_no_test_view(small, with_validation: Path) -> None:
    path = with_validation / "dataset.json"
    # A camera with a local response: what the response is measured by is truth, of the same views.
    path.write_text(json.dumps(json.loads(path.read_text()) | {"camera_model": {"local_response": 0.5}}))
    scene = read_scene(with_validation)
    remove_test(with_validation)
    result = evaluate(Oracle(small), scene, split="val")
    assert result.split == "val" and {row.view for row in result.ldr} == {"val/r_5", "val/r_6"}
    assert len(result.ldr) == 10 and [row.index for row in result.hdr] == [5, 6] and result.relit == []
    assert result.ldr_oe is not None and result.ldr_oe.psnr > 60
    assert result.hdr_mean is not None and result.hdr_mean.psnr == 100.0
    assert any("relit truth is of test views alone" in message for message in result.messages)
    assert result.response is not None and result.response.scale == pytest.approx(1.0, abs=0.02)
    assert comparison_sheet(Oracle(small), scene, split="val").shape[2] == 3
    learned = learned_response(Oracle(small))
    assert learned is not None and check_response(learned, true_response(scene, learned, "val")).rms_error
    with pytest.raises(FileMissingError):
        evaluate(Oracle(small), scene)


def test_the_figures_of_two_splits_are_of_different_views(small, with_validation: Path) -> None:
    scene = read_scene(with_validation)
    test, validation = (evaluate(Flat(), scene, split=split) for split in ("test", "val"))
    assert {row.view for row in test.ldr} == {"test/r_1", "test/r_3"} and test.relit
    assert test.hdr_mean is not None and test.hdr_mean != validation.hdr_mean


def test_splits_that_cannot_be_evaluated(small: ModuleType, data_set: Path) -> None:
    scene = read_scene(data_set)
    with pytest.raises(DataMismatchError, match="no validation views") as caught:
        evaluate(Oracle(small), scene, split="val")
    assert "--validation-views" in caught.value.hint
    for split in ("train", "lit", "west"):
        with pytest.raises(BadValueError, match=f"'{split}' cannot be evaluated"):
            evaluate(Oracle(small), scene, split=split)


def test_without_test_views_it_names_the_others(small: ModuleType, with_validation: Path) -> None:
    remove_test(with_validation)  # as a plan that tunes is shown its data
    with pytest.raises(DataMismatchError, match="no test views") as caught:
        evaluate(Oracle(small), read_scene(with_validation))
    assert "--split val" in caught.value.hint


def test_the_command_says_which_views(validation_data: Path, tmp_path: Path, capsys) -> None:
    run = tmp_path / "run"
    words = ["train", str(validation_data), "--out", str(run), "--preset", "baseline"]
    assert main([*words, "--iterations", "3"]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(run), "--split", "val"]) == 0
    assert "tiny, validation views" in capsys.readouterr().out
    content = json.loads((run / "evaluation.json").read_text())
    assert content["conditions"]["split"] == "val" and len(content["views"]) == 3
    assert "split val: 3 views" in (run / "evaluation.md").read_text()
