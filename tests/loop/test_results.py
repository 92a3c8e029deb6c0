# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation, video, web page and bake from Blender with the real backend: figures and frames are its own."""

import json
import math
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image
from plyfile import PlyData

from physhdr.backend.evaluate.metrics import psnr
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene import Camera

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def run(tiny_scene, tmp_path_factory) -> Path:
    """A few Gaussians, trained for a moment."""
    folder = tmp_path_factory.mktemp("results")
    data = tiny_scene.write_tiny_scene(folder / "data")
    command = [sys.executable, ROOT / "backend" / "launch.py", "train", data, "--out", folder / "run"]
    subprocess.run([*command, "--iterations", "60"], check=True, capture_output=True)
    export = [sys.executable, ROOT / "backend" / "launch.py", "export", folder / "run", "--quick"]
    subprocess.run(export, check=True, capture_output=True)
    return folder / "run"


@pytest.mark.long
def test_a_run_is_evaluated_filmed_and_baked_from_blender(run, in_blender, viewer, tmp_path):
    in_blender("tests/loop/use_results.py", sys.executable, run, tmp_path)
    seen = json.loads((tmp_path / "seen.json").read_text())
    opened = open_run(run)
    assert seen["views"] == len(opened.scene.test)
    means = json.loads((run / "evaluation.json").read_text())["means"]
    told = {what: numbers for what, _, numbers in seen["figures"]}
    assert told["Learned Exposures"].startswith(f"PSNR {means['LDR-OE']['psnr']:.1f} dB")
    assert (run / "comparison.png").exists()

    # The same frames, worked out here: the camera looks along +Y, Z up.
    looking = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    wanted = []
    for place, angle, exposure, level in ((-4.0, 0.9, 2.0, 1.0), (-3.0, 1.2, 1.0, 4.0)):
        pose = looking.copy()
        pose[1, 3] = place
        focal = 24.0 / math.tan(0.5 * angle)
        camera = Camera(pose, 48, 32, focal, focal, 24.0, 16.0)
        wanted.append(opened.method.ldr(camera, exposure, level).cpu())
    files = sorted((tmp_path / "video").glob("*.png"))
    assert len(files) == 2
    for path, picture in zip(files, wanted, strict=True):
        found = torch.from_numpy(np.asarray(Image.open(path)) / 255.0).permute(2, 0, 1).float()
        assert psnr(found, picture.float()) > 50.0
    assert psnr(wanted[0].float(), wanted[1].float()) < 30.0, "the frames are two pictures"
    with av.open(str(tmp_path / "video.mp4")) as video:
        assert [frame.width for frame in video.decode(video=0)] == [48, 48]
    page = (tmp_path / "page.html").read_text()
    assert f'"name":"test/{opened.scene.test[0].index}"' in page and "MODEL_PART(0," in page
    check_baked(opened, np.array(seen["matrix"]), tmp_path, viewer)


def check_baked(opened, matrix, folder, viewer):
    """What a standard viewer shows of the bakes, where the model stands, is the method's own picture."""
    camera = opened.scene.test[0].camera
    moved = Camera(
        matrix @ camera.camera_to_world,
        *(camera.width, camera.height),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
    )
    with torch.no_grad():
        own = opened.method.ldr(camera, 2.0**-0.5, (2.0,)).double()
    far = []
    for name in ("fitted.ply", "quick.ply"):
        ply = PlyData.read(str(folder / name))
        assert any("fitted to pictures" in line for line in ply.comments) == (name == "fitted.ply")
        shown = viewer.viewed(ply["vertex"], moved).clamp(0.0, 1.0)
        far.append(float((shown - own).square().mean().sqrt()))
    assert far[0] < 0.5 * far[1], far
