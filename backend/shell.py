# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands that are told to people, who will copy them."""

import os
import re
import shlex
import sys
from pathlib import PurePath

#: What neither of Windows' shells takes for anything but a part of a word: cmd would do so with ``&^%;``,
#: PowerShell with ``&;,'@()``.
PLAIN_ON_WINDOWS = re.compile(r"[\w\\/:.+-]+")

#: Settings that ``physhdr train`` has an option for; ``--set`` takes these, too, and all others.
OPTIONS = (
    *("iterations", "seed", "exposure_mode", "training_exposures", "downscale", "color_space"),
    *("initial_points", "points_file", "calibration", "nuisances", "poses"),
)


def as_word(path: PurePath) -> str:
    """A path as one word of a command line, quoted where this system's shell would take it for more.

    On Windows it fits both cmd and PowerShell, but for what they replace in quotes, too: ``%NAME%`` of a
    variable that there is, and ``$`` and a backtick.
    """
    text = str(path)
    if os.name != "nt":
        return shlex.quote(text)
    if PLAIN_ON_WINDOWS.fullmatch(text):
        return text
    last = text[len(text.rstrip("\\")) :]  # a backslash before a quote would make it part of the word
    return f'"{text}{last}"'


def option(setting: str, value: object = None) -> str:
    """How a setting is typed: ``--downscale 2``, ``--set backbone.budget=20000``; its name alone without."""
    shown = "" if value is None else str(value)
    if setting in OPTIONS:
        return f"--{setting.replace('_', '-')} {shown}".rstrip()
    return f"--set {setting}={shown}".rstrip("=")


def pip_install(package: str, *, upgrade: bool = False) -> str:
    """The command that installs a package into the Python that runs this."""
    words = ("-m", "pip", "install", *(["--upgrade"] if upgrade else []))
    return " ".join([as_word(PurePath(sys.executable)), *words, as_word(PurePath(package))])
