# SPDX-License-Identifier: GPL-3.0-or-later
"""Learned poses: their gradient against differences, what a scene could follow, and errors that they find."""

import dataclasses

import numpy as np
import pytest
import torch

from physhdr.backend.model.backbone import Attributes, Splats
from physhdr.backend.model.gaussians import Gaussians
from physhdr.backend.rasterize import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.learned_poses import LearnedPoses, moved, twist_gradient
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError, FileDamagedError


def turned(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def camera_at(position, axis=(0.2, 1.0, -0.3), angle=0.7):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(axis, angle), position
    return Camera(pose, 24, 20, 30.0, 28.0, 12.5, 9.5)


def before(camera, count=6, seed=0):
    """Gaussians in front of a camera, float64: means, quaternions, scales, opacities, colours."""
    generator = torch.Generator().manual_seed(seed)
    depth = 1.5 + torch.rand(count, generator=generator, dtype=torch.float64)
    x, y = (torch.rand(2, count, generator=generator, dtype=torch.float64) - 0.5) * 0.5 * depth
    pose = torch.from_numpy(camera.camera_to_world)
    return [
        torch.stack([x, y, -depth], dim=1) @ pose[:3, :3].T + pose[:3, 3],
        torch.randn(count, 4, generator=generator, dtype=torch.float64),
        0.05 + 0.2 * torch.rand(count, 3, generator=generator, dtype=torch.float64),
        0.1 + 0.5 * torch.rand(count, generator=generator, dtype=torch.float64),
        torch.rand(count, 3, generator=generator, dtype=torch.float64),
    ]


def test_a_moved_camera_sees_everything_turned_and_shifted():
    camera, twist = camera_at((1.0, -2.0, 0.5)), np.array([0.02, -0.05, 0.03, 0.1, -0.2, 0.3])
    point = np.array([0.3, 0.7, -0.4, 1.0])
    angle = np.linalg.norm(twist[:3])
    wanted = turned(twist[:3], angle) @ (camera.world_to_camera @ point)[:3] + twist[3:]
    assert moved(camera, twist).world_to_camera @ point == pytest.approx([*wanted, 1.0], abs=1e-12)
    assert moved(camera, np.zeros(6)).camera_to_world == pytest.approx(camera.camera_to_world, abs=1e-15)


def test_the_gradient_is_that_of_moving_the_camera():
    """Against central differences of the oracle, in float64; quaternions need not be of length 1."""
    camera = camera_at((5.0, -2.0, 3.0))
    tensors = before(camera)
    weights = torch.randn(3, 20, 24, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def loss(seen_by, *gaussians):
        return (weights * rasterize(*gaussians, seen_by, implementation="reference").image).sum()

    for tensor in tensors:
        tensor.requires_grad_()
    loss(camera, *tensors).backward()
    means, quaternions, scales, opacities, colours = tensors
    splats = Splats(means, quaternions, scales, opacities, colours, colours[:, :1])
    step, wanted = 1e-6, []
    with torch.no_grad():
        for twist in np.eye(6) * step:
            ahead, behind = (loss(moved(camera, sign * twist), *tensors) for sign in (1.0, -1.0))
            wanted.append(((ahead - behind) / (2 * step)).item())
    assert np.abs(wanted).min() > 1e-3
    assert twist_gradient(splats, camera).tolist() == pytest.approx(wanted, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("learns", [False, True], ids=["without", "with"])
def test_colours_that_change_with_the_direction_tell_where_a_camera_is_if_positions_learn_of_them(learns):
    """They do not change when it turns. Else the differences are of colours that stay as they are."""
    camera = camera_at((5.0, -2.0, 3.0))
    means, quaternions, scales, opacities, _ = before(camera)
    generator = torch.Generator().manual_seed(2)
    parameters = {
        "means": means,
        "quaternions": quaternions,
        "log_scales": scales.log(),
        "opacity_logits": opacities.logit(),
        "reflectance_dc": 0.3 * torch.randn(len(means), 1, 3, generator=generator, dtype=torch.float64),
        "reflectance_rest": 0.3 * torch.randn(len(means), 15, 3, generator=generator, dtype=torch.float64),
        "log_illumination": torch.zeros(len(means), 1, dtype=torch.float64),
    }
    for parameter in parameters.values():
        parameter.requires_grad_()
    gaussians = Gaussians(parameters, Attributes(direction_gradient=learns))
    weights = torch.randn(3, 20, 24, generator=generator, dtype=torch.float64)

    def loss(camera, splats):
        shape = splats.means, splats.quaternions, splats.scales, splats.opacities
        colours = splats.log_reflectance.exp()
        return (weights * rasterize(*shape, colours, camera, implementation="reference").image).sum()

    splats = gaussians.splats(camera, 3)
    LearnedPoses.watch(splats)
    loss(camera, splats).backward()
    step, wanted = 1e-6, []
    with torch.no_grad():
        for twist in np.eye(6) * step:
            ahead, behind = (
                loss(at, gaussians.splats(at, 3) if learns else splats)
                for at in (moved(camera, twist), moved(camera, -twist))
            )
            wanted.append(((ahead - behind) / (2 * step)).item())
    assert twist_gradient(splats, camera).tolist() == pytest.approx(wanted, rel=1e-6, abs=1e-6)


def test_that_all_cameras_move_turn_or_spread_together_is_never_learned(tiny_data):
    """The world moved, turned about a point and grown, by hand: nothing of it is left, all of the rest is."""
    scene = read_scene(tiny_data)
    poses = LearnedPoses(scene.train, torch.from_numpy(scene.points.positions))
    centres = np.array([view.camera.position for view in scene.train])
    small = 1e-7
    rotation = turned((1.0, 2.0, -0.5), small)
    common = []
    for view in scene.train:
        world = np.eye(4)
        world[:3, :3] = (1 + small) * rotation
        world[:3, 3] = small * np.array([0.3, -0.2, 0.5])
        sees = view.camera.world_to_camera
        moves = sees @ world
        moves[:3] /= 1 + small  # a picture does not change with the scale of what is before the camera
        motion = moves @ np.linalg.inv(sees)
        spin = (motion[:3, :3] - motion[:3, :3].T) / 2
        common.append([spin[2, 1], spin[0, 2], spin[1, 0], *motion[:3, 3]])
    assert len(centres) > 2
    one = np.random.default_rng(0).normal(size=poses.twist.shape)
    for start in (np.zeros_like(one), one):
        poses.twist[...] = start + np.array(common) / small / poses.pixel
        poses._step(0, np.zeros(6), 1.0)
        with_it = poses.twist.copy()
        poses.twist[...] = start
        poses._step(0, np.zeros(6), 1.0)
        assert np.abs(with_it - poses.twist).max() < 1e-5
    assert np.abs(poses.twist).max() > 0.1


def short(mode="on", iterations=24, preset="default"):
    config = PRESETS[preset]
    density = dataclasses.replace(config.backbone, start=5, every=10, stop=0.8, threshold=1e-5)
    return dataclasses.replace(config, iterations=iterations, backbone=density, poses=mode)


def test_what_a_training_finds_of_wrong_poses_is_nearer_to_the_true_ones(larger_data):
    """Poses a pixel off, points where they are: what is left of the error is told as training is not."""
    scene = read_scene(larger_data)
    generator = np.random.default_rng(3)
    true = LearnedPoses(scene.train, torch.from_numpy(scene.points.positions))
    errors = generator.normal(size=true.twist.shape)
    errors.reshape(-1)[:] -= true._together @ (true._together.T @ errors.reshape(-1))
    wrong = [
        dataclasses.replace(view, camera=moved(view.camera, error * pixel))
        for view, error, pixel in zip(scene.train, errors, true.pixel, strict=True)
    ]
    config = dataclasses.replace(PRESETS["default"], iterations=200, poses="on", initial_points="auto")
    state = begin(dataclasses.replace(scene, train=wrong, lit=[]), config)
    while state.iteration < config.iterations:
        step(state)

    def shown(twist):
        """How far the middle of each view is from where it should be, pixels."""
        return np.hypot(twist[:, 3] + twist[:, 1], twist[:, 4] - twist[:, 0])

    left = shown(errors + state.part(LearnedPoses).twist)
    assert np.sqrt((left**2).mean()) < 0.5 * np.sqrt((shown(errors) ** 2).mean())


def test_a_resumed_training_is_bit_identical(tiny_data, whole_and_in_parts):
    whole, parts = whole_and_in_parts(read_scene(tiny_data), short(), (7, 8))
    assert whole.keys() == parts.keys() and whole["poses.twist"].abs().max() > 0.0
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def test_renders_are_taken_from_where_they_say_and_photographs_are_asked(tiny_data):
    scene = read_scene(tiny_data)
    photographs = dataclasses.replace(scene, info={}, response_anchor=None)
    assert begin(scene, short("auto")).part(LearnedPoses) is None
    assert begin(photographs, short("auto")).part(LearnedPoses) is not None
    assert begin(photographs, short("off")).part(LearnedPoses) is None
    assert begin(photographs, short("auto", preset="baseline")).part(LearnedPoses) is not None
    published = dataclasses.replace(PRESETS["gausshdr"], iterations=24)
    assert begin(photographs, published).part(LearnedPoses) is None


def test_anchors_tell_of_poses_too(tiny_data):
    scene, preset = read_scene(tiny_data), PRESETS["default-scaffold"]
    state = begin(scene, dataclasses.replace(preset, iterations=20, poses="on"))
    for _ in range(20):
        step(state)
    assert (np.abs(state.part(LearnedPoses).twist).max(axis=1) > 0.0).all()


def test_what_cannot_be_is_refused(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short()
    state = begin(scene, config)
    step(state)
    tensors = state.part(LearnedPoses).tensors
    state.part(LearnedPoses).tensors = lambda: {k: v for k, v in tensors().items() if k != "twist"}
    save(state, tmp_path)
    with pytest.raises(FileDamagedError, match=r"it has no poses\.twist"):
        resume(tmp_path, scene, config)
    with pytest.raises(BadValueError, match="hdr-nerf cannot learn poses"):
        begin(scene, dataclasses.replace(PRESETS["hdr-nerf-small"], poses="on"))
