# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of confidence against truth, on errors that are drawn from what the confidence says."""

import json

import numpy as np
import pytest

from physhdr.backend.evaluate.confidence import calibration, log_error
from physhdr.bridge.confidence import TOLERANCE
from physhdr.bridge.errors import BadValueError


def test_errors_drawn_as_confidence_says_are_calibrated():
    """Weibull errors of shape 1.75 about b: within the tolerance with the probability that is claimed."""
    rng = np.random.default_rng(0)
    b = np.exp(rng.uniform(-4.5, 0.0, 200_000))
    error = b * rng.weibull(1.75, b.size)
    confidence = 1.0 - np.exp(-((TOLERANCE / b) ** 1.75))
    table = calibration(confidence, error)
    assert table.deviation < 0.006 and table.pixels == b.size
    # Medians of b over the outermost tenths of a log-uniform distribution: 4.05 apart in logarithms.
    assert table.ratio == pytest.approx(np.exp(-4.05), rel=0.05)
    # A confidence of something else says so.
    shuffled = calibration(rng.permutation(confidence), error)
    assert shuffled.ratio == pytest.approx(1.0, abs=0.1) and shuffled.deviation > 0.2


def test_the_error_is_a_mean_of_logarithms_without_a_common_factor():
    truth = np.full((3, 4, 4), 2.0)
    drawn = 3.0 * truth
    drawn[:, 0, 0] *= np.array([np.e, 1.0, 1.0 / np.e])
    error = log_error([drawn], [truth])
    assert error.shape == (16,)
    np.testing.assert_allclose(error, [2.0 / 3.0, *([0.0] * 15)], atol=1e-3)
    assert np.isfinite(log_error([np.zeros((3, 4, 4))], [truth])).all()


@pytest.mark.parametrize(("black", "ratio"), [(0.0, 1.0), (0.3, None), (0.6, None)])
def test_truth_may_be_black_in_any_part_of_a_picture(black, ratio):
    """A common factor is taken away, and what is black is drawn black."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.5, 2.0, (3, 1000))
    dark = np.arange(1000) < 1000 * black
    truth[:, dark] = 0.0
    error = log_error([1.02 * truth], [truth])
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    error[~dark] += 0.1
    table = calibration(np.where(dark, 0.0, 0.5), error)
    assert table.ratio == (None if ratio is None else pytest.approx(ratio))
    assert json.loads(json.dumps(table.described(), allow_nan=False))["ratio"] == table.ratio
    assert ("is not compared" in table.markdown()) == (ratio is None)


def test_of_black_alone_there_is_no_confidence_to_compare():
    with pytest.raises(BadValueError, match="confidence with is black"):
        log_error([np.ones((3, 4, 4))], [np.zeros((3, 4, 4))])


@pytest.mark.parametrize("factor", [1e-4, 0.03, 1.0, 1000.0])
def test_that_factor_may_be_any_and_black_stays_as_it_is(factor):
    """Rates of a tenth of a stop, by hand, in a picture of five decades whose darkest part is black."""
    truth = np.geomspace(1e-3, 1e2, 3 * 64).reshape(3, 8, 8)
    truth[:, 0] = 0.0
    np.testing.assert_allclose(log_error([factor * truth], [truth]), 0.0, atol=1e-9)
    drawn = truth.copy()
    drawn[:, -1] *= 2.0**0.1
    error = log_error([factor * drawn], [truth]).reshape(8, 8)
    np.testing.assert_allclose(error[-1], 0.1 * np.log(2.0), rtol=0.01)
    np.testing.assert_allclose(error[:-1], 0.0, atol=1e-9)
