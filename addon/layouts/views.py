# SPDX-License-Identifier: GPL-3.0-or-later
"""The views of a data set of any layout that is trained from: cameras, pictures, exposures. No bpy.

Which layout a folder is and what its files say comes from ``bridge.layouts``, as for the trainer's readers;
of pictures only the header is read, for the size. What the trainer does to pictures (reduces them, takes out
what a lens bends) is not done here: a camera sees what its photo shows.
"""

import os
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set, layouts
from ...bridge.colmap import find_model
from ...bridge.colmap_files import SparseImage, form_of, read_cameras, read_images
from ...bridge.errors import FileDamagedError, PhysHDRError
from ...bridge.layouts import Layout, llff
from ...bridge.layouts.checks import read_json, require, rigid_pose
from ...bridge.layouts.picture_files import (
    PICTURES,
    bracket_name,
    folder_there,
    picture_there,
    split_named,
    without_suffix,
)
from ...bridge.layouts.transforms import (
    SPLIT_LISTS,
    TRANSFORMS_FILE,
    Pinhole,
    frames_of,
    own_camera,
    picture_of,
    reduction_of,
    stated_camera,
    stated_lens,
)
from ...bridge.limits import EXPOSURE, is_number
from ...bridge.regular import read_text, regular_file
from .picture_size import picture_size

#: The split of views of which the trainer chooses some for testing.
VIEWS = "views"
COPY_AGAIN = "Copy the data set again, or make it again."
_COUNT = struct.Struct("<Q")


@dataclass(frozen=True, eq=False)
class View:
    """A view of a data set.

    ``name``: as the data set calls it, without suffix. ``split``: ``train``, ``test`` …, or ``VIEWS``.
    ``camera_to_world``: ``[4, 4]`` float64, rigid, looks down −Z, +Y up. ``camera``: at full size; None where
    nothing states the size. ``is_bent``: whether its lens bends straight lines. ``pictures``: the exposure of
    each, seconds; None where no file states it (EXIF may, which only the trainer reads). ``missing``:
    pictures that its files name and the folder lacks.
    """

    name: str
    split: str
    camera_to_world: np.ndarray
    camera: Pinhole | None
    is_bent: bool = False
    pictures: dict[Path, float | None] = field(default_factory=dict)
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Views:
    """The views of a folder. ``points``: how many structure from motion found, if any."""

    layout: Layout
    views: tuple[View, ...]
    points: int | None = None

    @property
    def seen(self) -> tuple[View, ...]:
        """Those that have a picture; all, of HDR-NeRF-Syn, whose pictures are not looked for here."""
        if self.layout is layouts.HDR_NERF_SYN:
            return self.views
        return tuple(view for view in self.views if view.pictures)

    @property
    def missing(self) -> tuple[str, ...]:
        """The pictures that files name and the folder lacks."""
        return tuple(name for view in self.views for name in view.missing)


def read_views(root: Path) -> Views | None:
    """The views of the data set in a folder, in the order of splits and then of its files.

    None where the folder has no known layout. Raises ``FileMissingError``, ``FileDamagedError``,
    ``DataMismatchError`` or ``BadValueError``, each with the file.
    """
    layout = layouts.layout_of(root)
    if layout is None:
        return None
    views = tuple(_READERS[layout.name](root, layout))
    if not any(view.split == data_set.TEST for view in views):
        # As the trainer has it: without test views those of validation are the test.
        tests = {data_set.VALIDATION: data_set.TEST}
        views = tuple(replace(view, split=tests.get(view.split, view.split)) for view in views)
    return Views(layout, views, _point_count(root))


def _known(seconds: Any) -> float | None:
    return float(seconds) if is_number(seconds) and seconds in EXPOSURE else None


# ---- HDR-NeRF-Syn and our own data sets --------------------------------------------------------------------


def _of_ours(root: Path, _: Layout) -> Iterator[View]:
    stated = data_set.read_info(root, COPY_AGAIN).get("resolution")
    for split in data_set.splits_there(root):
        path = root / data_set.transforms_file(split)
        if not path.exists():
            continue
        content = read_json(path)
        size = tuple(stated) if isinstance(stated, list) and len(stated) == 2 else None
        for name, entry in frames_of(path, content):
            stem = data_set.stem_of(name)
            where = f"frame '{stem:.80}'"
            pose = rigid_pose(path, require(path, entry, "transform_matrix", f": {where}"), f"'{stem:.80}'")
            size = size or picture_size(root / data_set.picture_file(stem, 0))
            camera, lens = own_camera(path, where, content | entry, size) if size else (None, None)
            yield View(stem, split, pose, camera, lens is not None)


