# SPDX-License-Identifier: GPL-3.0-or-later
"""``lights.json``: what is written is read, who belongs to a group, and what is refused by name."""

import json

import pytest

from physhdr.bridge.errors import BadValueError, DataMismatchError, PhysHDRError
from physhdr.bridge.light_groups import FILE, LightGroup, LightGroups, read_light_groups, write_light_groups

ROOM = LightGroups(
    ("pendant", "daylight", "flash"),
    (
        LightGroup("pendant off", {"pendant": 0.0}, ("train_040", "train_041")),
        LightGroup("evening", {"daylight": None}, ("evening/*", "dusk [2].jpg")),
        LightGroup("flash on", {"flash": 1.0}, ("IMG_0100.JPG",)),
    ),
    {"flash": 0.0},
)


def test_what_is_written_is_read(tmp_path):
    write_light_groups(tmp_path, ROOM)
    assert read_light_groups(tmp_path) == ROOM
    assert read_light_groups(tmp_path / "elsewhere") is None


def test_lights_that_a_group_does_not_name_are_as_in_the_standard():
    assert ROOM.standard_levels == (1.0, 1.0, 0.0)
    assert [ROOM.levels(group) for group in ROOM.groups] == [
        (0.0, 1.0, 0.0),
        (1.0, None, 0.0),
        (1.0, 1.0, 1.0),
    ]


@pytest.mark.parametrize(
    ("pose", "pictures", "group"),
    [
        ("train_040", ("train_040_0.png", "train_040_2.png"), "pendant off"),
        ("train_042", ("train_042_0.png",), None),
        ("evening/IMG_7.jpg", (), "evening"),
        ("dusk [2].jpg", (), "evening"),
        ("IMG_0100", ("IMG_0100.JPG",), "flash on"),
    ],
)
def test_a_pose_goes_by_its_name_or_its_pictures(pose, pictures, group):
    found = ROOM.group_of(pose, pictures)
    assert (found and found.name) == group


def test_a_picture_in_two_groups_is_refused():
    twice = LightGroups(
        ("a", "b"), (LightGroup("one", {"a": 0.0}, ("x*",)), LightGroup("two", {"b": 0.0}, ("*y",)))
    )
    with pytest.raises(DataMismatchError, match="'xy' is in two groups, 'one' and 'two'"):
        twice.group_of("xy")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, "version 1"),
        ({"lights": ["pendant", "pendant"]}, "twice"),
        ({"standard": {"flash": -1}}, "standard: flash has the level -1"),
        ({"standard": {"flash": None}}, "standard: flash has the level None"),
        ({"standard": 3}, "not an object"),
        ({"groups": []}, "at least one group"),
        ({"groups": [{"levels": {"pendant": 0}, "pictures": ["a"]}]}, "has no name"),
        ({"groups": [{"name": "g", "levels": {}, "pictures": ["a"]}]}, "names no light"),
        ({"groups": [{"name": "g", "levels": {"sun": 0}, "pictures": ["a"]}]}, "no light 'sun'"),
        ({"groups": [{"name": "g", "levels": {"pendant": "off"}, "pictures": ["a"]}]}, "the level 'off'"),
        ({"groups": [{"name": "g", "levels": {"pendant": 0}, "pictures": []}]}, "a list of names"),
        (
            {"groups": [{"name": "g", "levels": {"pendant": 0}, "pictures": ["a"]}] * 2},
            "two groups are named 'g'",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, change, words):
    write_light_groups(tmp_path, ROOM)
    content = json.loads((tmp_path / FILE).read_text(encoding="utf-8"))
    (tmp_path / FILE).write_text(json.dumps(content | change), encoding="utf-8")
    with pytest.raises(BadValueError, match=words) as caught:
        read_light_groups(tmp_path)
    assert isinstance(caught.value, PhysHDRError) and caught.value.hint
