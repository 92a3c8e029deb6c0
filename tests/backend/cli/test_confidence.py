# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence as a user gets it: in the exported model, as a picture, and as a table against truth."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.cli.confidence import GAP, LEGEND, gaussians_with_confidence, write_calibration
from physhdr.backend.export.confidence import confidence_picture
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.confidence import MEANING, RAMP
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.model_file import read_model
from physhdr.bridge.ply_model import read_ply_model


@pytest.fixture(scope="module")
def run(tiny_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "fast"
    words = ["--preset", "fast", "--iterations", "60", "--set", "sh_degree_every=10"]
    assert main(["train", str(tiny_data), "--out", str(folder), *words]) == 0
    return folder


def test_the_exported_model_has_it(run, capsys):
    assert main(["export", str(run)]) == 0
    assert "without confidence" not in capsys.readouterr().out
    confidence = read_model(run / "model.safetensors").confidence
    assert confidence is not None and confidence.shape == (read_model(run / "model.safetensors").count,)
    assert 0.0 <= confidence.min() < confidence.max() <= 1.0


def without_its_pictures(run, tiny_data, tmp_path):
    """A copy of the run whose data set is not where it was."""
    moved = tmp_path / "run"
    shutil.copytree(run, moved)
    written = json.loads((moved / "config.json").read_text())
    assert str(tiny_data) in json.dumps(written)
    text = json.dumps(written).replace(str(tiny_data), str(tmp_path / "gone"))
    (moved / "config.json").write_text(text)
    return moved


def test_without_the_training_pictures_there_is_none(run, tiny_data, tmp_path, capsys):
    moved = without_its_pictures(run, tiny_data, tmp_path)
    assert main(["export", str(moved)]) == 0
    assert "without confidence" in " ".join(capsys.readouterr().out.split())
    assert read_model(moved / "model.safetensors").confidence is None
    assert main(["render", str(moved), "--out", str(tmp_path / "c.png"), "--confidence"]) == 1
    assert "--data" in capsys.readouterr().err
    # Named where they are, they tell it.
    out = tmp_path / "c.png"
    assert main(["render", str(moved), "--out", str(out), "--confidence", "--data", str(tiny_data)]) == 0


def test_a_run_is_converted_with_it(run, tiny_data, tmp_path, capsys):
    """As it is exported; where the pictures have gone, its absence is told."""
    assert main(["export", str(run), str(tmp_path), "--quick"]) == 0
    exported = read_model(tmp_path / "model.safetensors").confidence
    out = tmp_path / "converted.safetensors"
    capsys.readouterr()
    assert main(["export", str(run), str(out)]) == 0
    assert "without confidence" not in capsys.readouterr().out
    converted = read_model(out).confidence
    assert converted is not None
    np.testing.assert_array_equal(converted, exported)
    moved = without_its_pictures(run, tiny_data, tmp_path)
    assert main(["export", str(moved), str(out)]) == 0
    assert "the model, without confidence" in " ".join(capsys.readouterr().out.split())
    assert read_model(out).confidence is None


def test_it_is_drawn_in_numbers_and_in_colours(run, tmp_path):
    assert main(["render", str(run), "--out", str(tmp_path / "sure.exr"), "--confidence"]) == 0
    file = OpenEXR.File(str(tmp_path / "sure.exr"))
    numbers = file.channels()["RGB"].pixels
    assert file.header()["physhdr"] == f"confidence: {MEANING}"
    assert numbers.min() >= 0.0 and 0.1 < numbers.max() <= 1.0
    np.testing.assert_array_equal(numbers[..., 0], numbers[..., 2])
    shown = np.array(Image.open(tmp_path / "sure.png"))
    height, width = numbers.shape[:2]
    assert shown.shape == (height + GAP + LEGEND, width, 3)
    np.testing.assert_array_equal(shown[-1, [0, -1]], np.round(255.0 * RAMP[[0, -1]]))
    # A pixel's colour is the legend's at its number.
    place = np.round(numbers[..., 0] * (width - 1)).astype(int)
    difference = shown[:height].astype(int) - shown[-1][place].astype(int)
    assert np.abs(difference).max() <= 10


def test_in_all_directions_it_is_what_a_camera_sees(run, tmp_path):
    """From ten metres before the scene: a camera that looks at +Y sees as much; behind there is nothing."""
    at = ["--at", "0", "-10", "0"]
    words = ["render", str(run), "--confidence", *at, "--width", "64", "--out", str(tmp_path / "sky.png")]
    assert main(words) == 0
    sure = OpenEXR.File(str(tmp_path / "sky.exr")).channels()["RGB"].pixels[..., 0]
    assert sure.shape == (32, 64) and Image.open(tmp_path / "sky.png").size == (64, 32 + GAP + LEGEND)
    assert (sure[:, 40:56] == 0.0).all()
    opened = open_run(run, pictures=False)
    method, found = gaussians_with_confidence(opened)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # right +X, up +Z, looks at +Y
    pose[:3, 3] = (0.0, -10.0, 0.0)
    pixel = 2.0 * math.pi / 64
    camera = Camera.from_field_of_view(pose, 128, 128, 2.0 * pixel)  # +Y is where four pixels meet
    seen = confidence_picture(method, found, camera).image[0].numpy().mean()
    assert seen > 0.05
    assert sure[15:17, 15:17].mean() == pytest.approx(seen, rel=0.03)
    assert main(["render", str(run), *at, "--out", str(tmp_path / "x.exr")]) == 1  # not without --confidence


@pytest.mark.parametrize("words", [["--exposure", "2"], ["--lighting-level", "2"], ["--split", "test"]])
def test_what_means_nothing_beside_it_is_refused(run, tmp_path, capsys, words):
    assert main(["render", str(run), "--out", str(tmp_path / "c.png"), "--confidence", *words]) == 1
    assert "error: --" in capsys.readouterr().err


def test_it_is_compared_with_truth(run, tmp_path, capsys):
    assert main(["evaluate", str(run), "--confidence", "--out", str(tmp_path)]) == 0
    assert "least sure tenth" in capsys.readouterr().out
    found = json.loads((tmp_path / "confidence.json").read_text())
    assert (found["format"], found["split"], len(found["parts"])) == ("physhdr-confidence", "test", 10)
    sure = [part["confidence"] for part in found["parts"]]
    assert sure == sorted(sure, reverse=True)
    assert "| surest tenth |" in (tmp_path / "confidence.md").read_text()


def masked(opened, hidden, path):
    """The opened run, the test pictures of which have a mask."""
    Image.fromarray(np.where(hidden, 0, 255).astype(np.uint8)).save(path)
    views = [
        replace(view, sources=tuple(replace(each, mask_path=path) for each in view.sources))
        for view in opened.scene.test
    ]
    return replace(opened, scene=replace(opened.scene, test=views))


def test_nothing_is_compared_where_pictures_are_masked(run, tmp_path):
    opened = open_run(run)
    camera = opened.scene.test[0].camera
    hidden = np.ones((camera.height, camera.width), bool)
    with pytest.raises(BadValueError, match="only 0 pixels of the test views are not masked"):
        write_calibration(masked(opened, hidden, tmp_path / "all.png"), "test", tmp_path)
    hidden[:, :10] = False
    table = write_calibration(masked(opened, hidden, tmp_path / "most.png"), "test", tmp_path)
    assert table.pixels == len(opened.scene.test) * 10 * camera.height


def test_the_lossless_ply_has_it(run):
    assert main(["export", str(run)]) == 0
    kept = read_ply_model(run / "lossless.ply").model.confidence
    np.testing.assert_array_equal(kept, read_model(run / "model.safetensors").confidence)
    assert read_ply_model(run / "baked.ply").model.confidence is None
