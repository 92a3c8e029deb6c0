# SPDX-License-Identifier: GPL-3.0-or-later
"""What the files of a split tell, and what of a data set is measured."""

import pytest

from physhdr.bridge.contents import lost_at_the_ends, split_contents, stops_between


def test_a_frame_has_its_exposures_by_their_places_and_its_levels() -> None:
    frames = [
        {"file_path": "./lit/r_7", "lighting_level": 0.25},
        {"file_path": "lit/r_8.png", "lighting_level": 1.0, "lighting_levels": {"pendant": 2.0}},
        {"file_path": "./lit/front"},
        {"no": "name"},
    ]
    exposures = {"./lit/r_7_1.png": 2, "./lit/r_7_0.png": 0.5, "lit/r_8_0.png": 0.5, "lit/r_8_1.png": "x"}
    found = split_contents({"frames": frames}, exposures)
    assert [frame.stem for frame in found.frames] == ["lit/r_7", "lit/r_8", "lit/front"]
    assert [frame.index for frame in found.frames] == [7, 8, 2]
    assert [frame.levels for frame in found.frames] == [{"ambient": 0.25}, {"pendant": 2.0}, {}]
    assert [frame.seconds for frame in found.frames] == [{0: 0.5, 1: 2.0}, {0: 0.5}, {}]
    assert found.pictures == {"lit/r_7_1.png": 2.0, "lit/r_7_0.png": 0.5, "lit/r_8_0.png": 0.5}
    assert found.wrong == {"lit/r_8_1.png": "x"}


@pytest.mark.parametrize("junk", [{}, {"frames": 3}, {"frames": [None, 3, {"file_path": 3}]}])
def test_what_cannot_be_understood_is_left_out(junk: dict) -> None:
    assert split_contents(junk, {}).frames == []


def test_the_dynamic_range_is_from_the_first_percentile_to_the_maximum() -> None:
    assert stops_between(2.0, 2.0) == 0.0
    assert stops_between(1.0, 100.0) == 6.64  # log2(100)
    assert stops_between(0.0, 1.0) is None


def test_what_is_lost_is_told_from_a_twentieth_on() -> None:
    assert list(lost_at_the_ends(0.05, None)) == []
    assert list(lost_at_the_ends(0.5, 0.06)) == [
        ("50% of the training pixels are white even at the shortest exposure", "shorter"),
        ("6% of the training pixels are black even at the longest exposure", "longer"),
    ]
