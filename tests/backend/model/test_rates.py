# SPDX-License-Identifier: GPL-3.0-or-later
"""How learning rates go, from their closed forms."""

import math

import pytest

from physhdr.backend.model.rates import Rate, require_rates
from physhdr.bridge.errors import BadValueError


def test_each_course_is_its_closed_form():
    falling = Rate(start=1e-2, final=1e-4, shape="exponential", of_extent=True)
    assert falling.at(0.5, extent=3.0) == pytest.approx(3.0 * math.sqrt(1e-2 * 1e-4))
    assert Rate(start=2.0, shape="cosine").at(1 / 3, 1.0) == pytest.approx(1.0 + math.cos(math.pi / 3))
    assert Rate(start=0.3).times(2.0).at(0.9, 7.0) == pytest.approx(0.6)
    late = Rate(start=0.8, falls_from=0.25)
    assert [late.at(progress, 7.0) for progress in (0.0, 0.25, 0.5)] == pytest.approx([0.8, 0.8, 0.1])


def test_a_rate_of_0_stays_and_one_below_is_refused():
    assert Rate(start=0.0, final=1e-6, shape="exponential").at(0.5, 1.0) == 0.0
    require_rates("optimiser", {"means": 0.0})
    with pytest.raises(BadValueError, match=r"--set optimiser\.context must be 0 or more, got -1"):
        require_rates("optimiser", {"means": 0.1, "context": -1.0})
