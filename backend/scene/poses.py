# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses and their brackets as a reader finds them, and the views made of them.

Readers pair cameras and files; what all layouts share is here: which pictures can be read,
how sizes, orientations and lenses are reconciled, which views are for testing.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...bridge.errors import BadValueError, DataMismatchError, FileMissingError, PhysHDRError
from ...bridge.layouts.picture_files import pose_number, split_named
from ...bridge.layouts.truth_folders import truth_there
from .camera import Camera
from .exif import LYING, orientation_of, tags_of_file
from .held_out_views import EVERY, FEWEST, held_out_places, same_places
from .lens import Lens, RealCamera, Reduced, lenses_by_size
from .pictures import picture_size
from .resize import Reduction, is_shaped
from .scene import PictureCache, View
from .source import PictureSource
from .undistorted import store_for

#: A share of each photo beyond this that no picture shows is reported.
MUCH = 0.05


@dataclass(frozen=True)
class PictureFile:
    """A file and its exposure, seconds. ``mask``: black where it is not compared. ``orientation``: EXIF's."""

    path: Path
    seconds: float
    mask: Path | None = None
    orientation: int = 1


@dataclass(frozen=True)
class Pose:
    """A camera at full size and its pictures, by their place in the bracket, rising.

    ``lens``: of a camera that bends straight lines, at the size of its pictures; ``camera`` then has its pose
    and its size. None: a pinhole. The light is as in ``View``.
    """

    name: str
    index: int
    camera: Camera
    pictures: dict[int, PictureFile]
    lighting_levels: tuple[float | None, ...] = (1.0,)
    lens: RealCamera | None = None
    standard_levels: tuple[float, ...] = ()
    group: str = ""


class Views:
    """Makes views of poses: the same reduction for all, and no distortion.

    ``messages``: what was decided, for ``Scene.messages``, the size first. Raises ``FileMissingError`` where
    a lens needs pycolmap and it is not installed, ``BadValueError`` for an impossible lens.
    """

    def __init__(self, root: Path, poses: Sequence[Pose], reduction: Reduction) -> None:
        self.reduction = reduction
        bent = [pose for pose in poses if pose.lens is not None]
        real = {pose.lens: pose.lens.pycolmaps() for pose in bent if pose.lens is not None}
        try:
            self._lenses: dict[RealCamera, Lens] = lenses_by_size(real, 1.0 / reduction.factor)
        except BadValueError as error:
            raise BadValueError(f"{root}: {error.message}", error.hint) from error
        self.messages: tuple[str, ...] = (_size_message(poses, reduction), *self._lens_messages())
        self._store = None
        if bent:
            # With the distortion pictures lose their size, at once; others of the data set are reduced alone.
            self._cache = PictureCache(reduction=replace(reduction, done=True))
            lenses = [(pose, self._lenses[pose.lens]) for pose in bent if pose.lens is not None]
            files = [
                (file.path, lens.width, lens.height)
                for pose, lens in lenses
                for file in pose.pictures.values()
            ]
            self._store, message = store_for(root, files)
            self.messages += (message,)
        else:
            self._cache = PictureCache(reduction=reduction)

    def of(self, poses: Iterable[Pose]) -> list[View]:
        """The views of some of the poses."""
        return [self._view(pose) for pose in poses]

    def _view(self, pose: Pose) -> View:
        lens = None if pose.lens is None else self._lenses[pose.lens]
        if lens is None:
            camera = self.reduction.camera(pose.camera)
            taken_out = Reduced(self.reduction) if self._lenses and self.reduction.factor > 1.0 else None
        else:
            sides, focal_lengths = (lens.width, lens.height), (lens.fx, lens.fy)
            camera = Camera(pose.camera.camera_to_world, *sides, *focal_lengths, lens.cx, lens.cy)
            taken_out = lens
        sources = (
            PictureSource(
                file.path,
                lens=taken_out,
                mask_path=file.mask,
                orientation=file.orientation,
                store=None if lens is None else self._store,
            )
            for file in pose.pictures.values()
        )
        return View(
            pose.name,
            camera,
            tuple(picture.seconds for picture in pose.pictures.values()),
            tuple(sources),
            pose.index,
            pose.lighting_levels,
            self._cache,
            tuple(pose.pictures),
            pose.standard_levels,
            pose.group,
        )

    def _lens_messages(self) -> tuple[str, ...]:
        """Messages on the distortion that is removed, and how much pictures lose by it."""
        if not self._lenses:
            return ()
        first, lens = next(iter(self._lenses.items()))
        several = f"{len(self._lenses)} lenses, the first" if len(self._lenses) > 1 else "the lens"
        message = (
            f"the distortion of {several} {first.in_words()}, is removed: {lens.width}×{lens.height} remain"
        )
        cut = max(lens.cut for lens in self._lenses.values())
        if cut <= MUCH:
            return (message,)
        return (
            f"{message}; up to {cut:.0%} of a photo is beyond what a pinhole camera shows (110° at most)",
        )


