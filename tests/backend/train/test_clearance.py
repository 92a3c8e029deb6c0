# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians that float before a camera go at the next growth step; renders' are left alone."""

import dataclasses

import numpy as np
import pytest
import torch

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.clearance import FEWEST, NEAREST, clearances, floating
from physhdr.backend.train.growing import Growing
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import FileDamagedError
from physhdr.bridge.run_folder import CHECKPOINT_FILE


def camera():
    """At the origin, looking down −Z, 90° wide."""
    return Camera(np.eye(4), 100, 100, 50.0, 50.0, 50.0, 50.0)


def test_nothing_is_nearer_than_a_share_of_the_nearest_points():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (1000, 2)), -rng.uniform(2.0, 8.0, 1000)])
    points[:5, 2] = -0.01  # strays of the matching
    depth = np.sort(-points[:, 2])
    (clearance,) = clearances(points, [camera()]).tolist()
    assert clearance == pytest.approx(NEAREST * np.quantile(depth, 0.02), rel=0.03)
    assert clearances(points[: FEWEST // 2], [camera()]).tolist() == [0.0]


def test_only_what_is_in_the_frame_floats():
    means = torch.tensor(
        [
            [0.0, 0.0, -0.3],  # before the camera, near
            [0.2, -0.1, -0.3],
            [0.0, 0.0, -0.6],  # far enough
            [0.0, 0.0, 0.3],  # behind it
            [0.5, 0.0, -0.3],  # beside its frame
        ]
    )
    found = floating(means, [camera()], torch.tensor([0.5]))
    assert found.tolist() == [True, True, False, False, False]
    assert not floating(means, [camera()], torch.tensor([0.0])).any()


def short(**changes):
    config = PRESETS["default"]
    density = dataclasses.replace(config.backbone, start=2, every=4, stop=0.9)
    return dataclasses.replace(config, iterations=10, backbone=density, **changes)


def test_a_floater_is_removed_where_it_is_wanted(tiny_data):
    scene = read_scene(tiny_data)
    for setting, stays in (("on", False), ("off", True), ("auto", True)):  # auto: these are renders
        state = begin(scene, short(clear_cameras=setting))
        before = scene.train[0].camera
        with torch.no_grad():
            depths = torch.tensor([0.05, 0.1, 0.15])[:, None]
            axis = torch.from_numpy(-before.camera_to_world[:3, 2]).float()
            state.method.gaussians.means[:3] = torch.from_numpy(before.position).float() + depths * axis
        for _ in range(4):
            step(state)
        distance = (state.method.gaussians.means - torch.from_numpy(before.position)).norm(dim=1)
        assert bool((distance < 0.3).any()) == stays


def test_a_resumed_training_knows_what_is_near(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short(clear_cameras="on", far_shell="on")
    state = begin(scene, config)
    assert "far away where these leave pictures uncovered" in state.start_message
    step(state)
    save(state, tmp_path)
    resumed = resume(tmp_path, scene, config)
    assert torch.equal(resumed.part(Growing).growth.clearance, state.part(Growing).growth.clearance)
    fewer = dataclasses.replace(scene, train=scene.train[:-1])
    with pytest.raises(FileDamagedError, match="clearance is"):
        resume(tmp_path, fewer, config)
    assert (tmp_path / CHECKPOINT_FILE).is_file()
