# SPDX-License-Identifier: GPL-3.0-or-later
"""Rates over a training, by its length."""

import math
from types import SimpleNamespace

import pytest
import torch

from physhdr.backend.train.optimisers import STOCK_3DGS, Optimiser, OptimiserConfig
from physhdr.backend.train.presets import PRESETS

GAUSSIANS = ("log_scales", "quaternions", "opacity_logits", "reflectance_dc", "reflectance_rest")


@pytest.mark.parametrize("name", GAUSSIANS)
def test_in_a_longer_training_rates_fall_with_the_third_power(name):
    """From the length that they are for: the same at an iteration, however long the training is."""
    config = OptimiserConfig(rates_for=2500)
    start = getattr(config, name)
    for iterations in (10_000, 40_000):
        rate = config.rate(name, iterations)
        course = [rate.at(done / iterations, 1.0) for done in (0, 2500, 5000, 10_000)]
        assert course == pytest.approx([start, start, start / 8.0, start / 64.0])


@pytest.mark.parametrize("name", GAUSSIANS)
@pytest.mark.parametrize("iterations", [1, 1250, 2500])
def test_in_one_as_long_or_shorter_they_stay(name, iterations):
    config = OptimiserConfig(rates_for=2500)
    assert config.rate(name, iterations).at(1.0, 1.0) == getattr(config, name)


def test_positions_and_networks_go_as_in_any_training():
    for name in ("means", "radiance_networks", "tone_mapper"):
        assert OptimiserConfig().rate(name, 10_000) == OptimiserConfig().rate(name, 100)


def test_3dgs_as_published_has_constant_rates():
    assert STOCK_3DGS.rate("log_scales", 10**6).at(1.0, 1.0) == STOCK_3DGS.log_scales
    assert PRESETS["paper"].optimiser.rates_for == PRESETS["gausshdr"].optimiser.rates_for == 0


def test_a_step_has_the_rate_of_its_iteration_and_clears_the_gradients():
    """Adam's first step is the rate itself; positions' is halfway the geometric mean of both ends."""
    means = torch.zeros(4, 3, requires_grad=True)
    groups = {"means": [means]}
    method = SimpleNamespace(
        parameter_groups=lambda: groups, rates=dict, network_groups=dict, adam_epsilon=1e-15
    )
    optimiser = Optimiser(method, OptimiserConfig(means=1e-2, means_final=1e-4), extent=3.0, iterations=100)
    means.grad = torch.tensor([0.5, -2.0, 1.0]).expand(4, 3).clone()
    optimiser.step(50)
    rate = 3.0 * math.sqrt(1e-2 * 1e-4)
    assert means.grad is None
    assert torch.allclose(means, torch.tensor([-rate, rate, -rate]).expand(4, 3), rtol=1e-5)
