# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of points against surfaces whose normals are known."""

import numpy as np
import pytest

from physhdr.backend.surface.normals import NEIGHBOURS, facing, point_normals


def degrees_between(normals: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Whichever sign they have."""
    return np.degrees(np.arccos(np.abs((normals * expected).sum(axis=1)).clip(0.0, 1.0)))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.3, -0.8, 0.2)])
def test_a_plane(normal) -> None:
    normal = unit(np.array(normal, np.float64))
    across = np.linalg.svd(normal[None])[2][1:]
    points = np.random.default_rng(0).uniform(-1, 1, (500, 2)) @ across + (5.0, 6.0, 7.0)
    found = point_normals(points, np.ones(500))
    assert found.dtype == np.float32 and degrees_between(found, normal).max() < 0.1


def test_a_sphere() -> None:
    points = unit(np.random.default_rng(1).normal(size=(20_000, 3)))
    error = degrees_between(point_normals(0.5 * points, np.ones(len(points))), points)
    assert np.median(error) < 1.0 and error.max() < 8.0


def test_faint_points_do_not_count() -> None:
    random = np.random.default_rng(2)
    plane = np.column_stack([random.uniform(-1, 1, (400, 2)), np.zeros(400)])
    fog = random.uniform(-1, 1, (2000, 3))
    opacities = np.repeat([1.0, 0.05], [400, 2000])
    found = point_normals(np.concatenate([plane, fog]), opacities)
    assert degrees_between(found[:400], np.array([0.0, 0.0, 1.0])).max() < 0.1


def test_too_few_points_have_no_normal() -> None:
    points = np.arange(9.0).reshape(3, 3)
    assert not point_normals(points, np.array([1.0, 1.0, 0.0])).any()
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert len(triangle) < NEIGHBOURS
    np.testing.assert_allclose(np.abs(point_normals(triangle, np.ones(3))), [[0, 0, 1]] * 3, atol=1e-6)


def test_normals_face_the_camera() -> None:
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], np.float32)
    turned = facing(normals, np.zeros((2, 3)), np.array([3.0, 0.0, 2.0]))
    np.testing.assert_array_equal(turned, [[0, 0, 1], [0, 0, 1]])
