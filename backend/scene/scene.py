# SPDX-License-Identifier: GPL-3.0-or-later
"""What every reader of a data set returns: cameras, exposures, pictures on demand, first points.

A scene knows nothing of the true radiance (``train_hdr/``, ``relit/`` …): a method that is given a scene
cannot read it. Evaluation asks ``backend/evaluate/truth.py``.
"""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set
from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.lights import AMBIENT
from .camera import Camera
from .resize import Reduction

#: Decoded pictures are kept up to this many bytes: all of HDR-NeRF-Syn at 400×400 (84 MB) with room to spare.
CACHE_BYTES = 1 << 30


class PictureCache:
    """Decoded 8-bit pictures, the least recently used forgotten first, at most ``budget`` bytes.

    ``reduction``: how much smaller pictures become when they are decoded; only the small ones are kept.
    """

    def __init__(self, budget: int = CACHE_BYTES, reduction: Reduction | None = None) -> None:
        self.budget = budget
        self.reduction = reduction or Reduction()
        self.bytes_held = 0
        self._pictures: OrderedDict[Path, np.ndarray] = OrderedDict()
        self._lock = threading.Lock()  # the preview server renders from another thread than the trainer

    def get(self, path: Path) -> np.ndarray:
        """``[H, W, 3]`` uint8, read-only; raises what ``read_picture`` raises."""
        with self._lock:
            if path in self._pictures:
                self._pictures.move_to_end(path)
                return self._pictures[path]
            picture = self.reduction.read(path)
            picture.setflags(write=False)
            self._pictures[path] = picture
            self.bytes_held += picture.nbytes
            while self.bytes_held > self.budget and len(self._pictures) > 1:
                self.bytes_held -= self._pictures.popitem(last=False)[1].nbytes
            return picture


@dataclass(frozen=True, eq=False)
class View:
    """One pose with its bracket of pictures.

    ``name``: as the data set names it (``train/r_3``). ``index``: the pose's number (3), which also names
    its true radiance (``hdr_003.exr``). ``exposures``: seconds, one for each of ``image_paths``.
    ``lighting_levels``: each of the scene's lights relative to the standard views, all 1 for those.
    ``bracket``: the place of each exposure in the data set's bracket, rising (0, 2, 4 where 1 and 3 were not
    taken); by default 0, 1, 2 … The paper's LDR-OE and LDR-NE are sets of these numbers. Everything else here
    counts by position: ``exposures[i]`` seconds belong to ``image(i)`` and to ``bracket[i]``.
    """

    name: str
    camera: Camera
    exposures: tuple[float, ...]
    image_paths: tuple[Path, ...]
    index: int
    lighting_levels: tuple[float, ...] = (1.0,)
    cache: PictureCache = field(default_factory=PictureCache, repr=False)
    bracket: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.bracket:
            object.__setattr__(self, "bracket", tuple(range(len(self.exposures))))
        if len(self.exposures) != len(self.image_paths) or not self.exposures:
            raise DataMismatchError(
                f"view '{self.name}' has {len(self.exposures)} exposures, {len(self.image_paths)} pictures",
                "Give each picture of a view one exposure.",
            )
        if len(self.bracket) != len(self.exposures) or list(self.bracket) != sorted(set(self.bracket)):
            raise DataMismatchError(
                f"view '{self.name}' has {len(self.exposures)} exposures at the places {self.bracket}",
                "Give each exposure one place in the bracket, rising.",
            )

    def place_of(self, k: int) -> int | None:
        """Where exposure ``k`` of the bracket is in ``exposures``; None if this view has it not."""
        return self.bracket.index(k) if k in self.bracket else None

    @property
    def lighting_level(self) -> float:
        """The level of the first light, which is the ambient one wherever that varies."""
        return self.lighting_levels[0]

    @property
    def is_standard(self) -> bool:
        """Whether every light is as in the standard views."""
        return all(level == 1.0 for level in self.lighting_levels)

    def image(self, k: int) -> np.ndarray:
        """The picture at exposure ``k``: ``[H, W, 3]`` uint8, read-only, decoded once and then kept.

        Raises ``FileMissingError`` or ``FileDamagedError`` if it cannot be decoded, ``DataMismatchError``
        if it is not of the camera's size, ``BadValueError`` if the view has no exposure ``k``.
        """
        if not 0 <= k < len(self.image_paths):
            raise BadValueError(
                f"view '{self.name}' has no exposure {k}",
                f"Choose an exposure index from 0 to {len(self.image_paths) - 1}.",
            )
        path = self.image_paths[k]
        picture = self.cache.get(path)
        if picture.shape[:2] != (self.camera.height, self.camera.width):
            raise DataMismatchError(
                f"{path} is {picture.shape[1]}×{picture.shape[0]}, the camera of view '{self.name}' is "
                f"{self.camera.width}×{self.camera.height}",
                "The picture changed after the data set was opened: render it again, or open the set again.",
            )
        return picture


