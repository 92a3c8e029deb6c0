# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control on hand-made Gaussians, where what must happen can be counted."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.methods.base import Drawn, MethodSetup
from physhdr.backend.methods.physhdr import PhysHDR
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.model.morton import morton_order
from physhdr.backend.rasterize import Rasterization
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.densify import (
    DensifyState,
    GaussiansConfig,
    densify,
    is_due,
    observe,
    reset_is_due,
    reset_opacity,
)
from physhdr.backend.train.growth import NoGaussiansLeftError, gradient_scaling
from physhdr.backend.train.optimisers import Optimiser
from physhdr.backend.train.presets import PRESETS


def test_it_is_due_every_so_often_strictly_between_the_first_and_the_last_iteration():
    config = GaussiansConfig(start=500, stop=0.5, every=100, reset_every=300)
    iterations = range(1, 2001)
    assert [i for i in iterations if is_due(i, 2000, config)] == [600, 700, 800, 900]
    assert [i for i in iterations if reset_is_due(i, 2000, config)] == [300, 600, 900]
    never = dataclasses.replace(config, reset_every=0)
    assert not any(reset_is_due(i, 2000, never) for i in iterations)


def make(count=8):
    config = PRESETS["default"]
    points = np.random.default_rng(0).normal(size=(count, 3))
    gaussians = initial_gaussians(
        points,
        np.zeros((count, 3)),
        sh_degree=1,
        opacity=0.5,
        ambient_share=0.5,
        context_size=0,
        seed=0,
    )
    method = PhysHDR(config.method, gaussians, MethodSetup((1.0, 0.73)))
    optimiser = Optimiser(method, config.optimiser, extent=1.0, iterations=100)
    for tensor in gaussians.parameters.values():  # one step, so that Adam has moments
        tensor.grad = torch.ones_like(tensor)
    optimiser.step(0)
    return method, optimiser


def control(method, optimiser, gradients, iteration=1, **changes):
    config = dataclasses.replace(GaussiansConfig(threshold=1.0, budget=0), **changes)
    state = DensifyState.empty(method.gaussians)
    state.gradient_sum += torch.tensor(gradients) * 3.0
    state.visits += 3.0  # the mean over visits is what counts
    return densify(method, optimiser, state, iteration, config, torch.Generator().manual_seed(0))


def test_small_ones_are_cloned_large_ones_split_and_transparent_ones_pruned():
    method, optimiser = make()
    g = method.gaussians
    with torch.no_grad():
        g.log_scales[0] = np.log(0.001)
        g.log_scales[1] = np.log(0.5)
        g.opacity_logits[2] = -10.0
    before = {name: tensor.detach().clone() for name, tensor in g.parameters.items()}
    state = control(method, optimiser, [2.0, 2.0, 2.0, 0.9, 0.0, 0.0, 0.0, 0.0])
    # 8, −1 pruned, +1 clone, −1 +2 split
    assert len(method.gaussians) == 9 == len(state.visits)
    copies = (g.means[:, None] == before["means"]).all(dim=2)  # [9, 8]: who sits where an old one sat
    assert copies.sum(dim=0).tolist() == [2, 0, 0, 1, 1, 1, 1, 1]
    children = ~copies.any(dim=1)
    assert torch.allclose(g.scales[children], torch.full((2, 3), 0.5 / 1.6))
    first, second = g.means[children]
    assert not torch.equal(first, second)
    assert (g.means[children] - before["means"][1]).norm(dim=1).max() < 5 * 0.5
    assert torch.equal(morton_order(g.means), torch.arange(9))  # neighbours in space lie side by side
    # Adam: old ones keep their moments, new ones start from nothing
    moments = optimiser.adam.state[g.means]["exp_avg"].abs()
    assert moments[children].max() == 0 and moments[copies[:, 3:].any(dim=1)].min() > 0
    original, clone = moments[copies[:, 0]]  # at the same place, the older one first
    assert original.min() > 0 and clone.max() == 0


