# SPDX-License-Identifier: GPL-3.0-or-later
"""Display colours seen from where a model was turned to."""

import numpy as np
import pytest

from physhdr.bridge.display import turned_colour_sh
from physhdr.bridge.spherical_harmonics import basis


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_turned_colour_is_the_same_from_the_turned_side(degree):
    random = np.random.default_rng(degree)
    sh = random.standard_normal((5, (degree + 1) ** 2, 3)).astype(np.float32)
    turn, _ = np.linalg.qr(random.standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turned = turned_colour_sh(sh, 2.5 * turn)  # a uniform scale turns nothing
    directions = random.standard_normal((40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.einsum("dk,nkc->dnc", basis(directions, degree), sh)
    after = np.einsum("dk,nkc->dnc", basis(directions @ turn.T, degree), turned)
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_under_a_shear_it_is_near():
    """Of degree 3 that vary mildly: a sheared colour is no spherical harmonics of any degree."""
    random = np.random.default_rng(4)
    sh = 0.1 * random.standard_normal((5, 16, 3)).astype(np.float32)
    shear = np.array([[1.0, 0.2, 0.0], [0.0, 0.8, 0.0], [0.0, 0.0, 1.0]])
    turned = turned_colour_sh(sh, shear)
    directions = random.standard_normal((200, 3))
    seen = directions @ shear.T
    directions, seen = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (directions, seen))
    before = np.einsum("dk,nkc->dnc", basis(directions, 3), sh)
    after = np.einsum("dk,nkc->dnc", basis(seen, 3), turned)
    assert np.sqrt(np.mean(np.square(after - before))) < 0.15 * before.std()
