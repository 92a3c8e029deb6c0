# SPDX-License-Identifier: GPL-3.0-or-later
"""What a number of a user's file may be, and why: the reasons, computed."""

import math

import numpy as np
import pytest

from physhdr.bridge import limits
from physhdr.bridge.errors import BadValueError


def test_a_coordinate_at_the_end_is_kept_to_centimetres() -> None:
    assert np.spacing(np.float32(limits.FARTHEST)) == pytest.approx(0.0625)
    assert np.spacing(np.float32(5e6)) == 0.5  # UTM's northings


def test_sums_over_the_brightest_and_largest_picture_are_finite() -> None:
    assert np.finfo(np.float32).max > 3 * limits.MAX_PIXELS * limits.RADIANCE_MAX**2


def test_the_brightest_gaussian_under_the_largest_level_is_finite() -> None:
    assert np.isfinite(np.exp(np.float32(limits.LOG_RADIANCE_MAX)) * np.float32(limits.LEVEL.high))


def test_both_ends_are_allowed_and_nothing_beyond() -> None:
    for bounds in (limits.COORDINATE, limits.EXPOSURE, limits.LEVEL, limits.FOCAL_LENGTH):
        assert bounds.low in bounds and bounds.high in bounds
        for beyond in (
            np.nextafter(bounds.low, -math.inf),
            np.nextafter(bounds.high, math.inf),
            math.nan,
            math.inf,
        ):
            assert float(beyond) not in bounds
            with pytest.raises(BadValueError, match=r"a\.json: it is .+: it must be from .+\n  \w+"):
                bounds.check(float(beyond), "a.json: it")


def test_a_light_may_be_off_but_not_almost() -> None:
    assert [limits.check_level(level, "") for level in (0.0, 1e-6, 1.0, 1e6)] == [0.0, 1e-6, 1.0, 1e6]
    for level in (1e-7, 1e7, -1.0, math.nan, math.inf):
        with pytest.raises(BadValueError, match=r"lit/r_0: the level is .+: it must be 0, or from"):
            limits.check_level(level, "lit/r_0: the level")


@pytest.mark.parametrize("position", [(5e5, 5.3e6, 200.0), (0.0, 0.0, 3e38), (0.0, math.nan, 0.0)])
def test_a_position_that_is_too_far_says_to_recentre(position: tuple[float, float, float]) -> None:
    with pytest.raises(
        BadValueError, match=r"camera 3 is at \(.*must be from -1e\+06 to 1e\+06 m(.|\n)*origin"
    ):
        limits.check_position(position, "camera 3")
    limits.check_position((1e6, -1e6, 0.0), "camera 3")
