# SPDX-License-Identifier: GPL-3.0-or-later
"""Which options of a command were given: those that would change nothing are refused, not ignored.

A command that makes several kinds of things has a class for each kind, whose fields are the options that it
reads, and groups of options, as ``--help`` shows them.
"""

import re
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from ...bridge.errors import BadValueError

Kind = TypeVar("Kind")


def given_of(command: Any, *names: str) -> list[str]:
    """Those of some options of a command, a dataclass, that are not as by default, as they are typed."""
    defaults = {each.name: each.default for each in fields(command)}
    return [as_typed(name) for name in names if getattr(command, name) != defaults[name]]


def as_typed(name: str) -> str:
    """``lighting_level`` → ``lighting-level``."""
    return name.replace("_", "-")


def of_kind(kind: type[Kind], command: Any, what: str, *choosing: str) -> Kind:
    """A ``kind`` of work with what was given to the ``command`` and its groups of options.

    ``choosing``: options that have said which kind it is, read or not. Raises ``BadValueError`` for another
    one that was given and that ``kind``, which is called ``what``, does not read.
    """
    values: dict[str, Any] = {}
    given = _options(command, values)
    wanted = {each.name for each in fields(kind) if each.init}  # pyright: ignore[reportArgumentType]
    for name in given:
        if name not in wanted and name not in choosing:
            raise BadValueError(f"--{as_typed(name)} has no effect on {what}", "Leave it out.")
    return kind(**{name: values[name] for name in wanted})


def is_folder(out: Path) -> bool:
    """Whether ``out`` names a folder: it is one, or its name ends in no type of file (``v1.2`` does not)."""
    return out.is_dir() or not re.fullmatch(r"\.[A-Za-z]\w{0,11}", out.suffix)


def _options(options: Any, values: dict[str, Any]) -> list[str]:
    """Fills ``values``, by name; returns the names of those that are not as by default."""
    given: list[str] = []
    for each in fields(options):
        value = getattr(options, each.name)
        if is_dataclass(value):
            given += _options(value, values)
            continue
        values[each.name] = value
        default = each.default_factory() if each.default_factory is not MISSING else each.default
        if value != default:
            given.append(each.name)
    return given
