# SPDX-License-Identifier: GPL-3.0-or-later
"""What the training views' pixels come to is that of all at once, in the memory of one view."""

import tracemalloc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from physhdr.synth import dataset, png
from physhdr.synth.progress import Report
from physhdr.synth.response import by_name
from physhdr.synth.training_radiance import TrainingRadiance

BRACKET = (0.125, 1.0, 8.0)


def of(views, bracket=BRACKET):
    found = TrainingRadiance(views[..., 0].size, bracket, by_name("srgb"))
    for view in views:
        found.add(view)
    return found


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 1), (1, 6, 17), (7, 10, 10), (150, 5, 9)])
@pytest.mark.parametrize("spread", [0.01, 2.0, 12.0])
def test_the_range_is_to_the_last_bit_that_of_all_pixels_at_once(shape, spread):
    views = np.exp(np.random.default_rng(0).normal(0.0, spread, (*shape, 3))).astype(np.float32)
    luminance = views.astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    found = of(views)
    assert found.percentile_1 == np.percentile(luminance, 1) and found.maximum == luminance.max()


@pytest.mark.parametrize("order", [1, -1])
def test_darkness_in_one_view_alone_counts(order):
    """Whether it comes first, where little is held, or last, where the rest has taken all places."""
    views = np.full((10, 10, 10, 3), 2.0, np.float32)
    views[0, 0, :5] = 0.0
    assert of(views[::order]).percentile_1 == pytest.approx(2.0)
    views[0, 1:3] = 0.0
    assert of(views[::order]).percentile_1 == 0.0


def test_what_the_bracket_loses():
    """sRGB is white from 0.998 on: of exposure × radiance, so that 8 is lost at 1/8 s and 7 is not."""
    views = np.zeros((4, 5, 5, 3), np.float32)
    views[0, 0, 0] = (0.0, 8.0, 0.0)
    views[1, 0, :2] = 7.0
    views[2, 0, :4] = (0.0, 0.0, 0.001)
    found = of(views)
    assert found.white == 1 / 100 and found.black == (100 - 1 - 2 - 4) / 100


@pytest.mark.long
def test_the_last_step_holds_one_view(tmp_path, small):
    """The training views' pixels as doubles would be 24 bytes each, and what follows from them more."""
    options = replace(small, views=60, lit_views=0, relit_views=0, samples=1, resolution=(64, 48))
    peaks = []

    class Watching(Report):
        def finishing(self, what):
            if what == "describing":
                tracemalloc.start()

        def say(self, line):
            if tracemalloc.is_tracing():
                peaks.append(tracemalloc.get_traced_memory()[1])
                tracemalloc.stop()

    dataset.make(tmp_path, options, Watching())
    pixels = 64 * 48 * len(list((tmp_path / "train_hdr").iterdir()))
    assert peaks[0] < 24 * pixels, f"{peaks[0] / pixels:.1f} bytes a pixel"


def test_points_are_cast_with_one_picture_at_a_time(tmp_path, small, monkeypatch):
    real, seen, held = png.read, [], []

    def read(path):
        picture = real(path)
        seen.append(weakref.ref(picture))
        held.append(sum(each() is not None for each in seen))
        return picture

    monkeypatch.setattr(png, "read", read)
    dataset.make(tmp_path, replace(small, views=12, lit_views=0, samples=1))
    assert len(held) >= 6 and max(held) <= 2  # one, and the one before it