def _size_message(poses: Sequence[Pose], reduction: Reduction) -> str:
    """What happens to the pictures' sizes."""
    counts = Counter((pose.camera.width, pose.camera.height) for pose in poses)
    if len(counts) == 1:
        return reduction.in_words(*next(iter(counts)))
    sizes = ", ".join(f"{count} of {width}×{height}" for (width, height), count in counts.most_common(4))
    what = f"pictures have {len(counts)} sizes ({sizes}{', …' if len(counts) > 4 else ''})"
    return f"{what}; {reduction.in_words(*max(counts, key=lambda size: size[0] * size[1]))}"


def widest(poses: Iterable[Pose]) -> int:
    """The width of the widest picture: what decides the reduction of all."""
    return max(pose.camera.width for pose in poses)


# ---- pictures, their sizes and turns -------------------------------------------------------------------


def sizes_of(
    paths: Iterable[Path],
) -> tuple[dict[Path, tuple[int, int]], dict[Path, PhysHDRError]]:
    """``(width, height)`` of each picture by its header, and what is wrong with those that have no such."""
    sizes: dict[Path, tuple[int, int]] = {}
    faults: dict[Path, PhysHDRError] = {}
    for path in paths:
        try:
            sizes[path] = picture_size(path)
        except PhysHDRError as error:
            faults[path] = error
    return sizes, faults


def skipped_messages(
    what: str, count: int, faults: Mapping[Path, PhysHDRError], root: Path, share_left: float
) -> tuple[str, ...]:
    """Messages on those of ``count`` ``what`` ("frames") whose picture cannot be used; () without any.

    Raises the first fault where less than half of all poses is left.
    """
    if not faults:
        return ()
    missing = [path for path, fault in faults.items() if isinstance(fault, FileMissingError)]
    damaged = [fault for fault in faults.values() if not isinstance(fault, FileMissingError)]
    if share_left < 0.5:
        first = next(iter(faults.values()))
        message = (
            f"{len(faults)} of {count} {what} have no picture that can be used. The first: {first.message}"
        )
        there = isinstance(first, FileMissingError)
        hint = "Put the pictures where they are looked for, under these names." if there else first.hint
        raise type(first)(message, hint)
    messages = []
    if missing:
        name = missing[0].relative_to(root).as_posix()
        messages.append(f"{len(missing)} of {count} {what} have no picture: skipped (first: {name:.200})")
    if damaged:
        message = f"{len(damaged)} of {count} {what} have a picture that cannot be read"
        messages.append(f"{message}: skipped (first: {damaged[0].message})")
    return tuple(messages)


def all_sizes(paths: Sequence[Path]) -> dict[Path, tuple[int, int]]:
    """``(width, height)`` of each picture, of which none may be missing.

    Raises what ``picture_size`` raises: the first fault, and how many there are.
    """
    sizes, faults = sizes_of(paths)
    _raise_first(list(faults.values()), len(paths))
    return sizes


def one_size(paths: Sequence[Path]) -> tuple[int, int]:
    """``(width, height)`` that all these pictures have, after a look at each header.

    Raises as ``all_sizes``, and ``DataMismatchError`` where sizes differ.
    """
    sizes = all_sizes(paths)
    first = paths[0]
    odd = [path for path in paths if sizes[path] != sizes[first]]
    _raise_first([wrong_size(path, sizes[path], first, sizes[first]) for path in odd], len(paths))
    return sizes[first]


