# SPDX-License-Identifier: GPL-3.0-or-later
"""The Z-curve against bits interleaved one by one, and what it is for: neighbours lie near in memory."""

import numpy as np
import torch

from physhdr.backend.model.morton import BITS, morton_codes, morton_order


def code_by_hand(point, low, side):
    """Interleave the bits of one point's cell with integers of Python."""
    code = 0
    for axis in range(3):
        cell = min(int((point[axis] - low[axis]) / side * 2**BITS), 2**BITS - 1)
        for bit in range(BITS):
            code |= ((cell >> bit) & 1) << (3 * bit + axis)
    return code


def test_codes_are_interleaved_bits():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [1.0, 20.0, 0.1]
    low = points.min(axis=0)
    side = (points.max(axis=0) - low).max()
    expected = [code_by_hand(point, low, side) for point in points]
    assert morton_codes(torch.tensor(points)).tolist() == expected


def test_equal_points_keep_their_order():
    points = torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    assert morton_order(points).tolist() == [1, 3, 0, 2]
    assert morton_order(torch.zeros(5, 3)).tolist() == [0, 1, 2, 3, 4]
    assert morton_order(torch.zeros(0, 3)).tolist() == []


def test_neighbours_in_memory_are_neighbours_in_space():
    points = torch.rand(20_000, 3, generator=torch.Generator().manual_seed(0))

    def step(p):
        return (p[1:] - p[:-1]).norm(dim=1).median()

    assert step(points[morton_order(points)]) < 0.1 * step(points)
