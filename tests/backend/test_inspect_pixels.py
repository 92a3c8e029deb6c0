# SPDX-License-Identifier: GPL-3.0-or-later
"""The dynamic range of a data set is counted picture by picture: as exact as it is told, in little memory."""

import math
import tracemalloc

import numpy as np
import pytest

from physhdr.backend.inspect.findings import Inspection
from physhdr.backend.inspect.pixels import LuminanceCounts, TrainingPixels


def told(*pictures):
    pixels, found = TrainingPixels(), Inspection("data")
    for picture in pictures:
        pixels.add_truth(picture)
    pixels.summarise(found)
    assert found.dynamic_range is not None
    return found.dynamic_range


@pytest.mark.parametrize("spread", [0.01, 2.0, 12.0])
def test_it_is_that_of_all_pixels_at_once(spread):
    rng = np.random.default_rng(0)
    pictures = [np.exp(rng.normal(k, spread, (40, 50, 3))).astype(np.float32) for k in range(5)]
    luminance = np.concatenate([p.astype(np.float64) @ [0.2126, 0.7152, 0.0722] for p in pictures])
    low, high = np.percentile(luminance, 1), luminance.max()
    measured = told(*pictures)
    assert measured.percentile_1 == pytest.approx(low, rel=3e-4) and measured.maximum == high
    assert measured.stops == pytest.approx(math.log2(high / low), abs=0.016)


@pytest.mark.parametrize("share", [0.0, 1.0, 37.5, 100.0])
@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_percentiles_are_numpys(share, count):
    values = np.exp(np.random.default_rng(count).normal(0.0, 6.0, count))
    counts = LuminanceCounts()
    for part in np.array_split(values, 3):
        counts.add(part)
    assert counts.percentile(share) == pytest.approx(np.percentile(values, share), rel=3e-4)
    assert counts.percentile(share) <= np.percentile(values, share) * (1.0 + 1e-6)


def test_black_and_what_is_below_it():
    picture = np.full((10, 10, 3), 2.0, np.float32)
    picture[0, :2] = -0.5
    measured = told(picture)
    assert measured.percentile_1 == 0.0 and measured.stops is None and measured.maximum == 2.0
    assert LuminanceCounts().percentile(1) == 0.0


def test_the_brightest_there_is_fits():
    measured = told(np.full((4, 4, 3), 1e12, np.float32), np.full((4, 4, 3), 1e-30, np.float32))
    assert measured.stops == pytest.approx(math.log2(1e42), abs=0.01)


def test_many_pictures_take_no_more_memory_than_one():
    picture = np.exp(np.random.default_rng(0).normal(size=(200, 200, 3)))
    pixels = TrainingPixels()
    pixels.add_radiance(picture, 1.0)
    tracemalloc.start()
    try:
        for _ in range(40):
            pixels.add_radiance(picture, 0.5)
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 100_000, "all of them are 12.8 MB"
    assert peak < 40 * 200 * 200 * 8 + (10 << 20)
