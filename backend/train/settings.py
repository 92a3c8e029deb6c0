# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings by name, as ``physhdr train --set backbone.every=100`` has them."""

import dataclasses
import difflib
import inspect
import math
import re
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal, NamedTuple

from ...bridge.errors import BadValueError
from ..shell import option
from .config import TrainConfig


class Setting(NamedTuple):
    """A setting of a configuration; ``name`` as ``config.json`` nests it, with dots between."""

    name: str
    type: Any
    value: Any
    meaning: str


def settings_of(config: Any, prefix: str = "") -> Iterator[Setting]:
    """All settings of a configuration and of its parts, whose classes are the method's and the backbone's."""
    hints, meanings = typing.get_type_hints(type(config)), _meanings(type(config))
    for each in dataclasses.fields(config):
        value, name = getattr(config, each.name), prefix + each.name
        if dataclasses.is_dataclass(value):
            yield from settings_of(value, f"{name}.")
        else:
            yield Setting(name, hints[each.name], value, meanings.get(each.name, ""))


def with_settings(config: TrainConfig, values: Mapping[str, Any]) -> TrainConfig:
    """``config`` with these values by name, checked when all are set; raises what ``TrainConfig`` raises."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parts, last = name.split(".")
        branch = tree
        for part in parts:
            branch = branch.setdefault(part, {})
        branch[last] = value
    return _replaced(config, tree)


def assigned(config: TrainConfig, assignments: Iterable[str]) -> dict[str, Any]:
    """The values of ``NAME=VALUE`` by name, each of the type that the setting has in ``config``.

    Raises ``BadValueError``, which says what is like an unknown name, and what a value may be.
    """
    hints = {setting.name: setting.type for setting in settings_of(config)}
    values: dict[str, Any] = {}
    for text in assignments:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise BadValueError(f"--set {text} has no value", "It takes NAME=VALUE: backbone.every=100")
        if name not in hints:
            raise BadValueError(f"there is no setting '{name}'", _instead_of(name, hints))
        try:
            values[name] = _read(hints[name], value)
        except ValueError as error:
            raise BadValueError(
                f"{option(name)} must be {type_in_words(hints[name])}, got '{value}'",
                "physhdr train --help-all lists all settings.",
            ) from error
    return values


def as_text(value: Any) -> str:
    """A value as ``assigned`` reads it."""
    if isinstance(value, tuple):
        return ",".join(map(as_text, value))
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)


def type_in_words(hint: Any) -> str:
    """What a setting of this type may be."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(map(type_in_words, arguments))
    if origin is Literal:
        return " or ".join(map(str, arguments))
    if origin is tuple:
        return f"{type_in_words(arguments[0])}, or several with commas between"
    words = {bool: "true or false", int: "a whole number", float: "a number", type(None): "none"}
    return words.get(hint, "text")


def _replaced(config: Any, tree: dict[str, Any]) -> Any:
    changes = {
        name: _replaced(getattr(config, name), value) if isinstance(value, dict) else value
        for name, value in tree.items()
    }
    return dataclasses.replace(config, **changes)


def _meanings(cls: type) -> dict[str, str]:
    """The first sentence of the ``#:`` comment before each field, or before several in a row."""
    found: dict[str, str] = {}
    for kind in reversed(cls.__mro__):
        comment, is_open = "", False
        for line in inspect.getsource(kind).splitlines() if dataclasses.is_dataclass(kind) else ():
            if words := re.fullmatch(r"    #: ?(.*)", line):
                comment, is_open = f"{comment} {words[1]}" if is_open else words[1], True
            elif comment and (field := re.match(r"    (\w+): ", line)):
                found[field[1]] = re.split(r"(?<!eq)\.(?:\s|$)", comment)[0]
                is_open = False
            else:
                comment, is_open = "", False
    return found


def _instead_of(name: str, known: Iterable[str]) -> str:
    """Names like ``name``: those with few other letters, and those of a part that end in it."""
    last = name.replace("-", "_").rpartition(".")[2]
    near = [each for each in known if each.rpartition(".")[2] == last]
    near += difflib.get_close_matches(name, known, 3)
    likely = f"Did you mean {' or '.join(dict.fromkeys(near))}? " if near else ""
    return f"{likely}physhdr train --help-all lists all settings."


def _read(hint: Any, text: str) -> Any:
    """Raises ``ValueError`` for what the setting cannot be."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if text.lower() == "none" and type(None) in arguments:
            return None
        return _read(next(each for each in arguments if each is not type(None)), text)
    if origin is tuple:
        return tuple(_read(arguments[0], part) for part in text.replace(",", " ").split())
    if origin is Literal or hint is bool:
        words = {as_text(each): each for each in (arguments or (True, False))}
        if text not in words:
            raise ValueError(text)
        return words[text]
    value = hint(text)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(text)
    return value
