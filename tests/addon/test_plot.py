# SPDX-License-Identifier: GPL-3.0-or-later
"""The training's curves as pixels, and the numbers at their axes."""

import numpy as np
import pytest

from physhdr.bridge.messages import History

pytest.importorskip("bpy", reason="needs Blender's Python")

from physhdr.addon import plot
from physhdr.addon.plot import BOTTOM, HEIGHT, LEFT, LOSS, NUMBERS, PSNR, RIGHT, TOP, WIDTH, draw_curves

#: Of the frame that the curves are drawn in.
WIDE, TALL = WIDTH - LEFT - RIGHT - 1, HEIGHT - BOTTOM - TOP - 1


def heights(picture: np.ndarray, colour: tuple[float, ...]) -> np.ndarray:
    """Where a curve is in each column (from the bottom): the row nearest to its colour."""
    return np.abs(picture - np.array(colour, np.float32)).sum(axis=2).argmin(axis=0)


def inked(picture: np.ndarray, colour: tuple[float, ...]) -> np.ndarray:
    return np.abs(picture - np.array(colour, np.float32)).sum(axis=2) < 1e-6


def read(marks: np.ndarray) -> str:
    """What is written in a part of the picture (top row first), by comparison with every glyph."""
    text, column = "", 0
    columns = np.flatnonzero(marks.any(axis=0))
    rows = np.flatnonzero(marks.any(axis=1))
    if not len(columns):
        return ""
    glyphs = {
        name: np.kron(np.array([[mark == "1" for mark in line] for line in lines]), np.ones((3, 3))) > 0
        for name, lines in plot.FONT.items()
    }
    top = rows[0]
    column = columns[0]
    while column <= columns[-1]:
        for name, glyph in glyphs.items():
            ink = np.flatnonzero(glyph.any(axis=0))[0]  # a glyph may begin with empty columns
            for up in range(22):
                part = np.zeros(glyph.shape, bool)
                found = marks[max(top - up, 0) : top - up + 21, max(column - ink, 0) : column - ink + 15]
                part[: found.shape[0], : found.shape[1]] = found
                if top >= up and column >= ink and np.array_equal(part, glyph):
                    text += name
                    column += 18 - ink - 1
                    break
            else:
                continue
            break
        column += 1
    return text


def test_a_loss_that_halves_at_every_step_falls_in_a_straight_line():
    steps = np.arange(1, 11)
    picture = draw_curves(History(iterations=tuple(100 * steps), losses=tuple(0.5**steps)))
    rows = heights(picture, LOSS)
    columns = np.arange(LEFT + WIDE // 10 + 2, WIDTH - RIGHT - 3)
    share = ((columns - LEFT) / WIDE * 10 - 1) / 9  # of the way from the first iteration to the last
    expected = BOTTOM + (1.0 - share) * TALL
    assert np.abs(rows[columns] - expected).max() <= 2.5  # the lower edge of the stroke


def test_each_curve_has_its_own_scale_and_begins_where_it_was_first_measured():
    history = History(
        iterations=(100, 200, 400),
        losses=(8.0, 4.0, 1.0),
        psnr_iterations=(200, 400),
        psnr=(20.0, 30.0),
    )
    picture = draw_curves(history)[:, LEFT : WIDTH - RIGHT]
    last = heights(picture[:, -1:], PSNR)[0], heights(picture[:, -1:], LOSS)[0]
    assert last[0] >= HEIGHT - TOP - 4 and last[1] <= BOTTOM + 3
    blue = np.abs(picture - np.array(PSNR, np.float32)).sum(axis=2).min(axis=0) < 0.2
    assert not blue[: WIDE // 2 - 2].any()
    assert (~blue[WIDE // 2 + 2 :]).sum() < 6  # but where the other curve crosses it


def test_the_axes_say_iterations_quality_and_loss():
    """At the heights where the curves have these values; each in its colour, outside the curves' frame."""
    steps = np.arange(0, 2501, 100)
    quality, loss = 20.0 + 0.006 * steps, 0.2 * np.exp(-steps / 600.0)
    history = History(
        iterations=tuple(steps),
        losses=tuple(loss),
        psnr_iterations=tuple(steps),
        psnr=tuple(quality),
    )
    picture = draw_curves(history)
    left, right = (
        inked(picture[:, : LEFT - 2], PSNR)[::-1],
        inked(picture[:, WIDTH - RIGHT + 2 :], LOSS)[::-1],
    )
    below = inked(picture[: BOTTOM - 2], NUMBERS)[::-1]

    def at(marks, row, size=12):
        from_top = HEIGHT - 1 - round(float(row))
        return read(marks[max(from_top - size, 0) : from_top + size])

    for value in (20, 25, 30, 35):
        assert at(left, plot.row_of(value, quality)) == str(value)
    for value in (0.1, 0.01):
        assert at(right, plot.row_of(np.log(value), np.log(loss))) == f"{value:g}"
    for value, text in ((0, "0"), (1000, "1k"), (2000, "2k")):
        column = round(float(plot.column_of(value, 2500)))
        assert read(below[:, max(column - 20, 0) : column + 20]) == text


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0, 2500, [0, 1000, 2000]), (18.2, 33.8, [20, 25, 30]), (0, 7, [0, 2, 4, 6]), (5, 5, [])],
)
def test_numbers_at_an_axis_are_round(low, high, expected):
    assert plot.ticks(low, high) == pytest.approx(expected)


def test_a_logarithmic_axis_always_has_a_number():
    assert plot.powers(0.004, 2.0) == pytest.approx([0.01, 0.1, 1.0])
    assert plot.powers(0.011, 0.31) == pytest.approx([0.03, 0.1, 0.3])
    for low in np.geomspace(1e-4, 50.0, 40):
        found = plot.powers(low, 1.001 * low)
        assert found and all(low <= value <= 1.001 * low for value in found)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (500, "500"), (2500, "2.5k"), (30000, "30k"), (1e6, "1M"), (0.02, "0.02"), (0.005, ".005")],
)
def test_numbers_are_short(value, text):
    assert plot.short(value) == text and all(character in plot.FONT for character in text)


def test_nothing_measured_is_an_empty_frame():
    empty = draw_curves(History())
    assert np.array_equal(empty, draw_curves(History(iterations=(), losses=())))
    assert not inked(empty, LOSS).any() and not inked(empty, PSNR).any() and not inked(empty, NUMBERS).any()


def test_what_is_no_number_is_passed_over():
    """A perfect picture has an infinite PSNR: its point is left out, and no curve is lost for it."""
    whole = History(iterations=(1, 2, 4), losses=(0.5, 0.4, 0.2), psnr_iterations=(1, 4), psnr=(20.0, 30.0))
    holed = History(
        iterations=(1, 2, 3, 4),
        losses=(0.5, 0.4, float("nan"), 0.2),
        psnr_iterations=(1, 2, 4),
        psnr=(20.0, float("inf"), 30.0),
    )
    np.testing.assert_array_equal(draw_curves(whole), draw_curves(holed))
    nothing = draw_curves(History(iterations=(1, 4), losses=(float("nan"),) * 2))
    np.testing.assert_array_equal(nothing, draw_curves(History(iterations=(1, 4), losses=())))
