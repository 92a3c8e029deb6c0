# SPDX-License-Identifier: GPL-3.0-or-later
"""What was never seen is guessed from its rim: smoothly, round the sphere, and linearly in the light."""

import numpy as np
import pytest

from physhdr.bridge import panorama
from physhdr.bridge.sphere_fill import filled

WIDTH = 128


def smooth(vectors: np.ndarray) -> np.ndarray:
    """A light that varies slowly over the sphere, ``[…, 3]``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([1.0 + 0.5 * x, 1.0 + 0.5 * y, 2.0 + z], axis=-1)


def cap(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """Coverage ``[H, W]`` with a hole of that radius round ``axis``."""
    axis_unit = np.array(axis) / np.linalg.norm(axis)
    return (panorama.directions(WIDTH) @ axis_unit < np.cos(np.radians(degrees))).astype(float)


def test_what_was_seen_stays_as_it_is():
    alpha = cap((1, 0, 0), 30)
    seen = smooth(panorama.directions(WIDTH))
    whole = filled((seen * alpha[..., None])[None], alpha)[0]
    assert np.array_equal(whole[alpha == 1.0], seen[alpha == 1.0])


def test_a_constant_light_is_whole_again_whatever_was_seen_of_it():
    rng = np.random.default_rng(3)
    alpha = np.where(cap((0, 1, 1), 60) > 0, rng.uniform(0.01, 1.0, (WIDTH // 2, WIDTH)), 0.0)
    colour = np.array([0.5, 3.0, 800.0])
    whole = filled((alpha[..., None] * colour)[None], alpha)[0]
    assert whole == pytest.approx(np.broadcast_to(colour, whole.shape), rel=1e-9)


@pytest.mark.parametrize("axis", [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (-1, 0.02, 1)])
def test_a_hole_takes_its_colours_from_its_rim_wherever_it_is(axis):
    # A hole of 20 degrees in a linear function: its own mean is that of its rim within a tenth of the range,
    # in the middle of the picture, across its two ends, and at the poles.
    alpha = cap(axis, 20)
    true = smooth(panorama.directions(WIDTH))
    whole = filled((true * alpha[..., None])[None], alpha)[0]
    assert np.abs(whole - true).max() < 0.1
    # No edge stands out: neighbours differ no more than the light itself does from pixel to pixel, and then
    # a little, across the picture's ends as well.
    steps = np.abs(whole - np.roll(whole, 1, axis=1))
    assert steps.max() < 3.0 * np.abs(true - np.roll(true, 1, axis=1)).max()


def test_parts_that_are_filled_add_up_to_the_sum_that_is_filled():
    rng = np.random.default_rng(0)
    alpha = rng.uniform(0.0, 1.0, (WIDTH // 2, WIDTH)) * cap((0, 1, 0), 70)
    parts = rng.uniform(0.0, 5.0, (3, WIDTH // 2, WIDTH, 3)) * alpha[..., None]
    together = filled(parts.sum(0, keepdims=True), alpha)[0]
    assert filled(parts, alpha).sum(0) == pytest.approx(together, rel=1e-9, abs=1e-12)


def test_a_lamp_beside_a_hole_does_not_light_it():
    # Of a white wall and a lamp of 6 degrees a thousand times as bright, at the rim of half a sphere unseen.
    alpha = cap((0, -1, 0), 90)
    lamp = panorama.directions(WIDTH) @ np.array([0.0, np.sin(0.2), np.cos(0.2)]) > np.cos(np.radians(6.0))
    light = np.where(lamp[..., None], 1000.0, 1.0) * np.ones(3)
    whole = filled((light * alpha[..., None])[None], alpha)[0]
    unseen = whole[alpha == 0.0]
    assert unseen.min() >= 1.0 - 1e-9 and unseen.mean() < 1.5


def test_nothing_is_darker_or_brighter_than_what_was_seen_and_nothing_seen_is_black():
    alpha = cap((0, -1, 0), 75)
    lamp = np.where(panorama.directions(WIDTH)[..., :1] > 0.99, 1e6, 0.1)
    whole = filled((lamp * alpha[..., None])[None], alpha)[0]
    assert whole.min() >= 0.1 * (1 - 1e-9) and whole.max() == 1e6
    nothing = np.zeros((1, WIDTH // 2, WIDTH, 3))
    assert not filled(nothing, np.zeros((WIDTH // 2, WIDTH))).any()
