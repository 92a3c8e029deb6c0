# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an evaluation shows contrast that is lost, which one factor of alignment hides."""

import math

import pytest
import torch

from physhdr.backend.evaluate.linearity import VALUES, compared_values, linearity


def radiance(height: int = 40, width: int = 60) -> torch.Tensor:
    """Ten stops, every value another."""
    return torch.exp2(torch.linspace(-5.0, 5.0, 3 * height * width)).reshape(3, height, width)


def of(prediction: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None = None):
    found = linearity([compared_values(prediction, truth, mask)])
    assert found is not None
    return found


@pytest.mark.parametrize("gamma", [0.8, 1.0, 1.3])
def test_a_power_of_the_truth_has_its_exponent_as_slope(gamma: float) -> None:
    truth = radiance()
    found = of(2.0 * truth**gamma, truth)
    assert found.slope == pytest.approx(gamma, abs=1e-3)
    for each in found.bins:
        assert each.ratio == pytest.approx(2.0 * each.truth ** (gamma - 1.0), rel=2e-3)


def test_lamps_that_are_too_dark_are_in_the_last_bin_alone() -> None:
    truth = radiance()
    lamps = truth > truth.quantile(0.99)
    found = of(torch.where(lamps, 0.25 * truth, truth), truth)
    assert [each.ratio for each in found.bins] == pytest.approx([1.0] * 6 + [0.25], rel=0.02)
    assert found.bins[-1].low == 0.99 and "0.25" in str(found)


def test_few_wild_values_do_not_move_the_slope() -> None:
    truth = radiance()
    wild = truth.clone()
    wild[:, ::9, ::9] *= 1000.0
    assert of(wild, truth).slope == pytest.approx(1.0, abs=1e-6)


def test_what_is_not_compared_does_not_count() -> None:
    truth = radiance()
    mask = torch.zeros(truth.shape[1:], dtype=torch.bool)
    mask[:, :30] = True
    wrong = truth.clone()
    wrong[:, :, 30:] = 0.0
    assert of(wrong, truth, mask).slope == pytest.approx(1.0)
    assert linearity([compared_values(truth, truth, mask & False)]) is None and linearity([]) is None
    assert linearity([compared_values(truth, 0.0 * truth, None)]) is None
    assert math.isnan(of(truth * 0.0 + 3.0, truth * 0.0 + 1.0).slope)  # one brightness has no slope


def test_large_pictures_are_sampled() -> None:
    truth = radiance(500, 700)
    values = compared_values(truth, truth, None)
    assert VALUES / 2 < len(values.truth) <= VALUES
    assert of(truth**0.9, truth).slope == pytest.approx(0.9, abs=1e-3)
