# SPDX-License-Identifier: GPL-3.0-or-later
"""Products with blend weights against dense matrices in float64."""

import numpy as np

from physhdr.backend.kernels.blending import blend, gather, gather_squares, spread, toward_camera

PIXELS, SEEN, ALL, COEFFICIENTS = 37, 11, 29, 9


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


def test_toward_camera_and_its_transpose():
    random = np.random.default_rng(2)
    seen = np.sort(random.choice(ALL, SEEN, replace=False))
    basis = random.standard_normal((SEEN, COEFFICIENTS)).astype(np.float32)
    sh = random.standard_normal((ALL, COEFFICIENTS, 3)).astype(np.float32)
    colours = np.empty((SEEN, 3), np.float32)
    toward_camera(seen, basis, sh, colours)
    np.testing.assert_allclose(
        colours, np.einsum("nk,nkc->nc", basis.astype(np.float64), sh[seen]), atol=1e-5
    )
    back, expected = sh.copy(), sh.astype(np.float64)
    for first, last in ((0, 4), (4, SEEN)):  # as threads share them
        spread(first, last, seen, basis, colours, back)
    expected[seen] += basis[:, :, None] * colours[:, None, :]
    np.testing.assert_allclose(back, expected, atol=1e-5)