# ---- transforms.json of nerfstudio and instant-ngp, and NeRF's synthetic scenes ----------------------------


def _of_nerfstudio(root: Path, _: Layout) -> Sequence[View]:
    path = root / TRANSFORMS_FILE
    content = read_json(path)
    splits = {
        data_set.plain_name(name): split
        for split, key in SPLIT_LISTS.items()
        if isinstance(names := content.get(key), list)
        for name in names
        if isinstance(name, str)
    }
    # As the trainer has it: where only frames that are held out are listed, it trains on the others.
    has_training = content.get(SPLIT_LISTS[data_set.TRAIN]) is not None
    unlisted = data_set.TRAIN if splits and not has_training else VIEWS
    views = list(_listed_in(root, path, content, splits, unlisted))
    return views if splits else _split_by_name(views)


def _of_nerf(root: Path, _: Layout) -> Iterator[View]:
    """A file for each split, as ``transforms.json`` is."""
    for split in SPLIT_LISTS:
        path = root / data_set.transforms_file(split)
        if path.exists():
            yield from _listed_in(root, path, read_json(path), {}, split)


def _listed_in(
    root: Path, path: Path, content: dict[str, Any], splits: dict[str, str], unlisted: str
) -> Iterator[View]:
    """The views of one file. ``splits``: of pictures, by name; ``unlisted``: that of the others."""
    for listed, entry in frames_of(path, content):
        name = data_set.plain_name(listed)
        where = f"frame '{name:.80}'"
        entries = content | entry
        file = picture_of(root, path, listed)
        stored, (_, factor) = picture_size(file), reduction_of(root, path, listed)
        size = (factor * stored[0], factor * stored[1]) if stored else None
        pose = rigid_pose(path, require(path, entries, "transform_matrix", f": {where}"), f"'{name:.80}'")
        camera = lens = None
        if size or {"w", "h"} <= entries.keys():
            camera = stated_camera(path, where, entries, size or (0, 0))
            lens = stated_lens(path, where, entries, camera)
        is_there = os.path.isfile(file)  # Path.is_file raises where a name is too long
        yield View(
            without_suffix(name),
            splits.get(name, unlisted),
            pose,
            camera,
            lens is not None,
            {file: _known(entry.get("exposure_time"))} if is_there else {},
            () if is_there else (name,),
        )


# ---- COLMAP, GaussHDR, HDR-GS, and what physhdr prepare writes ---------------------------------------------


def _of_colmap(root: Path, layout: Layout) -> Sequence[View]:
    model, folder = find_model(root), folder_there(root / PICTURES)
    assert model is not None and folder is not None, "the layout has both"
    cameras = read_cameras(model)
    stated: dict[str, float | None] = {}
    if (root / data_set.EXPOSURE_FILE).exists():
        for name, seconds in read_json(root / data_set.EXPOSURE_FILE).items():
            stated[data_set.plain_name(name).removeprefix(f"{PICTURES}/")] = _known(seconds)
    names: dict[str, list[str]] = {}
    best: dict[str, SparseImage] = {}
    for placed in sorted(read_images(model), key=lambda placed: placed.name):
        pose = _pose_of(placed.name) if stated else without_suffix(placed.name)
        names.setdefault(pose, []).append(placed.name)
        # A bracket is one view: as the trainer has it, of the picture which shows the most points.
        if pose not in best or placed.observed > best[pose].observed:
            best[pose] = placed
    of_pose: dict[str, list[str]] = {}
    for name in stated:
        of_pose.setdefault(_pose_of(name), []).append(name)
    views = []
    for pose, placed in best.items():
        real = cameras.get(placed.camera)
        if real is None:
            file = model / f"images.{form_of(model)}"
            message = f"{file}: '{placed.name}' has camera {placed.camera}, which is not there"
            raise FileDamagedError(message, COPY_AGAIN)
        # Pictures of a bracket of which the model has only one are named by the exposure file alone.
        files = {name: picture_there(folder / name) for name in of_pose.get(pose, names[pose])}
        at = placed.camera_to_world
        camera = Pinhole(at, real.width, real.height, *real.intrinsics(model, placed.camera))
        there = {file: stated.get(name) for name, file in files.items() if os.path.isfile(file)}
        missing = tuple(name for name, file in files.items() if file not in there)
        views.append(View(pose, VIEWS, at, camera, not real.is_pinhole, there, missing))
    if layout is layouts.HDR_GS:
        return [
            replace(view, split=data_set.TEST if place % 2 else data_set.TRAIN)
            for place, view in enumerate(sorted(views, key=lambda view: view.name))
        ]
    return _split_by_name(views)


