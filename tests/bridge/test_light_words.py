# SPDX-License-Identifier: GPL-3.0-or-later
"""Words for lights of a group of photos, and which lights they tell apart."""

import numpy as np
import pytest

from physhdr.bridge.errors import BadValueError
from physhdr.bridge.light_groups import LightGroup, LightGroups
from physhdr.bridge.light_report import light_report, never_apart
from physhdr.bridge.light_words import changes_in_name, light_change


@pytest.mark.parametrize(
    ("word", "level"),
    [("off", 0.0), ("On", 1.0), ("0.25", 0.25), ("2x", 2.0), ("50%", 0.5), ("evening", None)],
)
def test_a_word_is_a_level(word, level):
    change = light_change("pendant", word)
    assert change.level == level and change.is_alone == (level == 1.0)


@pytest.mark.parametrize(
    ("light", "word", "message"),
    [
        ("", "off", "'' is no name of a light"),
        ("12", "off", "'12' is no name of a light"),
        ("level", "off", "'level' is no name of a light"),
        ("pendant", "blue", "'blue' does not say what pendant does"),
        ("pendant", "-1", "'-1' does not say"),
        ("pendant", "", "'' does not say"),
        ("pendant", "1234567x", "'1234567x' does not say"),
    ],
)
def test_what_is_no_name_or_no_word(light, word, message):
    with pytest.raises(BadValueError) as caught:
        light_change(light, word)
    assert message in str(caught.value) and caught.value.hint


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("pendant off", ["pendant off"]),
        ("lamp_on", ["lamp on"]),
        ("Desk Lamp - OFF", ["Desk Lamp off"]),
        ("daylight.evening", ["daylight evening"]),
        ("desk_lamp_off + daylight evening", ["desk_lamp off", "daylight evening"]),
        ("pendant off and lamp 2x", ["pendant off", "lamp 2x"]),
        ("lamp-50%", ["lamp 50%"]),
        ("room 2", []),
        ("version 1.5", []),
        ("evening", []),
        ("masks", []),
        ("2 off", []),
        ("pendant off + rest", []),
    ],
)
def test_a_folders_name_says_which_light(name, said):
    assert [str(change) for change in changes_in_name(name)] == said


def groups(levels, standard=None):
    """Groups of one picture each, by the levels of ``ambient``, ``pendant`` and ``lamp``."""
    made = tuple(LightGroup(str(number), each, ("a",)) for number, each in enumerate(levels))
    return LightGroups(("ambient", "pendant", "lamp"), made, standard or {})


@pytest.mark.parametrize(
    ("levels", "standard", "together"),
    [
        ([{"pendant": 0.0}, {"lamp": 0.0}], {}, []),
        ([{"pendant": None}, {"lamp": 0.5}], {}, []),
        ([{"pendant": 1.0}, {"lamp": 1.0}], {"pendant": 0.0, "lamp": 0.0}, []),
        ([{"pendant": 0.0, "lamp": 0.0}], {}, [("pendant", "lamp")]),
        ([{"pendant": 0.0, "lamp": 0.0}, {"lamp": None}], {}, []),
        ([{"pendant": 0.5, "lamp": 0.5}, {"pendant": 2.0, "lamp": 2.0}], {}, [("pendant", "lamp")]),
        ([{"pendant": 0.0}], {}, [("ambient", "lamp")]),
        ([{"ambient": 0.0, "pendant": 0.0}, {"lamp": 0.0}], {}, [("ambient", "pendant")]),
        ([{"pendant": None, "lamp": None}], {}, [("pendant", "lamp")]),
        ([{"pendant": None, "lamp": None}, {"pendant": None}], {}, []),
        ([{"pendant": None, "lamp": None}] * 2, {}, [("pendant", "lamp")]),
    ],
)
def test_lights_that_always_change_together_are_not_told_apart(levels, standard, together):
    """As the linear system says: the light's own unit vector is no combination of the pictures' levels."""
    made = groups(levels, standard)
    assert never_apart(made) == together
    numbers = np.random.default_rng(3).uniform(0.1, 3.0, 9)
    rows = [made.standard_levels, *map(made.levels, made.groups)]
    matrix = np.array([[numbers[k] if v is None else v for v in row] for k, row in enumerate(rows)])
    for number, light in enumerate(made.lights):
        unit = np.eye(3)[number]
        solved = matrix.T @ np.linalg.lstsq(matrix.T, unit, rcond=None)[0]
        assert np.allclose(solved, unit) == all(light not in lights for lights in together)


def test_the_report_says_from_how_many_places_each_light_was_seen():
    lines, warnings = light_report(groups([{"pendant": 0.0}, {"lamp": None}]), {"0": 8, "1": 1})
    assert lines == [
        "pendant can be turned afterwards: off from 8 places",
        "lamp can be turned afterwards: at a level to be found from 1 place",
    ]
    assert not warnings
    lines, warnings = light_report(groups([{"pendant": 0.0, "lamp": 0.0}]), {"0": 8})
    assert not lines and len(warnings) == 1 and "pendant and lamp always change together" in warnings[0]
    lines, warnings = light_report(groups([{"pendant": 0.0}]), {"0": 3})
    assert len(lines) == 1 and warnings[0].startswith("lamp never changes: it cannot be turned")
