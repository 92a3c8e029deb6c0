# SPDX-License-Identifier: GPL-3.0-or-later
"""What every reader of a data set returns: cameras, exposures, pictures on demand, first points.

A scene does not contain the true radiance (``train_hdr/``, ``relit/`` …): a method that is given a scene
cannot read it. Evaluation asks ``backend/evaluate/truth.py``.
"""

import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set
from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.lights import AMBIENT
from ...bridge.regular import read_json_object
from ..memory import picture_room
from .camera import Camera
from .encoding import Encoding
from .resize import Reduction
from .source import Decoded, PictureSource


class PictureCache:
    """Decoded pictures and their masks, the least recently used evicted first, at most ``budget`` bytes.

    ``budget`` None: ``memory.picture_room``. ``reduction``: how much smaller pictures become when they are
    decoded; only the small ones are cached.
    """

    def __init__(self, budget: int | None = None, reduction: Reduction | None = None) -> None:
        self.budget = picture_room() if budget is None else budget
        self.reduction = reduction or Reduction()
        self.bytes_held = 0
        self._pictures: OrderedDict[Hashable, Decoded] = OrderedDict()
        self._being_decoded: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()  # the preview server renders from another thread than the trainer

    def get(self, source: PictureSource) -> Decoded:
        """The picture and its mask, read-only; raises what ``PictureSource.read`` raises.

        Different pictures are decoded at the same time; a thread that wants the same one waits.
        """
        with self._lock:
            if (kept := self._kept(source.key)) is not None:
                return kept
            being_decoded = self._being_decoded.setdefault(source.key, threading.Lock())
        with being_decoded:
            with self._lock:
                if (kept := self._kept(source.key)) is not None:
                    return kept
            try:
                picture = source.read(self.reduction)
                picture.codes.setflags(write=False)
                if picture.mask is not None:
                    picture.mask.setflags(write=False)
                with self._lock:
                    self._keep(source.key, picture)
            finally:
                with self._lock:
                    self._being_decoded.pop(source.key, None)
            return picture

    def _kept(self, key: Hashable) -> Decoded | None:
        if key in self._pictures:
            self._pictures.move_to_end(key)
        return self._pictures.get(key)

    def _keep(self, key: Hashable, picture: Decoded) -> None:
        if former := self._pictures.pop(key, None):  # where a first attempt of another thread had failed
            self.bytes_held -= former.nbytes
        self._pictures[key] = picture
        self.bytes_held += picture.nbytes
        while self.bytes_held > self.budget and len(self._pictures) > 1:
            self.bytes_held -= self._pictures.popitem(last=False)[1].nbytes


@dataclass(frozen=True, eq=False)
class View:
    """One pose with its bracket of pictures.

    ``name``: as the data set names it (``train/r_3``). ``index``: the pose's number (3), which also names
    its true radiance (``hdr_003.exr``). ``exposures``: seconds, one for each of ``sources``.
    ``lighting_levels``: of each of the scene's lights; None: nobody measured it, training finds it.
    ``standard_levels``: those of the views of no group; empty: all are 1, as where no light is on in a group
    alone. ``group``: the views under one light that it belongs to; empty where no file names any.
    ``bracket``: the place of each exposure in the data set's bracket, rising (0, 2, 4 where 1 and 3 were not
    taken); by default 0, 1, 2 … The paper's LDR-OE and LDR-NE are sets of these numbers. Everything else here
    counts by position: ``exposures[i]`` seconds belong to ``image(i)`` and to ``bracket[i]``.
    """

    name: str
    camera: Camera
    exposures: tuple[float, ...]
    sources: tuple[PictureSource, ...]
    index: int
    lighting_levels: tuple[float | None, ...] = (1.0,)
    cache: PictureCache = field(default_factory=PictureCache, repr=False)
    bracket: tuple[int, ...] = ()
    standard_levels: tuple[float, ...] = ()
    group: str = ""

    def __post_init__(self) -> None:
        if not self.standard_levels:
            object.__setattr__(self, "standard_levels", tuple(1.0 for _ in self.lighting_levels))
        if not self.bracket:
            object.__setattr__(self, "bracket", tuple(range(len(self.exposures))))
        if len(self.exposures) != len(self.sources) or not self.exposures:
            raise DataMismatchError(
                f"view '{self.name}' has {len(self.exposures)} exposures, {len(self.sources)} pictures",
                "Give each picture of a view one exposure.",
            )
        if len(self.bracket) != len(self.exposures) or list(self.bracket) != sorted(set(self.bracket)):
            raise DataMismatchError(
                f"view '{self.name}' has {len(self.exposures)} exposures at the places {self.bracket}",
                "Give each exposure one place in the bracket, rising.",
            )

    def place_of(self, k: int) -> int | None:
        """Where exposure ``k`` of the bracket is in ``exposures``; None if this view lacks it."""
        return self.bracket.index(k) if k in self.bracket else None

    @property
    def is_standard(self) -> bool:
        """Whether every light is as in the standard views."""
        return self.lighting_levels == self.standard_levels

    @property
    def known_levels(self) -> tuple[float, ...]:
        """``lighting_levels``; raises ``BadValueError`` where one is not known yet."""
        known = tuple(level for level in self.lighting_levels if level is not None)
        if len(known) != len(self.lighting_levels):
            raise BadValueError(
                f"the light of view '{self.name}' is unknown", "Train with the method 'physhdr' to find it."
            )
        return known

    @property
    def image_paths(self) -> tuple[Path, ...]:
        """The pictures' files."""
        return tuple(source.path for source in self.sources)

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """How the codes of each picture follow from exposure × radiance."""
        return tuple(source.encoding for source in self.sources)

    def image(self, k: int) -> np.ndarray:
        """The codes at exposure ``k``: ``[H, W, 3]`` uint8 or uint16, read-only, decoded once and cached.

        Raises ``FileMissingError`` or ``FileDamagedError`` if it cannot be decoded, ``DataMismatchError``
        if it is not of the camera's size, ``BadValueError`` if the view has no exposure ``k``.
        """
        return self._decoded(k).codes

    def mask(self, k: int) -> np.ndarray | None:
        """Which pixels of ``image(k)`` are compared, ``[H, W]`` bool, read-only; None: all. Raises as it."""
        return self._decoded(k).mask

    def values(self, k: int) -> np.ndarray:
        """``image(k)`` as float64 values ``[H, W, 3]``: codes over the one that stands for 1."""
        codes = self.image(k)
        return codes / self.sources[k].encoding.unit(codes.dtype)

    def shown(self, k: int) -> np.ndarray:
        """``image(k)`` with 8 bits, ``[H, W, 3]`` uint8, for eyes and for finding features."""
        codes = self.image(k)
        return (
            codes
            if codes.dtype == np.uint8
            else np.rint(self.values(k).clip(0.0, 1.0) * 255.0).astype(np.uint8)
        )

    def _decoded(self, k: int) -> Decoded:
        if not 0 <= k < len(self.sources):
            raise BadValueError(
                f"view '{self.name}' has no exposure {k}",
                f"Choose an exposure index from 0 to {len(self.sources) - 1}.",
            )
        found = self.cache.get(self.sources[k])
        height, width = found.codes.shape[:2]
        if (height, width) != (self.camera.height, self.camera.width):
            raise DataMismatchError(
                f"{self.sources[k].path} is {width}×{height}, the camera of view '{self.name}' is "
                f"{self.camera.width}×{self.camera.height}",
                "The picture has changed since the data set was opened: open it again.",
            )
        return found


