# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings by name: each can be shown and given again; one that is unknown or cannot be so is refused."""

import dataclasses
import re

import pytest

from physhdr.backend.cli import main
from physhdr.backend.shell import OPTIONS, option
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.settings import as_text, assigned, settings_of, with_settings
from physhdr.bridge.errors import BadValueError

DEFAULT = PRESETS["default"]


@pytest.mark.parametrize("preset", PRESETS)
def test_all_settings_of_a_preset_given_as_text_make_it_again(preset):
    config = PRESETS[preset]
    texts = [f"{each.name}={as_text(each.value)}" for each in settings_of(config)]
    other = dataclasses.replace(config, iterations=7, seed=3, half_size_until=0.0)
    assert other != config == with_settings(other, assigned(other, texts))


@pytest.mark.parametrize("preset", PRESETS)
def test_every_setting_says_what_it_means(preset):
    assert not [each.name for each in settings_of(PRESETS[preset]) if not each.meaning]


def test_how_a_setting_is_typed():
    assert (option("downscale", 2), option("training_exposures")) == ("--downscale 2", "--training-exposures")
    assert option("backbone.budget", 9) == "--set backbone.budget=9"
    assert (option("half_size_until", 0), option("far_shell")) == (
        "--set half_size_until=0",
        "--set far_shell",
    )
    assert {*OPTIONS} < {each.name for each in settings_of(DEFAULT)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("backbone.evry=3", r"no setting 'backbone.evry'\n.*Did you mean backbone\.every"),
        ("budget=3", r"no setting 'budget'\n.*backbone\.budget"),
        ("half-size-until=0", r"no setting 'half-size-until'\n.*half_size_until"),
        ("zebra=3", r"no setting 'zebra'\n.*--help-all"),
        ("method=physhdr", "no setting 'method'"),
        ("backbone.every", "has no value"),
        ("backbone.every=soon", "--set backbone.every must be a whole number, got 'soon'"),
        ("backbone.threshold=nan", "--set backbone.threshold must be a number"),
        ("method.tone_mapper.local=perhaps", "must be true or false"),
        ("supervision=many", "--set supervision must be one or bracket"),
        ("training_exposures=0,x", "--training-exposures must be a whole number, or several"),
        ("downscale=x", "--downscale must be a number or none"),
    ],
)
def test_what_is_no_setting_or_no_value_is_refused(text, message):
    with pytest.raises(BadValueError, match=message):
        assigned(DEFAULT, [text])


def test_values_are_read_by_type():
    texts = ["downscale=none", "training_exposures=1, 3", "method.tone_mapper.local=true", "points_file=a=b"]
    config = with_settings(DEFAULT, assigned(DEFAULT, texts))
    assert (config.downscale, config.training_exposures) == (None, (1, 3))
    assert config.method.tone_mapper.local is True and config.points_file == "a=b"


def test_settings_are_checked_when_all_of_them_are_set():
    """HDR supervision needs both of its settings: neither can come first."""
    preset = PRESETS["hdr-gs"]
    both = {"method.hdr_supervision": True, "method.hdr_truth": "T"}
    assert with_settings(preset, both).method.hdr_truth == "T"
    with pytest.raises(BadValueError, match="asked for twice"):
        with_settings(preset, dict([*both.items()][:1]))


def test_help_is_a_page_and_all_settings_are_listed(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    page = capsys.readouterr().out
    options = re.findall(r"^[│ ]*--(?!no-)([a-z-]+)", page, re.MULTILINE)
    assert {"out", "preset", "set"} < {*options} and len(options) <= 25 and len(page.splitlines()) <= 80
    assert "--help-all" in page and "--preset fast, default or high" in page
    assert main(["train", "--help-all", "--preset", "default-scaffold"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len([*settings_of(PRESETS["default-scaffold"])])
    assert any(line.startswith("backbone.feature_size=32 ") and "whole number" in line for line in lines)
