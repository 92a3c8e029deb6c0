# SPDX-License-Identifier: GPL-3.0-or-later
"""Equirectangular pictures: which way they look (tests/addon asks Cycles), how large their pixels are."""

import math

import numpy as np
import pytest

from physhdr.bridge import panorama


def test_directions_are_those_of_a_world_with_z_up():
    width = 360
    columns, rows = panorama.coordinates(np.eye(3), width)
    assert columns == pytest.approx([180.0, 90.0, 180.0])  # +X in the middle, +Y a quarter from the left
    assert rows == pytest.approx([90.0, 90.0, 0.0])  # the horizon; +Z on top
    assert panorama.coordinates(np.array([0.0, -1.0, 0.0]), width)[0] == pytest.approx(270.0)


def test_coordinates_undo_directions():
    width = 64
    for column, row in ((0.5, 0.5), (0.25, 0.75)):
        vectors = panorama.directions(width, column, row)
        assert np.linalg.norm(vectors, axis=-1) == pytest.approx(1.0)
        columns, rows = panorama.coordinates(3.0 * vectors, width)
        assert columns == pytest.approx(np.broadcast_to(np.arange(width) + column, columns.shape))
        assert rows == pytest.approx(np.broadcast_to((np.arange(width // 2) + row)[:, None], rows.shape))


def test_solid_angles_are_of_a_whole_sphere():
    width = 32
    assert width * panorama.solid_angles(width).sum() == pytest.approx(4.0 * math.pi)
    # A pixel at the horizon, by its definition: ∫∫ cos(latitude).
    step = 2.0 * math.pi / width
    assert panorama.solid_angles(width)[width // 4] == pytest.approx(step * math.sin(step))


def test_the_share_that_was_never_seen_is_by_solid_angle():
    alpha = np.ones((32, 64))
    alpha[:8] = 0.0  # above 45 degrees: a cap of (1 − sin 45°) / 2
    assert panorama.unseen_share(alpha) == pytest.approx(0.5 * (1.0 - math.sqrt(0.5)))
    assert panorama.unseen_share(np.full((32, 64), 0.25)) == pytest.approx(0.75)


def test_gaussians_that_are_too_near_are_those_close_by_and_those_around():
    positions = np.array(
        [[0.05, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [9.0, 0.0, 0.0]]
    )
    # Long along its own X: as it lies it reaches the place, turned a quarter about Z it does not.
    quarter = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    rotations = np.array([[1.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], quarter, [1.0, 0.0, 0.0, 0.0], quarter])
    scales = np.array([[0.01] * 3, [0.6, 0.1, 0.1], [0.6, 0.1, 0.1], [0.4, 0.1, 0.1], [0.1] * 3])
    close = panorama.too_near(positions, rotations, scales, np.zeros(3), near=0.1)
    assert close.tolist() == [True, True, False, False, False]


def test_how_near_is_a_share_of_how_far_they_are():
    positions = np.array([[1.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 50.0]])
    assert panorama.near_distance(positions, np.zeros(3)) == pytest.approx(3.0 * panorama.NEAR_SHARE)
    assert panorama.near_distance(np.zeros((0, 3)), np.zeros(3)) == 0.0
