# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians under affine maps: the covariance must become A Σ Aᵀ, whatever the way there."""

import numpy as np
import pytest

from physhdr.bridge.affine import matrices_of, quaternions_of, transform_gaussians
from physhdr.bridge.errors import BadValueError


def covariance(rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    axes = matrices_of(rotation / np.linalg.norm(rotation, axis=1, keepdims=True)) * scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def random_rotation(seed: int) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


MAPS = {
    "identity": np.eye(3),
    "half turn": np.diag([1.0, -1.0, -1.0]),
    "turned and larger": 3.0 * random_rotation(0),
    "stretched": random_rotation(1) @ np.diag([0.5, 1.0, 4.0]),
    "sheared": np.array([[1.0, 0.7, 0.0], [0.0, 1.0, -0.3], [0.0, 0.0, 2.0]]),
    "mirrored": np.diag([-1.0, 1.0, 1.0]),
}


@pytest.mark.parametrize("name", MAPS)
def test_covariance_and_position(name: str):
    rng = np.random.default_rng(2)
    position, rotation = rng.normal(size=(200, 3)), rng.normal(size=(200, 4))
    scale = rng.lognormal(-2.0, 1.0, size=(200, 3))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = MAPS[name], [1.0, -2.0, 0.5]
    moved, turned, scaled = transform_gaussians(matrix, position, rotation, scale)
    np.testing.assert_allclose(moved, position @ MAPS[name].T + [1.0, -2.0, 0.5], atol=1e-5)
    expected = MAPS[name] @ covariance(rotation, scale) @ MAPS[name].T
    size = np.abs(expected).max(axis=(1, 2), keepdims=True)
    assert (np.abs(covariance(turned, scaled) - expected) / size).max() < 1e-5
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0, atol=1e-6)


def test_a_similarity_keeps_the_axes_in_their_order():
    rotation, scale = np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 3.0, 2.0]])
    quarter = np.diag([0.0, 0.0, 1.0, 1.0])
    quarter[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]  # 90° about Z
    _, turned, scaled = transform_gaussians(quarter, np.zeros((1, 3)), rotation, scale)
    np.testing.assert_allclose(turned[0], [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-6)
    np.testing.assert_allclose(scaled, scale)


def test_quaternions_of_every_half_turn():
    for quaternion in np.eye(4):
        back = quaternions_of(matrices_of(quaternion[None]))[0]
        np.testing.assert_allclose(np.abs(back), quaternion, atol=1e-12)


@pytest.mark.parametrize("diagonal", [(1.0, 1.0, 0.0), (0.0, 0.0, 0.0), (np.nan, 1.0, 1.0)])
def test_flat_maps_are_refused(diagonal):
    matrix = np.diag([*diagonal, 1.0])
    with pytest.raises(BadValueError, match="flat or not finite"):
        transform_gaussians(matrix, np.zeros((1, 3)), np.ones((1, 4)), np.ones((1, 3)))
