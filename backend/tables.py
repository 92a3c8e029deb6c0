# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables that other packages add rows to: methods, backbones, presets and commands.

A package names its rows as an entry point of the group ``physhdr.methods``, ``physhdr.backbones``,
``physhdr.presets`` or ``physhdr.commands``, which leads to a mapping. ``lab/`` does so in our own
``pyproject.toml``; a package of somebody else's in its own (docs/contributing/a-method.md).
"""

from collections import ChainMap
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from itertools import chain
from typing import Generic, TypeVar

from .project import NAME, entry_points_of

Row = TypeVar("Row")


class Table(Mapping[str, Row], Generic[Row]):
    """Rows by name: ``own`` first, then those of packages, which are imported when they are first looked for.

    A row of ``own`` stands before a package's of the same name.
    """

    def __init__(self, group: str, own: dict[str, Row]) -> None:
        self.group, self.own = f"{NAME}.{group}", own

    @cached_property
    def _rows(self) -> ChainMap[str, Row]:
        # Ours as pyproject.toml has them: where Blender starts the backend, no package is installed.
        ours = [EntryPoint(name, value, self.group) for name, value in entry_points_of(self.group).items()]
        others = [each for each in entry_points(group=self.group) if each.dist and each.dist.name != NAME]
        return ChainMap(self.own, *(point.load() for point in [*ours, *others]))

    def __getitem__(self, name: str) -> Row:
        return self.own[name] if name in self.own else self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(chain.from_iterable(self._rows.maps)))

    def __len__(self) -> int:
        return len(self._rows)
