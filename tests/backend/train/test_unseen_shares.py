# SPDX-License-Identifier: GPL-3.0-or-later
"""Shares where no photo under other light looked: neighbours of the same surface have them."""

import dataclasses

import numpy as np
import pytest
import torch

from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.backend.train.unseen_shares import LEAST, fill, filled, pixels_in

RNG = np.random.default_rng(0)


def wall(count, axis):
    """Points of a square whose normal is ``axis``."""
    points = RNG.uniform(0.0, 1.0, (count, 3))
    points[:, axis] = 0.0
    return points, np.eye(3)[[axis] * count]


def test_unseen_ones_have_the_share_of_their_surface():
    """A floor and a wall that meet in an edge, each with its own smooth share; one in four was not seen."""
    (floor, up), (side, ahead) = wall(600, 2), wall(600, 0)
    positions, normal = np.concatenate([floor, side]), np.concatenate([up, ahead])
    true = np.where(np.arange(1200) < 600, 0.2 + 0.2 * positions[:, 1], 0.7 - 0.2 * positions[:, 1])
    seen = np.where(RNG.uniform(size=1200) < 0.25, 0.0, RNG.uniform(5.0, 20.0, 1200))
    share = np.where(seen > 0.0, true, 0.5)[:, None, None].repeat(3, axis=2)
    found = filled(share, seen[:, None], positions, normal)[:, 0, 0]
    assert np.array_equal(found[seen > 10.0], true[seen > 10.0])
    error = np.abs(found - true)[seen == 0.0]
    assert np.median(error) < 0.01 and error.mean() < np.abs(0.5 - true).mean() / 5


def test_shares_stay_shares_and_lamps_that_nobody_saw_change_are_left():
    share = RNG.uniform(0.0, 0.5, (50, 2, 3))
    seen = np.stack([np.zeros(50), RNG.uniform(0.0, 9.0, 50)], axis=1)
    found = filled(share, seen, *wall(50, 1))
    assert (found >= LEAST * 0.99).all() and (found.sum(axis=1) <= 1.0 - LEAST * 0.99).all()
    assert np.array_equal(found[:, 0], share[:, 0].clip(LEAST))


def test_ambient_light_that_never_changes_is_all_the_rest(tiny_data):
    """With it and the lamp off, nothing shines; with the lamp alone off, what the photos show is left."""
    scene = read_scene(tiny_data)

    def at(view, lamp, group=""):
        return dataclasses.replace(view, lighting_levels=(1.0, lamp), standard_levels=(1.0, 1.0), group=group)

    train, lit = [at(view, 1.0) for view in scene.train], [at(scene.lit[1], 0.0, "lamp off")]
    scene = dataclasses.replace(scene, train=train, lit=lit, lights=("ambient", "lamp"))
    state = begin(scene, dataclasses.replace(PRESETS["default"], iterations=8))
    for _ in range(7):
        step(state)
    camera, method = train[0].camera, state.method
    standard, without = method.hdr(camera), method.hdr(camera, (1.0, 0.0))
    assert (method.hdr(camera, (0.0, 0.0)) > 0.05 * standard).float().mean() > 0.5
    fill(state)
    assert torch.allclose(method.hdr(camera), standard, rtol=1e-3, atol=1e-5)
    assert (method.hdr(camera, (0.0, 0.0)) < 1e-3 * standard + 1e-6).all()
    assert torch.allclose(method.hdr(camera, (1.0, 0.0)), without, rtol=0.3, atol=1e-3)


@pytest.fixture
def one_place(tiny_data):
    """A tiny capture with a lamp that is off in the standard views, and on in one photo alone."""
    scene = read_scene(tiny_data)

    def at(view, level, group=""):
        return dataclasses.replace(view, lighting_levels=(level,), standard_levels=(0.0,), group=group)

    lit = [at(scene.lit[1], 1.0, "lamp on")]
    return dataclasses.replace(scene, train=[at(view, 0.0) for view in scene.train], lit=lit)


def test_pixels_are_the_alpha_of_what_is_drawn(one_place):
    state = begin(one_place, dataclasses.replace(PRESETS["default"], iterations=8))
    camera = one_place.lit[0].camera
    alpha = state.method.preview(camera).alpha.sum().item()
    assert pixels_in(state, one_place.lit).sum().item() == pytest.approx(alpha, rel=1e-3)
    assert all(tensor.grad is None for tensor in state.method.backbone.parameters.values())


def test_it_happens_at_the_end_and_leaves_the_standard_light_alone(one_place):
    state = begin(one_place, dataclasses.replace(PRESETS["default"], iterations=8))
    for _ in range(7):
        step(state)
    camera, method = one_place.train[0].camera, state.method
    before, share = method.hdr(camera), method.gaussians.light_share.detach().clone()
    fill(state)
    assert not torch.allclose(method.gaussians.light_share, share)
    assert torch.allclose(method.hdr(camera), before, rtol=1e-3, atol=1e-5)
    lit = method.hdr(camera, 1.0)
    assert (lit >= before - 1e-6).all() and not torch.allclose(lit, before)