def _pose_of(name: str) -> str:
    """The pose of a bracket's picture: ``train_03_2.jpg`` → ``train_03``."""
    parts = bracket_name(name)
    return parts[0] if parts else without_suffix(name)


def _point_count(root: Path) -> int | None:
    """How many points structure from motion found; None where there is no model, or it cannot be read."""
    model = find_model(root)
    if model is None:
        return None
    try:
        if (model / "points3D.bin").exists():
            with open(regular_file(model / "points3D.bin"), "rb") as file:
                return int(_COUNT.unpack(file.read(_COUNT.size))[0])
        lines = read_text(model / "points3D.txt").splitlines()
    except (OSError, PhysHDRError, struct.error):
        return None
    return sum(1 for line in lines if line and not line.startswith("#"))


# ---- HDR-NeRF-Real: LLFF's poses ---------------------------------------------------------------------------


def _of_real(root: Path, _: Layout) -> Iterator[View]:
    """LLFF's poses, or those of COLMAP's model beside them: the trainer takes that where it is there."""
    path, folder = root / llff.POSES_FILE, folder_there(root / llff.PICTURES) or root / llff.PICTURES
    names = llff.picture_names(folder)
    rows = llff.read_rows(path, folder, names)
    seconds = {key: float(row[17]) for key, row in zip(names, rows, strict=True)}
    cameras = {
        number: (llff.pinhole_of(path, number, llff.middle_row(names, rows, number)), False)
        for number in dict.fromkeys(number for number, _ in names)
    }
    model = find_model(root)
    for number, (camera, is_bent) in (cameras if model is None else _of_model(model)).items():
        pictures: dict[Path, float | None] = {
            folder / name: seconds[key] for key, name in names.items() if key[0] == number
        }
        split = data_set.TEST if number % 2 else data_set.TRAIN
        yield View(f"{number:03d}", split, camera.camera_to_world, camera, is_bent, pictures)


def _of_model(model: Path) -> dict[int, tuple[Pinhole, bool]]:
    """The cameras of a model by the numbers of their poses, and whether they bend lines."""
    cameras, found = read_cameras(model), {}
    for placed in sorted(read_images(model), key=lambda placed: placed.name):
        digits = re.match(r"(\d+)_\d\.", Path(placed.name).name)
        real = cameras.get(placed.camera)
        if digits and real and int(digits.group(1)) not in found:
            intrinsics = real.intrinsics(model, placed.camera)
            camera = Pinhole(placed.camera_to_world, real.width, real.height, *intrinsics)
            found[int(digits.group(1))] = camera, not real.is_pinhole
    return found


# ---- what they share ---------------------------------------------------------------------------------------


def _split_by_name(views: Sequence[View]) -> Sequence[View]:
    """``train`` and ``test`` where all names say so, as the trainer has it; else all are ``VIEWS``."""
    named = [split_named(view.name) for view in views]
    splits = [split for split in named if split is not None]
    if len(splits) < len(views):
        return views
    return [replace(view, split=split) for view, split in zip(views, splits, strict=True)]


_READERS: dict[str, Callable[[Path, Layout], Iterable[View]]] = {
    layouts.HDR_NERF_SYN.name: _of_ours,
    layouts.HDR_NERF_REAL.name: _of_real,
    layouts.GAUSSHDR.name: _of_colmap,
    layouts.HDR_GS.name: _of_colmap,
    layouts.COLMAP.name: _of_colmap,
    layouts.NERF.name: _of_nerf,
    layouts.NERFSTUDIO.name: _of_nerfstudio,
}
