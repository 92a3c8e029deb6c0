# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of a model's photographs in its metadata: written, read, and refused where it means nothing."""

import dataclasses
import json

import pytest

from physhdr.bridge.errors import BadValueError
from physhdr.bridge.model_file import read_model, write_model
from physhdr.bridge.photographed_light import (
    PHOTOGRAPHED_LIGHT,
    PhotographedLight,
    photographed_light,
    photographed_light_text,
)

from .test_model_file import make_model

LIGHTS = ("ambient", "pendant", "flash")


def with_light(text: str):
    return dataclasses.replace(make_model(lights=LIGHTS), metadata={PHOTOGRAPHED_LIGHT: text})


def test_a_model_file_says_under_which_light_it_was_photographed(tmp_path):
    evening = PhotographedLight("evening", {"ambient": 0.2, "flash": 0.0}, {"ambient": "estimated"})
    text = photographed_light_text([PhotographedLight("standard", {"ambient": 1.0, "flash": 0.0}), evening])
    write_model(tmp_path / "room.safetensors", with_light(text))
    kept = read_model(tmp_path / "room.safetensors")
    assert kept.standard_levels == (1.0, 1.0, 0.0)
    assert photographed_light(kept.metadata)[1] == evening and evening.of(LIGHTS) == (0.2, 1.0, 0.0)


def test_without_it_all_lights_are_at_1():
    assert make_model(lights=LIGHTS).standard_levels == (1.0, 1.0, 1.0)
    assert photographed_light_text([PhotographedLight("standard", dict.fromkeys(LIGHTS, 1.0))]) == ""


@pytest.mark.parametrize(
    "text",
    [
        "[",
        "{}",
        "[]",
        "[1]",
        '[{"name": "standard"}]',
        '[{"name": "a\\nb", "levels": {}}]',
        '[{"name": "standard", "levels": {"flash": -1}}]',
        '[{"name": "standard", "levels": {"flash": "off"}}]',
        '[{"name": "standard", "levels": {"flash": 1e9}}]',
        '[{"name": "evening", "levels": {"flash": 0.5}, "found": {"flash": "guessed"}}]',
        '[{"name": "evening", "levels": {}, "found": []}]',
    ],
)
def test_what_means_nothing_is_refused(text: str):
    with pytest.raises(BadValueError, match=PHOTOGRAPHED_LIGHT):
        with_light(text)


def test_whatever_a_file_says_an_error_is_ours():
    for value in (None, True, 3, "x", [[]], [{"name": 1, "levels": {}}], [{"name": "x", "levels": []}]):
        with pytest.raises(BadValueError):
            photographed_light({PHOTOGRAPHED_LIGHT: json.dumps(value)})
