# SPDX-License-Identifier: GPL-3.0-or-later
"""Known encodings: both ways, in NumPy and in torch, and how fine their codes are."""

import math

import numpy as np
import pytest
import torch

from physhdr.backend.scene.encoding import CAMERA, SRGB, LogEncoding, eight_bits
from physhdr.bridge.errors import BadValueError

LOG = LogEncoding(3.0)


@pytest.mark.parametrize("encoding", [SRGB, LOG], ids=str)
def test_torch_encodes_as_numpy_and_its_gradient_is_right(encoding):
    exposed = np.concatenate([[0.0], np.logspace(-4, -0.01, 60), [3.0, 40.0]])
    x = torch.tensor(exposed, requires_grad=True)
    assert np.allclose(encoding.developed(x).detach().numpy(), encoding.encode(exposed), atol=1e-12)
    inside = torch.tensor(np.logspace(-3.5, -0.05, 25), requires_grad=True)
    assert torch.autograd.gradcheck(encoding.developed, (inside,))


def test_what_is_drawn_too_bright_knows_its_way_back():
    """Above white a clipped picture is content, one that is not clipped pulls; below both see one curve."""
    exposed = torch.tensor([0.3, 2.0, 2.0], dtype=torch.float64, requires_grad=True)
    values = torch.tensor([1.0, 0.9, 1.0], dtype=torch.float64)
    towards = SRGB.towards(exposed, values)
    towards.sum().backward()
    above = 1.055 * 2.0 ** (1 / 2.4) - 0.055
    assert towards.detach().numpy() == pytest.approx([1.055 * 0.3 ** (1 / 2.4) - 0.055, above, 1.0])
    assert exposed.grad.numpy() == pytest.approx(
        [1.055 / 2.4 * 0.3 ** (1 / 2.4 - 1), 1.055 / 2.4 * 2.0 ** (1 / 2.4 - 1), 0.0]
    )
    assert torch.equal(LOG.towards(exposed, values), LOG.developed(exposed))


def test_the_curves_are_their_formulas():
    """sRGB by IEC 61966-2-1, clipped; the logarithm is 1 at its scale and goes on above."""
    assert SRGB.encode(np.array([0.002, 0.5, 1.0, 7.0])) == pytest.approx(
        [12.92 * 0.002, 1.055 * 0.5 ** (1 / 2.4) - 0.055, 1.0, 1.0], abs=1e-9
    )
    assert LOG.encode(np.array([0.0, 3.0, 30.0, -1.0])) == pytest.approx(
        [0.0, 1.0, math.log(50001.0) / math.log(5001.0), 0.0], abs=1e-12
    )


def test_codes_of_radiance_are_fine_and_none_clips():
    """Over 24 stops a code is a step of less than 0.1 %, near black of 1e-7 of the scale."""
    exposed = LOG.scale * np.logspace(math.log10(2e-4), math.log10(5000.0), 2000)
    codes = LOG.codes(exposed)
    assert codes.dtype == np.uint16 and codes.max() < 65535 and (np.diff(codes.astype(int)) >= 0).all()
    assert np.abs(LOG.exposed(codes) / exposed - 1.0).max() < 1e-3
    bright = exposed > 0.01 * LOG.scale
    assert np.abs(LOG.exposed(codes) / exposed - 1.0)[bright].max() < 1.5e-4
    assert LOG.exposed(np.zeros(1, np.uint16)) == 0.0


def test_linear_pictures_survive_their_16_bits():
    """Clips exactly at 1; below, half a step of the sRGB curve at 16 bits."""
    linear = np.linspace(0.0, 1.0, 5001)
    codes = SRGB.codes(np.append(linear, 1.5))
    assert codes[-1] == codes[-2] == 65535
    assert np.abs(SRGB.exposed(codes[:-1]) - linear).max() < 2e-5


def test_a_scale_must_be_positive_and_a_camera_has_no_formula():
    with pytest.raises(BadValueError):
        LogEncoding(0.0)
    with pytest.raises(BadValueError):
        CAMERA.decode(np.zeros(3))


def test_sixteen_bits_become_the_nearest_eight():
    codes = np.arange(65536).astype(np.uint16)
    assert np.array_equal(eight_bits(codes), np.rint(codes / 257.0).astype(np.uint8))
    assert eight_bits(np.zeros((2, 2), np.uint8)).dtype == np.uint8