def test_after_the_first_reset_the_oversized_go_and_those_split_count_by_their_children():
    method, optimiser = make()  # extent 1: the limit is 0.1
    with torch.no_grad():
        method.gaussians.log_scales.fill_(np.log(0.05))
        method.gaussians.log_scales[:4] = torch.tensor([0.12, 0.12, 0.2, 0.09]).log()[:, None]
    before = method.gaussians.means.detach().clone()
    gradients = [2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    control(method, optimiser, gradients, reset_every=1, iteration=2)
    copies = (method.gaussians.means[:, None] == before).all(dim=2)
    assert copies.sum(dim=0).tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    children = method.gaussians.scales[~copies.any(dim=1)]  # of 0.12 alone: 0.2 / 1.6 is too large
    assert torch.allclose(children, torch.full((2, 3), 0.12 / 1.6))


def test_where_none_would_be_left_it_says_so_and_changes_nothing():
    method, optimiser = make()  # extent 1: the limit is 0.1
    with torch.no_grad():
        method.gaussians.log_scales.fill_(np.log(0.5))
        method.gaussians.opacity_logits[:3] = -10.0
        method.gaussians.log_scales[:3] = np.log(0.01)
    before = {name: tensor.detach().clone() for name, tensor in method.gaussians.parameters.items()}
    with pytest.raises(
        NoGaussiansLeftError, match=r"all 8 Gaussians: 5 as larger than 0\.1 m, 3 as "
    ) as error:
        control(method, optimiser, [0.0] * 8, reset_every=1, iteration=2)
    assert "--set backbone.reset_every=0" in error.value.hint
    for name, tensor in method.gaussians.parameters.items():
        assert torch.equal(tensor, before[name])
    control(method, optimiser, [0.0] * 8, reset_every=0, iteration=2)  # as the hint says
    assert len(method.gaussians) == 5


def test_the_budget_goes_to_the_largest_gradients():
    method, optimiser = make()
    with torch.no_grad():
        method.gaussians.log_scales.fill_(np.log(0.001))
    before = method.gaussians.means.detach().clone()
    control(method, optimiser, [5.0, 2.0, 9.0, 3.0, 0.0, 0.0, 0.0, 0.0], budget=10)
    assert len(method.gaussians) == 10
    copies = (method.gaussians.means[:, None] == before).all(dim=2).sum(dim=0)
    assert copies.tolist() == [2, 1, 2, 1, 1, 1, 1, 1]


def test_gradient_scaling_is_equation_17():
    deviation = torch.tensor([0.0, 1.0, 100.0])
    expected = torch.tensor([1.5, 1.0 + 1.0 / (1.0 + math.exp(-1.0)), 2.0])
    assert torch.allclose(gradient_scaling(deviation, 1.0), expected)
    assert torch.equal(gradient_scaling(deviation, 0.0), torch.ones(3))


def test_a_views_gradient_counts_as_much_as_its_light_deviates():
    """Half the width is 20 pixels, half the height 10: |(6, 8)| = 10. The last one is not on the screen."""
    method, _ = make(count=4)
    image = Rasterization(torch.zeros(3, 20, 40), torch.zeros(20, 40), torch.tensor([4.0, 4.0, 4.0, 0.0]))
    deviation = torch.tensor([0.0, math.log(3.0), 100.0, 0.0])  # σ: 1/2, 3/4, 1
    drawn = Drawn(splats=None, rasterization=image, illumination_deviation=deviation)
    camera = Camera.from_field_of_view(np.eye(4), 40, 20, 0.9)
    gradient = torch.tensor([[0.3, 0.8]]).repeat(4, 1)
    for changes, wanted in [
        ({}, [10.0, 10.0, 10.0, 0.0]),
        ({"scaling_strength": 2.0}, [20.0, 25.0, 30.0, 0.0]),
    ]:
        state = DensifyState.empty(method.gaussians)
        observe(state, gradient, drawn, camera, GaussiansConfig(**changes))
        assert state.gradient_sum.tolist() == pytest.approx(wanted)
        assert state.visits.tolist() == [1.0, 1.0, 1.0, 0.0]


def test_an_opacity_reset_lowers_and_never_raises():
    method, optimiser = make()
    with torch.no_grad():
        method.gaussians.opacity_logits[0] = -9.0
    reset_opacity(method, optimiser)
    opacities = method.gaussians.opacities
    assert torch.allclose(opacities[1:], torch.tensor(0.01)) and opacities[0] < 0.001
    assert optimiser.adam.state[method.gaussians.opacity_logits]["exp_avg"].abs().max() == 0