@dataclass(frozen=True, eq=False)
class Points:
    """The first points: ``positions`` ``[P, 3]`` float32, metres; ``colours`` ``[P, 3]`` float32, 0…1.

    ``origin``: what kind they are, as their file says; empty where it does not. ``file``: the name
    of a file that stands for the data set's own points; empty for those. ``ignored``: how many more it has
    that are too far away.
    """

    positions: np.ndarray
    colours: np.ndarray
    origin: str = ""
    file: str = ""
    ignored: int = 0

    def __str__(self) -> str:
        """``12,345 points of the data set (exact ray hits)``."""
        kind = f" ({self.origin})" if self.origin else ""
        return f"{len(self.positions):,} points of {self.file or 'the data set'}{kind}"


@dataclass(frozen=True, eq=False)
class Scene:
    """A data set that is ready for training: nothing in it leads to the true radiance.

    ``lit``: extra training views under other light; ``lit_test``: such views of captures that are never
    trained from. ``lights``: names of the lights whose levels differ there, in the order of every view's
    ``lighting_levels``. ``response_anchor``: one known point of the camera's response, (exposure × radiance,
    code value in 0…1), or None where the data name none.
    ``info``: ``dataset.json`` as read, or ``{}``. ``layout``: the name of the layout on disk. ``messages``:
    what the reader decided, in sentences (split, size, origin of exposures).
    ``validation``: views that choices are made on, at poses of their own, never trained from; only our own
    layout, NeRF's and ``transforms.json`` have any. ``of_renders``: whether the layout is one of renders.
    ``known_photographs``: what ``photographs`` is, as a run keeps it; None: what the data set says.
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
    of_renders: bool = False
    known_photographs: bool | None = None
    lit_test: list[View] = field(default_factory=list)

    @property
    def standard_levels(self) -> tuple[float, ...]:
        """Of each of ``lights`` in the views of no group: 1, or 0 if it is on in its own group alone."""
        views = (*self.train, *self.test, *self.validation)
        return views[0].standard_levels if views else tuple(1.0 for _ in self.lights)

    @property
    def splits(self) -> dict[str, list[View]]:
        """The views by the name of their split: train, test, lit, val, lit_test."""
        return {
            data_set.TRAIN: self.train,
            data_set.TEST: self.test,
            data_set.LIT: self.lit,
            data_set.VALIDATION: self.validation,
            data_set.LIT_TEST: self.lit_test,
        }

    @cached_property
    def middle_exposure(self) -> float:
        """Seconds: the middle one of all training pictures' exposures."""
        exposures = sorted(seconds for view in self.train for seconds in view.exposures)
        return exposures[len(exposures) // 2]

    @cached_property
    def photographs(self) -> bool:
        """Whether the pictures were taken by real cameras, which have faults that renders have not.

        Those that ``physhdr prepare`` wrote were. Others are, unless their layout is one of
        renders, they say that we rendered them, or name a known point of the camera's response, which only
        renders can.
        """
        if self.known_photographs is not None:
            return self.known_photographs
        prepared = self.root / data_set.CAPTURE_FILE
        if prepared.is_file():
            written = read_json_object(prepared, "Prepare the data set again.")
            if written.get("format") == data_set.CAPTURE_FORMAT:
                return True
        generator = self.info.get("generator")
        rendered = isinstance(generator, dict) and generator.get("name") == data_set.MAKER
        return not (rendered or self.of_renders) and self.response_anchor is None

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
