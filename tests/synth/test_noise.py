# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures of noise are told to be, against pictures whose noise and bias are known."""

import numpy as np
import pytest

from physhdr.synth import noise
from physhdr.synth.response import by_name

EXPOSURES = (0.5, 2.0, 8.0)


@pytest.fixture
def limit():
    """A smooth radiance [120, 100, 3], 0.02 to 2."""
    y, x = np.mgrid[0:120, 0:100] / 100.0
    return np.exp(2.3 * np.sin(5 * x[..., None] + [0.0, 1.0, 2.0]) * np.cos(3 * y[..., None]) - 1.6)


def noisy(picture, share, seed):
    return (picture * (1.0 + np.random.default_rng(seed).normal(0, share, picture.shape))).astype(np.float32)


def decibels(a, b):
    return -10.0 * np.log10(np.mean((a - b) ** 2))


def test_a_floor_of_the_limit_has_no_noise_of_its_halves(limit):
    """A truth 1 % beside its limit, told by two pictures with three times as much noise."""
    response = by_name("reinhard-gamma")
    bias = 0.01 * np.sign(np.sin(40.0 * limit))
    truth = (limit * (1.0 + bias)).astype(np.float32)
    halves = noisy(limit, 0.03, 1), noisy(limit, 0.03, 2)
    told = noise.floor_of_limit(truth, halves, response, EXPOSURES)
    for k, exposure in enumerate(EXPOSURES):
        true = decibels(response(truth.astype(np.float64) * exposure), response(limit * exposure))
        assert told["psnr"][k] == pytest.approx(true, abs=4.0 * told["psnr_error"][k])
        assert 0.0 < told["psnr_error"][k] < 0.6
    maximum = float(truth.max())
    true = decibels(noise.mu_law(truth, maximum), noise.mu_law(limit, maximum))
    assert told["hdr_psnr"] == pytest.approx(true, abs=4.0 * told["hdr_psnr_error"])
    # The mean of the halves, without the products, would tell of its own noise.
    mean = (halves[0] + halves[1]) / 2.0
    assert noise.floor(truth, mean, response, EXPOSURES)["psnr"][1] < told["psnr"][1] - 5.0


def test_the_error_of_such_a_floor_is_how_much_it_scatters(limit):
    response = by_name("reinhard-gamma")
    truth = (limit * 1.01).astype(np.float32)
    floors = [
        noise.floor_of_limit(
            truth, (noisy(limit, 0.03, 2 * k), noisy(limit, 0.03, 2 * k + 1)), response, (2.0,)
        )
        for k in range(24)
    ]
    scatter = np.std([floor["psnr"][0] for floor in floors], ddof=1)
    stated = np.mean([floor["psnr_error"][0] for floor in floors])
    assert stated == pytest.approx(scatter, rel=0.5)


def test_of_a_perfect_truth_the_floor_is_the_ceiling(limit):
    truth = limit.astype(np.float32)
    told = noise.floor_of_limit(truth, (truth, truth), by_name("srgb"), EXPOSURES)
    assert told["psnr"] == [noise.CEILING] * 3 and told["hdr_psnr"] == noise.CEILING


def test_a_picture_too_small_to_scatter_states_no_error(limit):
    truth, halves = limit[:12, :12].astype(np.float32), (noisy(limit[:12, :12], 0.3, 1),) * 2
    told = noise.floor_of_limit(truth, halves, by_name("srgb"), EXPOSURES)
    assert told["psnr_error"] == [noise.CEILING] * 3 and max(told["psnr"]) < noise.CEILING
