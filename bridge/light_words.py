# SPDX-License-Identifier: GPL-3.0-or-later
"""How photographers say what a light does in a folder of photos: ``pendant=FOLDER:off``, ``lamp_on/``."""

import re
from dataclasses import dataclass

from .data_set import LEVEL
from .errors import BadValueError
from .lights import check_lights

OFF, ON, UNKNOWN = "off", "on", "unknown"
#: Words under which a light's level is unknown: training finds it.
UNKNOWN_WORDS = (
    *(UNKNOWN, "dim", "dimmed", "bright", "brighter", "dark", "darker", "sunny", "cloudy", "overcast"),
    *("dawn", "sunrise", "morning", "noon", "afternoon", "evening", "sunset", "dusk", "night"),
)
WORDS = (
    "Words are: off; on (the light is on in this folder alone, the other photos are without it); a factor, "
    "as 0.25, 2x or 50%; or, where it is not known, unknown, dim, bright, morning, evening, dusk, night, "
    "cloudy and so on."
)

#: All of these are in limits.LEVEL, but for 0: off.
_FACTOR = re.compile(r"(\d{1,6}(?:\.\d{1,6})?)(x|%)?", re.IGNORECASE)
_SAID = re.compile(r"(.+?)[\s_.-]+([^\s_-]+)")
_TOGETHER = re.compile(r"\s*(?:[+,&]|\sand\s)\s*")


@dataclass(frozen=True)
class LightChange:
    """One light of a group of photos, and the ``word`` that says what it does there."""

    light: str
    word: str

    @property
    def level(self) -> float | None:
        """The factor on the light; None where it is unknown."""
        factor = _FACTOR.fullmatch(self.word)
        if factor:
            return float(factor[1]) * (0.01 if factor[2] == "%" else 1.0)
        return {OFF: 0.0, ON: 1.0}.get(self.word)

    @property
    def is_alone(self) -> bool:
        """Whether the light is on in this group alone, so that other photos are without it."""
        return self.word == ON

    def __str__(self) -> str:
        return f"{self.light} {self.word}"


def light_change(light: str, word: str) -> LightChange:
    """Raises ``BadValueError`` for a name that is none, or a word that says nothing of a light."""
    light, word = light.strip(), word.strip().lower()
    if not any(letter.isalpha() for letter in light) or light.casefold() == LEVEL:
        raise BadValueError(
            f"{light!r:.80} is no name of a light", "Name it as its slider: pendant=FOLDER:off."
        )
    check_lights([light], "--light")
    if not _is_word(word):
        raise BadValueError(f"{word!r:.80} does not say what {light} does", WORDS)
    return LightChange(light, word)


def changes_in_name(folder: str) -> tuple[LightChange, ...]:
    """What a folder's name says: ``pendant off``, ``desk_lamp-off + daylight evening``; () if nothing.

    A plain number (``room 2``, ``version 1.5``) is no factor there: 2x or 50% is.
    """
    changes = []
    for part in _TOGETHER.split(folder.strip()):
        said = _SAID.fullmatch(part)
        if said is None or said[2][-1].isdecimal():
            return ()
        try:
            changes.append(light_change(said[1], said[2]))
        except BadValueError:
            return ()
    return tuple(changes)


def _is_word(word: str) -> bool:
    return word in (OFF, ON, *UNKNOWN_WORDS) or _FACTOR.fullmatch(word) is not None
