# SPDX-License-Identifier: GPL-3.0-or-later
"""Where training has found its pictures to be taken from: exported, and used for confidence."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from physhdr.backend.cli import main
from physhdr.backend.runs.run import Run, as_learned, open_run
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.learned_lens import lenses_of
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import learned_of_photographs, save
from physhdr.backend.train.trainer import step
from physhdr.bridge.run_folder import CAMERAS_FILE, CHECKPOINT_FILE

SHORT = ["--iterations", "16", "--set", "sh_degree_every=5"]


@pytest.fixture(scope="module")
def trained(tiny_data, tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "run"
    assert main(["train", str(tiny_data), "--out", str(run), *SHORT, "--poses", "on"]) == 0
    return run


@pytest.fixture
def run(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "run")


def turned(rotation):
    """Rodrigues' formula for a rotation vector."""
    angle = np.linalg.norm(rotation)
    x, y, z = rotation / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def listed(folder):
    return json.loads((folder / CAMERAS_FILE).read_text())


def test_exported_cameras_see_what_training_saw(run, tiny_data, capsys):
    """exp(ω) x + τ of the checkpoint's numbers, against the file as 3DGS's readers take it."""
    assert main(["export", str(run)]) == 0
    assert "its cameras, with learned poses" in capsys.readouterr().out
    tensors = load_file(run / CHECKPOINT_FILE)
    twists = (tensors["poses.twist"] * tensors["poses.pixel"]).numpy()
    opened = open_run(run)
    views, entries = opened.scene.train + opened.scene.lit, listed(run)
    assert len(entries) == len(twists) == len(views) and np.abs(twists).max() > 1e-5
    point = np.array([0.3, -0.2, 0.4])
    for view, entry, twist in zip(views, entries, twists, strict=True):
        assert entry["img_name"] == view.name and entry["pose"] == "learned"
        assert (entry["width"], entry["fx"], entry["cy"]) == (
            view.camera.width,
            view.camera.fx,
            view.camera.cy,
        )
        given = view.camera.world_to_camera
        x = given[:3, :3] @ point + given[:3, 3]
        wanted = turned(twist[:3]) @ x + twist[3:] if np.any(twist) else x
        seen = np.array(entry["rotation"]).T @ (point - np.array(entry["position"]))
        np.testing.assert_allclose(seen, wanted, atol=1e-9)


def test_renders_have_the_poses_that_they_say(tiny_data, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", str(tiny_data), "--out", str(run), *SHORT]) == 0
    assert main(["export", str(run)]) == 0
    assert "its cameras\n" in capsys.readouterr().out
    view, entry = open_run(run).scene.train[0], listed(run)[0]
    assert entry["pose"] == "given"
    np.testing.assert_allclose(entry["position"], view.camera.position, atol=1e-12)


def test_confidence_looks_from_where_training_looked(run):
    opened = open_run(run)
    seen = opened.seen()
    assert seen is not None
    for each, view, twist in zip(seen, opened.scene.train + opened.scene.lit, opened.twists, strict=True):
        assert each.view.sources == view.sources
        moved = np.abs(each.view.camera.camera_to_world - view.camera.camera_to_world).max()
        assert (moved > 0.0) == bool(np.any(twist))
    unmoved = dataclasses.replace(opened, twists=None)
    assert not np.array_equal(
        opened.confidence(opened.on_gaussians()), unmoved.confidence(opened.on_gaussians())
    )


def test_a_run_under_training_has_all_that_is_learned_so_far(tiny_data, tmp_path):
    """The backend exports while it trains: with the lens and the poses of that moment."""
    config = dataclasses.replace(PRESETS["default"], iterations=30, poses="on", nuisances="on")
    scene = read_scene(tiny_data)
    state = begin(scene, config)
    run = Run(tmp_path, "default", config, scene, state.method, 0)
    before = as_learned(run, state)
    assert before.iteration == 0 and before.twists is not None and not before.twists.any()
    while state.iteration < 20:
        step(state)
    now = as_learned(run, state)
    assert now.iteration == 20 and now.twists is not None and now.twists.any()
    assert before.twists is not now.twists and not before.twists.any()
    save(state, tmp_path)
    kept = load_file(tmp_path / CHECKPOINT_FILE)
    np.testing.assert_array_equal(now.twists, (kept["poses.twist"] * kept["poses.pixel"]).numpy())
    cameras = [view.camera for view in scene.train]
    lenses = lenses_of(learned_of_photographs(tmp_path)[0], cameras)
    assert lenses is not None and now.lenses is not None
    assert torch.equal(now.lenses.falloff(cameras[0]), lenses.falloff(cameras[0]))
    assert not bool((now.lenses.falloff(cameras[0]) == 1.0).all()), "something was learned of the lens"


def test_another_programs_cameras_stay(run, tmp_path, capsys):
    (run / CAMERAS_FILE).write_text("[1]")
    assert main(["export", str(run)]) == 1
    assert f"{run / CAMERAS_FILE} exists, and PhysHDR did not write it" in capsys.readouterr().err
    assert (run / CAMERAS_FILE).read_text() == "[1]" and not (run / "model.safetensors").exists()
    assert main(["export", str(run), str(tmp_path / "out")]) == 0
