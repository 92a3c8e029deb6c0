# SPDX-License-Identifier: GPL-3.0-or-later
"""The search for a budget's iterations, against cost laws that are known in closed form."""

import numpy as np
import pytest

from physhdr.lab.benchmark.search import (
    CORRECTIONS,
    PILOT_ITERATIONS,
    TOLERANCE,
    Measurement,
    nearest,
    next_trial,
    note_on,
)


def searched(cost, seconds, known=None):
    """What stands at the end, and how many trainings it took (a pilot not counted)."""
    tried = []
    while (iterations := next_trial(seconds, known, tried)) is not None:
        measured = Measurement(iterations, cost(iterations))
        if known is None:
            known = measured
        else:
            tried.append(measured)
    return nearest(seconds, tried), len(tried)


LAWS = {
    "linear": lambda n: 0.02 * n,
    "a start, then linear": lambda n: 1.5 + 0.018 * n,
    "dearer with length": lambda n: 0.004 * n**1.25,
    "half at half resolution": lambda n: 0.01 * n + 0.015 * max(0.0, n - 300),
}


def stretched(n):
    """A start; Gaussians that grow from 20,000 to 60,000 in the first half, however long that is."""
    grown = np.minimum(np.arange(n) / (n / 2), 1.0)
    return 3.0 + float(np.sum(0.011 + 0.018 * grown))


@pytest.mark.parametrize("seconds", [60.0, 300.0])
def test_a_scout_saves_the_training_that_misses(seconds):
    """Twenty iterations cost 3.5 s here, seven times what they would of a long training."""
    spent = []

    def cost(n):
        spent.append(stretched(n))
        return spent[-1]

    found, _ = searched(cost, seconds)
    assert found.cpu_seconds == pytest.approx(seconds, rel=TOLERANCE)
    assert sum(spent) < 1.25 * seconds  # 2.4 and 2.7 times where the pilot alone is asked


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
@pytest.mark.parametrize("begin", [None, 1000])
def test_the_budget_is_met(law, begin):
    known = None if begin is None else Measurement(begin, law(begin))
    found, trainings = searched(law, 60.0, known)
    scouts = 0 if begin else 2
    assert found.cpu_seconds == pytest.approx(60.0, rel=TOLERANCE) and trainings <= scouts + 1 + CORRECTIONS


def test_linear_cost_needs_no_second_training():
    assert searched(LAWS["linear"], 60.0, Measurement(1000, 20.0)) == (Measurement(3000, 60.0), 1)


def test_noise_does_not_carry_the_search_away():
    """Measured on a busy machine: 172 iterations in 1.54 s and 233 in 1.55 s once led to 1204."""
    rng = np.random.default_rng(0)
    for _ in range(500):
        found, _ = searched(lambda n: 0.009 * n * rng.uniform(0.85, 1.15), 2.0, Measurement(60, 0.7))
        assert 0.7 < 0.009 * found.iterations / 2.0 < 1.4
    step = next_trial(2.0, Measurement(60, 0.7), [Measurement(172, 1.5405), Measurement(233, 1.5456)])
    assert step is not None and 233 < step < 330


def test_a_method_too_slow_for_the_pilot_trains_what_fits_and_says_so():
    found, trainings = searched(lambda n: 0.7 * n, 5.0)
    assert (found.iterations, trainings) == (7, 1)
    assert "7 iterations" in note_on(7) and note_on(PILOT_ITERATIONS) == ""
    assert searched(lambda n: 50.0 * n, 5.0)[0].iterations == 1
