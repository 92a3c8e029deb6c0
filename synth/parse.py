# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line's texts as values; each error names the option and what was wrong."""

from fractions import Fraction
from itertools import pairwise

from .built_in import SCENES
from .errors import OptionError
from .light_names import LightChoice
from .options import ALL, FOLLOW, LARGEST_EV, join, seconds, within


def parse_numbers(name: str, text: str) -> tuple[float, ...]:
    """``"1/4,0.5,2"`` → (0.25, 0.5, 2.0). An empty text is an empty list.

    Raises:
        OptionError: a part is no number.
    """
    values = []
    for part in text.replace(",", " ").split():
        try:
            values.append(float(Fraction(part)))
        except (ValueError, ZeroDivisionError, OverflowError):
            raise OptionError(
                f"{name} '{text}': '{part}' is not a number (write 0.125,0.5,2 or 1/4,1/2,2)"
            ) from None
    return tuple(values)


def parse_evs(text: str) -> tuple[float, ...]:
    """``"-3,-1,1"`` → exposures in seconds (0.125, 0.5, 2).

    Raises:
        OptionError: no numbers, none, not rising, or out of range.
    """
    values = parse_numbers("--evs", text)
    if not values:
        raise OptionError("--evs: at least one is needed, such as --evs=-3,-1,1,3,5")
    for value in values:
        within("--evs (EV 0 is one second)", value, -LARGEST_EV, LARGEST_EV)
    if any(b <= a for a, b in pairwise(values)):
        raise OptionError(f"--evs {join(values)}: must rise, shortest exposure first")
    return seconds(values)


def parse_mixtures(text: str) -> tuple[tuple[tuple[str, float], ...], ...]:
    """``"ambient=4,pendant=1/4 ambient=2"`` → ((("ambient", 4.0), ("pendant", 0.25)), (("ambient", 2.0),)).

    Raises:
        OptionError
    """
    made = []
    for part in text.replace(";", " ").split():
        levels = []
        for each in part.split(","):
            name, equals, number = each.partition("=")
            if not (name and equals):
                raise OptionError(f"--mixed-levels '{part}': write ambient=4,pendant=0.25")
            values = parse_numbers("--mixed-levels", number)
            if len(values) != 1:
                raise OptionError(f"--mixed-levels '{part}': one level for each light")
            levels.append((name, values[0]))
        made.append(tuple(levels))
    return tuple(made)


def parse_names(text: str) -> tuple[str, ...]:
    """``"ambient,pendant"`` → ("ambient", "pendant")."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def parse_light(text: str) -> LightChoice:
    """``"key=group:Key Light"`` → that light; what follows the colon is a name of Blender's, of any kind.

    Raises:
        OptionError
    """
    name, _, rest = text.partition("=")
    kind, _, what = rest.partition(":")
    choice = LightChoice(name.strip(), kind.strip(), what)
    choice.check()
    return choice


def parse_scenes(text: str) -> tuple[str, ...]:
    """``"all"``, or names with commas between.

    Raises:
        OptionError: none, or one twice.
    """
    names = tuple(SCENES) if text.strip() == ALL else parse_names(text)
    if not names:
        raise OptionError(f"--scene: name at least one, or '{ALL}'")
    if len(set(names)) != len(names):
        raise OptionError(f"--scene {text}: each scene once")
    return names


def parse_pair(name: str, text: str) -> tuple[float, float]:
    """``"1.5x0.8"`` or ``"-5,40"`` → two numbers.

    Raises:
        OptionError
    """
    values = parse_numbers(name, text.lower().replace("x", " "))
    if len(values) != 2:
        raise OptionError(f"{name} '{text}': two numbers are needed, such as 1.5,0.8")
    return values[0], values[1]


def parse_part(text: str) -> tuple[int, int]:
    """``"2/8"`` → (2, 8).

    Raises:
        OptionError
    """
    number, slash, of = text.partition("/")
    if not (slash and number.strip().isdigit() and of.strip().isdigit()):
        raise OptionError(f"--part '{text}': write 2/8 for the second of eight parts")
    return int(number), int(of)


def parse_resolution(text: str, follow: bool = False) -> tuple[int, int]:
    """``"200"`` → (200, 200), ``"320x240"`` → (320, 240); ``follow``: ``"200"`` → (200, ``FOLLOW``).

    Raises:
        OptionError
    """
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.strip().isdigit() for part in parts):
        raise OptionError(f"--resolution '{text}': write 200 or 320x240")
    if follow and len(parts) == 1:
        return int(parts[0]), FOLLOW
    return int(parts[0]), int(parts[-1])
