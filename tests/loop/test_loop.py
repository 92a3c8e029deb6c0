# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole loop, small: a scene from Cycles, training, evaluation, and the relit Gaussians in Cycles."""

import json

import numpy as np
import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.evaluate.metrics import hdr_pair, psnr
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.pictures import read_exr

#: It renders a data set and trains on it.
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def run(data):
    folder = data.parent / "run"
    assert (
        main(["train", str(data), "--out", str(folder), "--iterations", "300", "--set", "sh_degree_every=80"])
        == 0
    )
    assert main(["evaluate", str(folder)]) == 0
    assert main(["export", str(folder)]) == 0
    return folder


def test_training_on_a_rendered_scene_gets_the_radiance_right(run):
    """Six training views are few: this asks for the right scale and a recognisable picture, no more."""
    evaluation = json.loads((run / "evaluation.json").read_text())
    assert 0.9 < evaluation["scale_ratio"] < 1.1
    assert evaluation["means"]["LDR-OE"]["psnr"] > 18
    assert evaluation["means"]["HDR"]["psnr"] > 18
    assert evaluation["relit_means"]["all"]["gain_over_scaled_ours"] > 0


def test_reference_and_cpu_draw_the_trained_model_alike(run):
    images = {}
    for rasteriser in ("reference", "cpu"):
        opened = open_run(run, rasteriser=rasteriser)
        images[rasteriser] = opened.method.hdr(opened.scene.test[0].camera, 2.0)
    difference = (images["reference"] - images["cpu"]).abs() / images["reference"].abs().clamp_min(1.0)
    # Where an opacity is within rounding of 1/255, or a transmittance of where a ray ends, the two may decide
    # differently; such a pixel then lacks one contribution of that size.
    assert difference.max() < 1 / 255
    assert (difference.amax(0) > 1e-4).float().mean() < 1e-2
    assert difference.mean() < 1e-5


def test_cycles_draws_the_point_cloud_as_we_do(run, data, in_blender):
    """Law 7: the same Gaussians, relit by geometry nodes alone, from the same camera."""
    index = json.loads((data / "dataset.json").read_text())["lighting_levels"]["relit_views"][0]
    opened = open_run(run)
    view = opened.scene.find("test", index)
    position = [v.index for v in opened.scene.test].index(index)
    out = run / "blender"
    camera = f"{data / 'transforms_test.json'}:{position}"
    arguments = ["--camera", camera, "--resolution", 64, "--levels", 1, 4, "--out", out]
    in_blender("addon/scripts/relight.py", run / "model.safetensors", *arguments, "--blend", out / "x.blend")
    assert (out / "x.blend").stat().st_size > 10_000
    for level in (1.0, 4.0):
        cycles = torch.from_numpy(np.ascontiguousarray(read_exr(out / f"level_{level:g}.exr")))
        pair = hdr_pair(cycles.permute(2, 0, 1), opened.method.hdr(view.camera, level))
        assert psnr(pair.prediction, pair.truth) > 40
