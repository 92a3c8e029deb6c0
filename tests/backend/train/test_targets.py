# SPDX-License-Identifier: GPL-3.0-or-later
"""Statistics of pictures that are kept: the same training, and no more memory than was allowed."""

import dataclasses

import torch

from physhdr.backend.kernels import SsimTarget
from physhdr.backend.methods.base import Recording
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.targets import SsimTargets
from physhdr.backend.train.trainer import step


def losses(state, count):
    return [step(state)["rec"].item() for _ in range(count)]


def test_a_training_is_the_same_with_and_without(larger_data):
    config = dataclasses.replace(PRESETS["default"], iterations=16, half_size_until=0.25)
    found = []
    for budget in (1 << 28, 0):
        state = begin(read_scene(larger_data), config)
        state.data.targets.budget = budget
        found.append(losses(state, 16))
        assert (state.data.targets.bytes_held > 0) == (budget > 0)
    assert found[0] == found[1]


def test_what_is_kept_and_how_much():
    pictures = [torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(k)) for k in range(3)]
    recordings = [Recording(exposure=1.0, picture=picture) for picture in pictures]
    size = SsimTarget(pictures[0]).nbytes
    targets = SsimTargets(budget=2 * size)
    noted = [targets.noted(None, k, recording, False) for k, recording in enumerate(recordings)]
    first, second = ([each.ssim_target() for each in noted] for _ in range(2))
    assert [a is b for a, b in zip(first, second, strict=True)] == [True, True, False]
    assert targets.bytes_held == 2 * size
    for picture, target in zip(pictures, first, strict=True):
        assert torch.equal(target.image, picture)
    half = targets.noted(None, 0, Recording(exposure=1.0, picture=pictures[0][:, ::2, ::2]), True)
    assert half.ssim_target() is half.ssim_target() and targets.bytes_held < size  # the others are gone
    masked = dataclasses.replace(recordings[0], mask=torch.ones(20, 30, dtype=torch.bool))
    assert targets.noted(None, 0, masked, False) is masked
