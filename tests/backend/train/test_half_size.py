# SPDX-License-Identifier: GPL-3.0-or-later
"""Half-sized views: the same rays, averaged pictures, and when training uses them."""

import dataclasses

import numpy as np
import torch

from physhdr.backend.methods.base import Recording
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.begin import begin
from physhdr.backend.train.half_size import half_sized, halved
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step


def test_halving_averages_blocks_and_keeps_the_rays():
    camera = Camera(np.eye(4), 200, 136, 150.0, 140.0, 97.0, 70.0)
    picture = torch.rand(3, 136, 200, generator=torch.Generator().manual_seed(0))
    half, (small,) = halved(camera, [Recording(exposure=1.0, picture=picture)])
    small = small.picture
    assert small.shape == (3, half.height, half.width) == (3, 68, 100)
    blocks = picture.numpy().reshape(3, 68, 2, 100, 2).mean(axis=(2, 4))
    assert np.allclose(small.numpy(), blocks, atol=1e-6)
    # The ray through the middle of a block of four is the ray through the middle of the new pixel.
    assert np.isclose((20.0 - camera.cx) / camera.fx, (10.0 - half.cx) / half.fx)
    assert np.isclose((31.0 - camera.cy) / camera.fy, (15.5 - half.cy) / half.fy)
    assert half_sized(camera) is half  # what is kept for a camera must be found again


def test_odd_sizes_are_covered_and_small_ones_left_alone():
    camera = Camera.from_field_of_view(np.eye(4), 201, 151, 0.9)
    half, (small,) = halved(camera, [Recording(exposure=1.0, picture=torch.full((3, 151, 201), 0.25))])
    small = small.picture
    assert small.shape[1:] == (half.height, half.width) == (75, 100)
    assert torch.allclose(small, torch.tensor(0.25))
    tiny = Camera.from_field_of_view(np.eye(4), 100, 300, 0.9)
    recording = Recording(exposure=1.0, picture=torch.zeros(3, 300, 100))
    same, (left_alone,) = halved(tiny, [recording])
    assert same is tiny and left_alone is recording


def test_only_the_start_of_training_is_half_sized(tiny_data, monkeypatch):
    monkeypatch.setattr("physhdr.backend.train.half_size.SMALLEST_SIDE", 16)  # the tiny scene has 32 × 32
    config = dataclasses.replace(PRESETS["default"], iterations=10, half_size_until=0.3)
    state = begin(read_scene(tiny_data), config)
    widths = []
    draw = state.method.draw

    def watched(camera, *arguments, **named):
        widths.append(camera.width)
        return draw(camera, *arguments, **named)

    monkeypatch.setattr(state.method, "draw", watched)
    for _ in range(5):
        step(state)
    assert widths == [16, 16, 16, 32, 32]
