# SPDX-License-Identifier: GPL-3.0-or-later
"""Points far away where pictures show nothing near, and none in a room."""

from types import SimpleNamespace

import numpy as np
import pytest

from physhdr.backend.scene.camera import Camera
from physhdr.backend.start.far_shell import far_points

WIDTH, HEIGHT, FOCAL = 80, 60, 60.0


def looking_north(x):
    """A camera at (x, 0, 1.5) that looks along +Y, Z up."""
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    pose[:3, 3] = [x, 0.0, 1.5]
    return SimpleNamespace(camera=Camera(pose, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2))


VIEWS = [looking_north(x) for x in np.linspace(-1.0, 1.0, 5)]


def pixels(points, camera):
    inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    assert (inside[:, 2] > 0).all()
    return camera.fx * inside[:, 0] / inside[:, 2] + camera.cx, camera.fy * inside[:, 1] / inside[
        :, 2
    ] + camera.cy


def test_a_sky_over_a_ground_gets_points_and_the_ground_none():
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-40, 40, 60_000), rng.uniform(1, 60, 60_000), np.zeros(60_000)])
    far = far_points(ground, VIEWS)
    # Beyond everything: three times as far as nearly all of the ground is.
    distances = np.linalg.norm(far - [0.0, 0.0, 1.5], axis=1)
    assert distances.min() > 3.0 * 50.0 and np.ptp(distances) < 1e-6 * distances.max() + 1e-6
    column, row = pixels(far, VIEWS[2].camera)
    shown = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
    assert row[shown].max() < HEIGHT / 2  # above the horizon
    # Everywhere in the upper part of the picture there is one within a tenth of its height.
    for x in range(5, WIDTH, 10):
        for y in range(3, 20, 6):
            assert np.hypot(column - x, row - y).min() < 0.1 * HEIGHT


def test_a_room_gets_none():
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-9, 9, 20_000), np.full(20_000, 4.0), rng.uniform(-4, 7, 20_000)])
    assert far_points(wall, VIEWS).shape == (0, 3)


@pytest.mark.parametrize("opened", [1.0, 1.5])
def test_what_only_one_view_has_no_points_of_is_not_far(opened):
    """A wall with a hole: where most views have the wall, there is no distant point."""
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.uniform(-9, 9, 20_000), np.full(20_000, 4.0), rng.uniform(-4, 7, 20_000)])
    wall = wall[np.hypot(wall[:, 0], wall[:, 2] - 1.5) > opened]
    far = far_points(wall, VIEWS)
    if len(far):
        column, row = pixels(far, VIEWS[2].camera)
        assert np.hypot(column - WIDTH / 2, row - HEIGHT / 2).max() < opened / 4.0 * FOCAL
