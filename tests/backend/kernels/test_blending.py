# SPDX-License-Identifier: GPL-3.0-or-later
"""Products with blend weights against dense matrices in float64."""

import numpy as np
import pytest

from physhdr.backend.kernels.blending import (
    blend,
    gather,
    gather_squares,
    spread,
    spread_squares,
    toward_camera,
)
from physhdr.bridge.spherical_harmonics import basis

PIXELS, SEEN, ALL = 37, 11, 29


def made(seed=0):
    random = np.random.default_rng(seed)
    dense = random.random((PIXELS, SEEN)) * (random.random((PIXELS, SEEN)) < 0.3)
    dense[5] = 0.0  # a pixel without Gaussians
    rows, columns = np.nonzero(dense)
    starts = np.concatenate([[0], np.cumsum(np.count_nonzero(dense, axis=1))])
    sparse = starts.astype(np.int64), columns.astype(np.int32), dense[rows, columns].astype(np.float32)
    return random, dense, sparse


def test_blend_and_its_transpose():
    random, dense, sparse = made()
    colours = random.standard_normal((SEEN, 3)).astype(np.float32)
    pixels = np.full((PIXELS, 3), np.nan, np.float32)
    blend(*sparse, colours, pixels)
    np.testing.assert_allclose(pixels, dense @ colours, atol=1e-6)
    sums = np.ones((SEEN, 3), np.float32)
    gather(*sparse, pixels, sums)
    np.testing.assert_allclose(sums, 1.0 + dense.T @ pixels, atol=1e-5)


def test_squares():
    _, dense, sparse = made(1)
    sums = np.zeros(SEEN, np.float32)
    gather_squares(*sparse[1:], sums)
    np.testing.assert_allclose(sums, np.square(dense).sum(axis=0), atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_toward_camera_and_its_transpose(degree):
    random = np.random.default_rng(degree)
    coefficients = (degree + 1) ** 2
    seen = np.sort(random.choice(ALL, SEEN, replace=False))
    directions = random.standard_normal((SEEN, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    single = directions.astype(np.float32)
    harmonics = basis(directions, degree)
    sh = random.standard_normal((ALL, coefficients, 3)).astype(np.float32)
    colours = np.empty((SEEN, 3), np.float32)
    toward_camera(seen, single, sh, colours)
    np.testing.assert_allclose(colours, np.einsum("nk,nkc->nc", harmonics, sh[seen]), atol=1e-5)
    back, expected = sh.copy(), sh.astype(np.float64)
    for first, last in ((0, 4), (4, SEEN)):  # as threads share them
        spread(first, last, seen, single, colours, back)
    expected[seen] += harmonics[:, :, None] * colours[:, None, :]
    np.testing.assert_allclose(back, expected, atol=2e-5)
    squares = random.random(SEEN).astype(np.float32)
    diagonal, expected = np.ones((ALL, coefficients), np.float32), np.ones((ALL, coefficients))
    spread_squares(seen, single, squares, diagonal)
    expected[seen] += np.square(harmonics) * squares[:, None]
    np.testing.assert_allclose(diagonal, expected, atol=1e-5)
