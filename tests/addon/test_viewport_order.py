# SPDX-License-Identifier: GPL-3.0-or-later
"""Sorting by depth in numpy, against numpy's own stable sort."""

import numpy as np
import pytest

from physhdr.addon.viewport.depth_order import back_to_front


@pytest.mark.parametrize("count", [0, 1, 2, 1000, 100_000])
def test_exact_is_a_stable_sort_read_backwards(count: int):
    rng = np.random.default_rng(count)
    depth = np.round(rng.normal(3.0, 50.0, count), 1).astype(np.float32)  # many ties, some negative
    expected = np.argsort(depth, kind="stable")[::-1]
    np.testing.assert_array_equal(back_to_front(depth), expected)


def test_quick_is_right_to_a_65536th_of_the_range():
    depth = np.random.default_rng(0).uniform(0.0, 80.0, 50_000).astype(np.float32)
    order = back_to_front(depth, exact=False)
    assert sorted(order) == list(range(50_000))
    assert np.diff(depth[order]).max() < 1.01 * 80.0 / 65536.0


def test_equal_depths_are_no_problem():
    np.testing.assert_array_equal(back_to_front(np.full(4, 2.0, np.float32), exact=False), [3, 2, 1, 0])
