# SPDX-License-Identifier: GPL-3.0-or-later
"""Which options of a command were changed: one that would have no effect is refused, not ignored.

A command that makes several kinds of output has a class for each kind, whose fields are the options it reads,
and groups of options as ``--help`` shows them.
"""

import re
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from ...bridge.errors import BadValueError

Kind = TypeVar("Kind")


def changed_options(command: Any, *names: str) -> list[str]:
    """Those of the named options of a command (a dataclass) that differ from their default, as typed."""
    defaults = {each.name: each.default for each in fields(command)}
    return [option_name(name) for name in names if getattr(command, name) != defaults[name]]


def option_name(name: str) -> str:
    """``lighting_level`` → ``lighting-level``."""
    return name.replace("_", "-")


def build_kind(kind: type[Kind], command: Any, what: str, *choosing: str) -> Kind:
    """A ``kind`` of work with the options of the ``command`` and its groups.

    ``choosing``: options that selected the kind and are allowed whether or not it reads them. ``what``: its
    name in messages. Raises ``BadValueError`` for any other changed option that ``kind`` does not read.
    """
    values: dict[str, Any] = {}
    changed = _collect(command, values)
    wanted = {each.name for each in fields(kind) if each.init}  # pyright: ignore[reportArgumentType]
    for name in changed:
        if name not in wanted and name not in choosing:
            raise BadValueError(f"--{option_name(name)} has no effect on {what}", "Leave it out.")
    return kind(**{name: values[name] for name in wanted})


def is_folder(out: Path) -> bool:
    """Whether ``out`` names a folder: it is one, or its name has no file extension (``v1.2`` has none)."""
    return out.is_dir() or not re.fullmatch(r"\.[A-Za-z]\w{0,11}", out.suffix)


def _collect(options: Any, values: dict[str, Any]) -> list[str]:
    """Fill ``values`` by name; returns the names of those that differ from their default."""
    changed: list[str] = []
    for each in fields(options):
        value = getattr(options, each.name)
        if is_dataclass(value):
            changed += _collect(value, values)
            continue
        values[each.name] = value
        default = each.default_factory() if each.default_factory is not MISSING else each.default
        if value != default:
            changed.append(each.name)
    return changed