@dataclass(frozen=True, eq=False)
class Points:
    """The first points: ``positions`` ``[P, 3]`` float32, metres; ``colours`` ``[P, 3]`` float32, 0…1.

    ``origin``: what kind they are, in words, as their file says; empty where it does not. ``file``: the name
    of a file that stands for the data set's own points; empty for those.
    """

    positions: np.ndarray
    colours: np.ndarray
    origin: str = ""
    file: str = ""

    def __str__(self) -> str:
        """``12,345 points of the data set (exact ray hits)``."""
        kind = f" ({self.origin})" if self.origin else ""
        return f"{len(self.positions):,} points of {self.file or 'the data set'}{kind}"


@dataclass(frozen=True, eq=False)
class Scene:
    """A data set that is ready for training: nothing in it leads to the true radiance.

    ``lit``: extra training views under other light. ``lights``: names of the lights whose levels differ
    there, in the order of every view's ``lighting_levels``. ``response_anchor``: one known point of the
    camera's response, (exposure × radiance, code value in 0…1), or None where the data name none.
    ``info``: ``dataset.json`` as read, or ``{}``. ``layout``: the name of the layout on disk. ``messages``:
    what the reader decided, in sentences (split, size, where exposures are from), for people to read.
    ``validation``: views that choices are made on, at poses of their own, never trained from; only our own
    layout has any.
    """

    root: Path
    name: str
    train: list[View]
    test: list[View]
    lit: list[View]
    points: Points | None = None
    response_anchor: tuple[float, float] | None = None
    info: dict[str, Any] = field(default_factory=dict)
    lights: tuple[str, ...] = (AMBIENT,)
    layout: str = ""
    messages: tuple[str, ...] = ()
    validation: list[View] = field(default_factory=list)

    @property
    def splits(self) -> dict[str, list[View]]:
        """The views by the name of their split: train, test, lit, val."""
        return {
            data_set.TRAIN: self.train,
            data_set.TEST: self.test,
            data_set.LIT: self.lit,
            data_set.VALIDATION: self.validation,
        }

    def find(self, split: str, index: int) -> View:
        """The view of pose ``index`` in ``split``; raises ``BadValueError`` naming those there are."""
        if split not in self.splits:
            raise BadValueError(f"there is no split '{split}'", f"Choose from {', '.join(self.splits)}.")
        views = self.splits[split]
        for view in views:
            if view.index == index:
                return view
        there = ", ".join(str(view.index) for view in views) or "none"
        raise BadValueError(
            f"{self.root} has no pose {index} in split '{split}'", f"Choose from these poses: {there}."
        )

    def pictures(self) -> Iterator[tuple[View, int]]:
        """Every (view, exposure index) of every split, for checks that touch all of them."""
        for views in self.splits.values():
            for view in views:
                for k in range(len(view.exposures)):
                    yield view, k