def _raise_first(faults: Sequence[PhysHDRError], count: int) -> None:
    """The first fault of ``count`` pictures' faults, and how many there are; nothing where there are none."""
    if len(faults) > 1:
        message = f"{len(faults)} of {count} pictures cannot be used. The first: {faults[0].message}"
        raise type(faults[0])(message, faults[0].hint)
    if faults:
        raise faults[0]


def size_of_bracket(paths: Sequence[Path], sizes: Mapping[Path, tuple[int, int]]) -> tuple[int, int]:
    """The size of one pose's pictures; raises ``DataMismatchError`` where they differ."""
    first = paths[0]
    for path in paths:
        if sizes[path] != sizes[first]:
            raise wrong_size(path, sizes[path], first, sizes[first])
    return sizes[first]


def wrong_size(path: Path, size: tuple[int, int], first: Path, right: tuple[int, int]) -> DataMismatchError:
    """The error for a picture that has not the size of the others."""
    return DataMismatchError(
        f"{path} is {size[0]}×{size[1]} pixels, {first} is {right[0]}×{right[1]}",
        "All pictures must have one size: resize it, or delete it and make the data set again.",
    )


def turn(path: Path, stored: tuple[int, int], stated: tuple[int, int]) -> int:
    """EXIF's orientation that a picture is to be turned by: 1, as it is stored, unless only turned it fits.

    Structure from motion looks at pictures as they are stored (COLMAP 4.2 does), and so do the loaders of
    nerfstudio and instant-ngp. But cameras found on turned copies have width and height swapped.
    """
    if is_shaped(stored, stated) or not is_shaped((stored[1], stored[0]), stated):
        return 1
    orientation = orientation_of(tags_of_file(path))
    return orientation if orientation in LYING else 1


def at_size_of_pictures(pose: Pose, sizes: Mapping[Path, tuple[int, int]], origin: Path) -> Pose:
    """The pose with camera, lens and pictures at one size and in one orientation.

    ``sizes``: of its pictures as stored. Raises ``DataMismatchError`` where they are not of one
    size, or of another shape than the camera.
    """
    paths = [file.path for file in pose.pictures.values()]
    first, stored = paths[0], size_of_bracket(paths, sizes)
    camera = pose.camera
    orientation = turn(first, stored, (camera.width, camera.height))
    size = (stored[1], stored[0]) if orientation in LYING else stored
    if orientation != 1:
        pictures = {k: replace(file, orientation=orientation) for k, file in pose.pictures.items()}
        pose = replace(pose, pictures=pictures)
    lens = None if pose.lens is None else pose.lens.resized(*size)
    return replace(pose, camera=fitted(camera, size, origin, first), lens=lens)


def fitted(
    camera: Camera,
    size: tuple[int, int],
    origin: Path,
    picture: Path,
    remedy: str = "Use the pictures that the cameras were found with, neither cropped nor turned.",
) -> Camera:
    """A camera that was measured at another size, at the size of the pictures.

    Raises ``DataMismatchError``, with ``remedy``, where the two have not one shape, to a pixel's rounding.
    """
    width, height = size
    if (camera.width, camera.height) == size:
        return camera
    if not is_shaped(size, (camera.width, camera.height)):
        raise DataMismatchError(
            f"{origin} was made from pictures of {camera.width}×{camera.height}, {picture} is "
            f"{width}×{height}: another shape",
            remedy,
        )
    return camera.resized(width, height)


def mask_messages(poses: Iterable[Pose]) -> tuple[str, ...]:
    """How many pictures have masks, where any has."""
    files = [file for pose in poses for file in pose.pictures.values()]
    masked = sum(file.mask is not None for file in files)
    if not masked:
        return ()
    return (f"{masked} of {len(files)} pictures have masks: black areas are not compared",)


# ---- splits and names --------------------------------------------------------------------------------


def split_by_name(poses: Sequence[Pose]) -> tuple[list[Pose], list[Pose]] | None:
    """Training and test poses where each name says which, as GaussHDR's; None where one does not, or none is
    for training.
    """
    splits = [split_named(pose.name) for pose in poses]
    if None in splits or "train" not in splits:
        return None
    train, test = (
        [pose for pose, its in zip(poses, splits, strict=True) if its == split] for split in ("train", "test")
    )
    return train, test


