# SPDX-License-Identifier: GPL-3.0-or-later
"""The true radiance of a data set, in any layout. For evaluation only: no training module imports this, and
no ``Scene`` refers to it.
"""

import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ...bridge import data_set
from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.layouts.truth_folders import GAUSSHDR, HDR_GS, holds_truth
from ...bridge.lights import AMBIENT, check_lights, in_words, named_levels
from ...bridge.limits import check_level
from ...bridge.regular import read_json_object, resolved
from ..scene.pictures import read_exr_channels
from ..scene.source import exr_rec709

#: Depths from here on are of the sky: Cycles gives it 1e10.
SKY = 1e9


@dataclass(frozen=True)
class _Place:
    """Where a layout stores its true radiance: a folder, and the name of a pose's file in it."""

    folder: Callable[[str], str]
    file: Callable[[str, int], str]

    def path(self, root: Path, split: str, index: int) -> Path:
        return root / self.folder(split) / self.file(split, index)


#: HDR-NeRF-Syn's and ours; GaussHDR's packaging; HDR-GS's, which has all poses in one folder.
_PLACES = (
    _Place(data_set.truth_folder, lambda split, index: data_set.truth_file(index)),
    _Place(lambda split: GAUSSHDR, lambda split, index: f"{split}_hdr_{index:03d}.exr"),
    _Place(lambda split: HDR_GS, lambda split, index: f"{index}.exr"),
)


def _place(root: Path, split: str) -> _Place | None:
    """The layout's place of truth; None where there is none."""
    return next((place for place in _PLACES if holds_truth(Path(root), place.folder(split))), None)


def hdr_truth_path(root: Path, split: str, index: int) -> Path:
    """Path of the true radiance of pose ``index`` of ``split`` (train, test, lit, val), existing or not.

    ``test_hdr/hdr_003.exr``, ``images_hdr/test_hdr_003.exr`` (GaussHDR) or ``exr/3.exr`` (HDR-GS).
    """
    return (_place(root, split) or _PLACES[0]).path(Path(root), split, index)


def has_hdr_truth(root: Path, split: str) -> bool:
    """Whether the data set has the true radiance of ``split`` (photographs do not)."""
    return _place(root, split) is not None


def hdr_truth(root: Path, split: str, index: int) -> torch.Tensor:
    """``[3, H, W]`` float32 Linear Rec.709; raises what ``exr_rec709`` raises."""
    return radiance_in(hdr_truth_path(root, split, index))


@dataclass(frozen=True, eq=False)
class SurfaceTruth:
    """What a view sees of the true surface: ``depth`` ``[H, W]`` metres, ``normal`` ``[H, W, 3]``.

    The normal is in the world, a mean over the pixel, and shorter than 1 where it has an edge. ``is_known``:
    where there is a surface, ``[H, W]`` bool.
    """

    depth: np.ndarray
    normal: np.ndarray
    is_known: np.ndarray

    def sampled(self, height: int, width: int) -> "SurfaceTruth":
        """At the middle of each pixel of a picture of another size: depths of two surfaces have no mean."""
        rows, columns = (
            ((np.arange(new) + 0.5) * old / new).astype(np.intp)
            for new, old in zip((height, width), self.depth.shape, strict=True)
        )
        at = np.ix_(rows, columns)
        return SurfaceTruth(self.depth[at], self.normal[at], self.is_known[at])

    def within(self, mask: np.ndarray) -> "SurfaceTruth":
        """Known in ``mask`` ``[H, W]`` bool alone."""
        return SurfaceTruth(self.depth, self.normal, self.is_known & mask)


def has_surface_truth(root: Path, split: str, index: int) -> bool:
    """Whether the renders that a data set was derived from are there, which have depth and normals."""
    return (Path(root) / data_set.passes_file(split, index)).is_file()


def surface_truth(root: Path, split: str, index: int) -> SurfaceTruth:
    """Of pose ``index`` of ``split``; raises what ``read_exr_channels`` raises."""
    path = Path(root) / data_set.passes_file(split, index)
    names = ("depth.V", "normal.X", "normal.Y", "normal.Z")
    depth, *normal = read_exr_channels(path, "Make the data set again.", names).values()
    return SurfaceTruth(depth, np.stack(normal, axis=-1), (depth > 0.0) & (depth < SKY))


