# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras and pictures are copied to where the computation is once, and the same every time."""

import numpy as np
import torch

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.resident import Pictures, camera_tensors


def test_cameras_and_pictures_are_copied_once(tiny_data):
    elsewhere = torch.device("meta")
    camera = Camera(np.eye(4), 4, 2, 4.0, 5.0, 2.0, 1.0)
    like = torch.zeros(1, device=elsewhere)
    assert camera_tensors(camera, like) is camera_tensors(camera, like)
    here = camera_tensors(camera, torch.zeros(1, dtype=torch.float64))
    assert here.intrinsics.tolist() == [[4, 0, 2], [0, 5, 1], [0, 0, 1]] and here.half_size.tolist() == [2, 1]

    view = read_scene(tiny_data).train[0]
    size = view.image(0).nbytes
    pictures = Pictures(elsewhere, budget=2 * size)
    for k in (0, 1, 2, 0):
        assert pictures.get(view, k).shape == (3, 32, 32)
    assert pictures.bytes_held == 2 * size  # the third did not fit
    found = Pictures(torch.device("cpu")).get(view, 2)
    np.testing.assert_array_equal(found.numpy(), view.image(2).transpose(2, 0, 1) / np.float32(255))