def split_somehow(poses: Sequence[Pose]) -> tuple[list[Pose], list[Pose], str]:
    """Training and test poses and the rule in words: by name, else every eighth that lies between others."""
    named = split_by_name(poses)
    if named is not None and named[1]:
        return *named, "split by names: they say 'train' or 'test'"
    positions = np.stack([pose.camera.position for pose in poses])
    directions = np.stack([-pose.camera.camera_to_world[:3, 2] for pose in poses])
    places = same_places(positions, directions)
    siblings = _siblings_message([[poses[k] for k in place] for place in places])
    if len(places) < FEWEST:
        what = "place" if siblings else "pose"
        few = f"is one {what}" if len(places) == 1 else f"are two {what}s"
        return list(poses), [], f"no test views: there {few} only{siblings}"
    chosen = set(held_out_places(positions, directions))
    test = [pose for k, pose in enumerate(poses) if k in chosen]
    train = [pose for k, pose in enumerate(poses) if k not in chosen]
    rule = (
        f"split by place: of each {EVERY} {'places' if siblings else 'poses'} in the order of names one that "
        f"others surround is for testing ({len(test)} of {len(poses)}{' poses' if siblings else ''})"
        f"{siblings}"
    )
    return train, test, rule


def _siblings_message(places: Sequence[Sequence[Pose]]) -> str:
    """A clause on poses of which several are of one place; empty where none are."""
    count = sum(map(len, places))
    if len(places) == count:
        return ""
    message = f"; they are of {len(places)} places, each for testing or for training as a whole"
    exposed = ({picture.seconds for pose in place for picture in pose.pictures.values()} for place in places)
    if all(len(pose.pictures) == 1 for place in places for pose in place) and any(
        len(seconds) > 1 for seconds in exposed
    ):
        message += ". Where these are exposure brackets, 'physhdr prepare' makes one view of each"
    return message


def numbered(root: Path, poses: Sequence[Pose]) -> list[Pose]:
    """The poses by the numbers of their names where the data set holds true radiance, which these name.

    Elsewhere as they are. Raises ``DataMismatchError`` for a name without a number, and for a picture that is
    true radiance itself; ``check_numbers`` of each split comes after it.
    """
    folders = truth_there(root)
    if not folders:
        return list(poses)
    for path in (picture.path for pose in poses for picture in pose.pictures.values()):
        if any(path.is_relative_to(root / folder) for folder in folders):
            raise DataMismatchError(
                f"{path} is a view's picture, and by its name true radiance, which is for evaluation only",
                "Put the pictures to be trained from into another folder, and name them there.",
            )
    truth = folders[0]
    found = []
    for pose in poses:
        number = pose_number(pose.name)
        if number is None:
            raise DataMismatchError(
                f"{root}: the pose '{pose.name}' has no number, which names its true radiance in {truth}/",
                f"End its name with the number, as r_3; or move {truth}/ away.",
            )
        found.append(replace(pose, index=number))
    return found


def check_numbers(poses: Sequence[Pose], split: str, origin: Path) -> None:
    """Raises ``DataMismatchError`` where two poses of a split have one number, which names their truth."""
    number, times = max(Counter(pose.index for pose in poses).items(), key=lambda c: c[1], default=(0, 1))
    if times > 1:
        names = [pose.name for pose in poses if pose.index == number]
        raise DataMismatchError(
            f"{origin}: {split} poses {', '.join(map(repr, names))} have one number, {number}",
            "Number the poses of a split without repetition: the number names the truth.",
        )


def missing_message(poses: Sequence[Pose]) -> str | None:
    """Which exposures some poses have not, for ``Scene.messages``; None where all have all."""
    places = sorted({k for pose in poses for k in pose.pictures})
    counts = {k: sum(k not in pose.pictures for pose in poses) for k in places}
    lacking = [f"{k} in {count}" for k, count in counts.items() if count]
    return f"exposures are missing: {', '.join(lacking)} of {len(poses)} poses" if lacking else None