@dataclass(frozen=True)
class RelitTruth:
    """The true picture of test pose ``index`` with each light in ``levels`` multiplied by its level.

    Other lights are as in the standard views.
    """

    levels: dict[str, float]
    index: int
    path: Path

    @property
    def condition(self) -> str:
        """``ambient 4 + pendant 0.25``."""
        return in_words(self.levels)

    @property
    def level(self) -> float | None:
        """The ambient light's level, if only that light is changed."""
        return self.levels.get(AMBIENT) if len(self.levels) == 1 else None

    @property
    def changed(self) -> dict[str, float]:
        """The lights that differ from the standard views, and their levels."""
        return {name: level for name, level in self.levels.items() if level != 1.0}

    def can_be_shown(self, lights: Sequence[str]) -> bool:
        """Whether a model with levels for ``lights`` has one for every changed light."""
        return all(name in lights for name in self.changed)

    def levels_of(self, lights: Sequence[str], standard: Sequence[float]) -> tuple[float, ...]:
        """A level for each of ``lights``; raises ``BadValueError`` if a changed one is missing.

        ``standard``: of those that it does not name.
        """
        named = named_levels(self.changed, lights, self.condition)
        each = zip(lights, named, standard, strict=True)
        return tuple(level if light in self.levels else usual for light, level, usual in each)

    def radiance(self) -> torch.Tensor:
        """``[3, H, W]`` float32 Linear Rec.709; raises what ``exr_rec709`` raises."""
        return radiance_in(self.path)


def relit_truth(root: Path) -> list[RelitTruth]:
    """All relit true pictures by condition and pose; empty if the data set has none.

    ``dataset.json`` lists folders and their levels under ``relit``; without that list they go by their names,
    in which ``level`` is the ambient light's. Raises ``BadValueError``,
    ``FileDamagedError`` and ``FileMissingError`` for an invalid folder, level or file name.
    """
    root = Path(root)
    if not (root / data_set.RELIT_FOLDER).is_dir():
        return []
    listed = _listed_conditions(root)
    conditions = _named_conditions(root) if listed is None else listed
    found = []
    for folder, levels in conditions:
        poses = []
        for path in folder.glob(data_set.TRUTH_FILES):
            number = data_set.truth_number(path.name)
            if number is None:
                raise BadValueError(f"{path} does not name a pose", "Rename it to hdr_003.exr, or remove it.")
            poses.append(RelitTruth(levels, number, path))
        found += sorted(poses, key=lambda truth: truth.index)
    return found


def _named_conditions(root: Path) -> list[tuple[Path, dict[str, float]]]:
    """The folders ``relit/level_0.25``, ``relit/pendant_0`` and their levels, fewest lights first."""
    found = []
    for name in data_set.mixture_folders(root):
        levels = data_set.mixture_levels(name)
        if not levels or not all(0.0 <= level < math.inf for level in levels.values()):
            raise BadValueError(
                f"{root / name} does not name lighting levels",
                "Rename it to level_0.25, pendant_0 and so on, or remove it.",
            )
        for light, level in levels.items():
            check_level(level, f"{root / name}: the level of {light}")
        found.append((root / name, levels))
    return sorted(found, key=lambda condition: (len(condition[1]), *condition[1].items()))


def _listed_conditions(root: Path) -> list[tuple[Path, dict[str, float]]] | None:
    """The entries under ``relit`` in ``dataset.json``, in its order; ``None`` without any."""
    path = root / data_set.INFO_FILE
    if not path.exists():
        return None
    info = read_json_object(path, "Make the data set again.")
    listed, lights = info.get("relit"), info.get("lights")
    if listed is None:
        return None
    if not isinstance(listed, list):
        raise BadValueError(f"{path}: 'relit' is a {type(listed).__name__}, not a list", _LIST_FORM)
    found: list[tuple[Path, dict[str, float]]] = []
    for number, entry in enumerate(listed):
        where = f"{path}: relit {number}"
        match entry:
            case {"folder": str(name), "levels": {**levels}} if levels:
                pass
            case _:
                raise BadValueError(f"{where} is {entry!r:.80}", _LIST_FORM)
        folder = root / name
        if "\0" in name or not resolved(folder).is_relative_to(resolved(root)):
            raise BadValueError(f"{where}: the folder {name!r:.80} is not in the data set", _LIST_FORM)
        if lights is not None:
            lights = check_lights(lights, str(path))
            named_levels({light: 1.0 for light in levels}, lights, where)
        if not all(type(v) in (int, float) and 0.0 <= v <= sys.float_info.max for v in levels.values()):
            raise BadValueError(
                f"{where}: the levels are {levels!r:.200}", "Each must be a number, 0 or more."
            )
        for light, level in levels.items():
            check_level(level, f"{where}: the level of {light!r:.80}")
        if not os.path.isdir(folder):  # Path.is_dir raises where a name is too long
            raise FileMissingError(
                f"{folder!s:.400}, listed in {path.name}, is missing",
                "Make the data set again, or copy it again.",
            )
        found.append((folder, {str(light): float(level) for light, level in levels.items()}))
    return found


_LIST_FORM = 'It must be a list of {"folder": "relit/level_4", "levels": {"ambient": 4}} and so on.'


def radiance_in(path: Path) -> torch.Tensor:
    """``[3, H, W]`` float32 Linear Rec.709 of an OpenEXR; raises what ``exr_rec709`` raises."""
    return torch.from_numpy(exr_rec709(path)).permute(2, 0, 1).contiguous()
