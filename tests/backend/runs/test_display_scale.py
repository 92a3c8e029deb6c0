# SPDX-License-Identifier: GPL-3.0-or-later
"""The unit of photographs' radiance: what is developed as sRGB is as bright as the photo was."""

import numpy as np
import pytest
import torch

from physhdr.backend.runs.display_scale import WIDTH, display_scale
from physhdr.backend.scene.camera import Camera
from physhdr.bridge import srgb


class Photo:
    """A method whose camera has ``response`` of exposure × radiance, some of it brighter than white."""

    def __init__(self, response) -> None:
        self.response = response

    def hdr(self, camera: Camera) -> torch.Tensor:
        return torch.linspace(0.001, 40.0, camera.height * camera.width).reshape(1, camera.height, -1)

    def ldr(self, camera: Camera, exposure: float) -> torch.Tensor:
        return torch.from_numpy(self.response(exposure * self.hdr(camera).double().numpy()))


CAMERA = Camera(np.eye(4), 2 * WIDTH, WIDTH, 100.0, 100.0, WIDTH, WIDTH / 2)


@pytest.mark.parametrize("factor", [1.0, 0.214, 5.0])
def test_a_camera_that_develops_as_a_display_has_its_unit_found(factor):
    """A closed form: its codes are sRGB's of ``factor`` times the exposed radiance."""
    camera = Photo(lambda exposed: srgb.to_srgb(np.clip(factor * exposed, 0.0, 1.0)))
    assert display_scale(camera, CAMERA, 0.05) == pytest.approx(factor, rel=2e-3)


def test_of_another_curve_the_mean_code_is_the_photos():
    photo = Photo(lambda exposed: exposed**1.4 / (exposed**1.4 + 0.6))
    scale = display_scale(photo, CAMERA, 0.05)
    shown = srgb.to_srgb(np.clip(0.05 * scale * photo.hdr(CAMERA).double().numpy(), 0.0, 1.0))
    assert abs(shown.mean() - float(photo.ldr(CAMERA, 0.05).mean())) < 1.0 / 255.0
    assert abs(np.log2(scale)) > 0.2


@pytest.mark.parametrize("code", [0.0, 1.0])
def test_black_or_white_tells_nothing(code):
    assert display_scale(Photo(lambda exposed: np.full_like(exposed, code)), CAMERA, 0.05) == 1.0
