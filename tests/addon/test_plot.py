# SPDX-License-Identifier: GPL-3.0-or-later
"""The training's curves as pixels."""

import numpy as np
import pytest

from physhdr.bridge.messages import History

pytest.importorskip("bpy", reason="needs Blender's Python")

from physhdr.addon.plot import HEIGHT, LOSS, MARGIN, PSNR, WIDTH, draw_curves


def heights(picture: np.ndarray, colour: tuple[float, ...]) -> np.ndarray:
    """Where a curve is in each column (from the bottom): the row nearest to its colour."""
    return np.abs(picture - np.array(colour, np.float32)).sum(axis=2).argmin(axis=0)


def test_a_loss_that_halves_at_every_step_falls_in_a_straight_line():
    steps = np.arange(1, 11)
    picture = draw_curves(History(iterations=tuple(100 * steps), losses=tuple(0.5**steps)))
    rows = heights(picture, LOSS)
    columns = np.arange(WIDTH // 10 + 1, WIDTH - 2)
    share = (columns / (WIDTH - 1) * 10 - 1) / 9  # of the way from the first iteration to the last
    expected = MARGIN + (1.0 - share) * (HEIGHT - 2 * MARGIN - 1)
    assert np.abs(rows[columns] - expected).max() <= 2


def test_each_curve_has_its_own_scale_and_begins_where_it_was_first_measured():
    history = History(
        iterations=(100, 200, 400),
        losses=(8.0, 4.0, 1.0),
        psnr_iterations=(200, 400),
        psnr=(20.0, 30.0),
    )
    picture = draw_curves(history)
    last = heights(picture[:, -1:], PSNR)[0], heights(picture[:, -1:], LOSS)[0]
    assert last[0] >= HEIGHT - MARGIN - 3 and last[1] <= MARGIN + 2
    blue = np.abs(picture - np.array(PSNR, np.float32)).sum(axis=2).min(axis=0) < 0.2
    assert not blue[: WIDTH // 2 - 2].any() and blue[WIDTH // 2 + 2 :].all()


def test_nothing_measured_is_an_empty_picture():
    empty = draw_curves(History())
    assert np.array_equal(empty, draw_curves(History(iterations=(20,), losses=(1.0,))))
