# SPDX-License-Identifier: GPL-3.0-or-later
"""A splat's limits: what they are to each other. That all pictures agree is shown where they are drawn."""

import math

import pytest

from physhdr.bridge import splatting


def test_a_splat_ends_at_three_and_a_third_standard_deviations() -> None:
    assert math.exp(-0.5 * 3.33**2) == pytest.approx(splatting.ALPHA_MIN, rel=5e-3)


def test_the_largest_alpha_does_not_end_a_ray_at_once() -> None:
    """One opaque Gaussian leaves some light of what is behind it, two leave none."""
    assert 1.0 - splatting.ALPHA_MAX > splatting.TRANSMITTANCE_MIN > (1.0 - splatting.ALPHA_MAX) ** 2
