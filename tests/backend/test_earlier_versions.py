# SPDX-License-Identifier: GPL-3.0-or-later
"""What commit e7440a3 wrote opens, goes on, and says the same today: data sets, runs, exports.

tests/fixtures/e7440a3 holds two data sets of ``tiny_scene``, and of each run the checkpoint from half of its
iterations, with the evaluation and the exports of when it had ended.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main
from physhdr.backend.runs.run import open_run
from physhdr.bridge.model_file import read_model
from physhdr.bridge.ply_model import read_ply_model

EARLIER = Path(__file__).parent.parent / "fixtures" / "e7440a3"
#: Run → its data set.
RUNS = {
    "default": "data",
    "default_two_lights": "data_two_lights",
    "default-scaffold": "data",
    "paper": "data",
    "hdr-nerf": "data",
}
#: Processors round differently; a dozen iterations make this of it at most.
DECIBELS = 0.02


@pytest.fixture(scope="module", params=RUNS)
def earlier(request, tmp_path_factory):
    """A run of then (a copy), and its data set."""
    folder = tmp_path_factory.mktemp("earlier") / request.param
    shutil.copytree(EARLIER / request.param, folder)
    return folder, EARLIER / RUNS[request.param]


def test_it_opens(earlier):
    folder, data = earlier
    run = open_run(folder, data)
    assert run.iteration == run.config.iterations // 2
    assert run.method.lights == (("ambient", "pendant") if data.name.endswith("two_lights") else ("ambient",))


def test_it_goes_on_and_evaluates_as_it_did(earlier, capsys):
    folder, data = earlier
    then = json.loads((folder / "evaluation.json").read_text())
    assert main(["train", str(data), "--resume", str(folder)]) == 0
    assert "older PhysHDR" in " ".join(capsys.readouterr().out.split())
    assert main(["evaluate", str(folder), "--data", str(data)]) == 0
    now = json.loads((folder / "evaluation.json").read_text())
    assert now["conditions"]["iteration"] == then["conditions"]["iteration"]
    for name in ("LDR-OE", "LDR-NE", "HDR"):
        assert then["means"][name]["psnr"] > 3.0  # there is something to compare
        assert now["means"][name]["psnr"] == pytest.approx(then["means"][name]["psnr"], abs=DECIBELS)
    for row, former in zip(now["relit"], then["relit"], strict=True):
        assert row["ours"] == pytest.approx(former["ours"], abs=DECIBELS)


def test_its_exports_are_read_and_made_again(earlier, tmp_path, capsys):
    folder, data = earlier
    if folder.name == "hdr-nerf":
        assert main(["export", str(folder), "--data", str(data)]) == 1
        assert "no Gaussians" in capsys.readouterr().err
        return
    then = read_model(folder / "model.safetensors")
    for name in ("baked.ply", "lossless.ply"):
        if (folder / name).exists() and (name, folder.name) != ("lossless.ply", "paper"):  # networks
            assert read_ply_model(folder / name).model.count == then.count
    assert main(["train", str(data), "--resume", str(folder)]) == 0
    assert main(["export", str(folder), "--data", str(data), "--out", str(tmp_path)]) == 0
    now = read_model(tmp_path / "model.safetensors")
    assert now.lights == then.lights and now.exposures == then.exposures
    for name, array in then.tensors().items():
        np.testing.assert_allclose(now.tensors()[name], array, atol=2e-3, err_msg=name)
