# SPDX-License-Identifier: GPL-3.0-or-later
"""Plush, which the bear, his rabbit and the rugs wear: as much as asked for, and always the same."""

import math

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from physhdr.synth.scenes import plush

RADIUS, LENGTH, DENSITY = 0.2, 0.03, 20000.0


@pytest.fixture
def scene():
    made = bpy.data.scenes.new("plush")
    yield made
    bpy.data.scenes.remove(made)


def grown(scene, seed: int) -> np.ndarray:
    """Vertices [N, 3] of the tufts of a ball."""
    pelt = plush.pelt("pelt", (0.2, 0.1, 0.05), (0.5, 0.3, 0.1))
    parts = [((0.0, 0.0, 0.0), (RADIUS,) * 3, (0.0, 0.0, 0.0))]
    item = plush.blobs(scene.collection, "ball", parts, Matrix(), pelt)
    coat = plush.tufted(item, LENGTH, 0.007, DENSITY, seed=seed)
    scene.view_layers[0].update()
    mesh = coat.evaluated_get(scene.view_layers[0].depsgraph).to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    _check_attributes(mesh, points.reshape(-1, 3))
    return points.reshape(-1, 3)


def _check_attributes(mesh, points: np.ndarray) -> None:
    """What the material reads: the skin's normal, and 0 at the root to 1 at the tip."""
    normals, along = np.empty(points.size, np.float32), np.empty(len(points), np.float32)
    mesh.attributes[plush.SKIN].data.foreach_get("vector", normals)
    mesh.attributes[plush.ALONG].data.foreach_get("value", along)
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.median(np.sum(normals.reshape(-1, 3) * outward, axis=1)) > 0.98
    assert along.min() == 0.0 and along.max() == pytest.approx(1.0)


def test_tufts_are_as_dense_and_as_long_as_asked(scene):
    points = grown(scene, 1)
    area = 4.0 * math.pi * RADIUS**2
    tufts = len(points) / 4  # three at the root, one at the tip: a cone's top of radius 0
    assert tufts == pytest.approx(DENSITY * area, rel=0.03)
    heights = np.linalg.norm(points, axis=1) - RADIUS
    assert heights.min() > -0.005  # roots lie in the skin
    assert 0.8 * LENGTH < heights.max() <= 1.15 * LENGTH + 0.002


def test_tufts_are_the_same_each_time_and_others_with_another_seed(scene):
    first, again, other = grown(scene, 1), grown(scene, 1), grown(scene, 2)
    assert np.array_equal(first, again)
    assert first.shape != other.shape or not np.allclose(first, other)
