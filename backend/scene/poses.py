# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses and their brackets as a reader finds them, before pictures are reduced and views are made of them."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...bridge import data_set
from ...bridge.errors import DataMismatchError, PhysHDRError
from .camera import Camera
from .pictures import picture_size
from .resize import Reduction
from .scene import PictureCache, View
from .source import PictureSource

#: Where nothing says which views are for testing: every eighth from the first, as 3DGS has it.
TEST_EVERY = 8
#: Where any layout keeps true radiance (``evaluate/truth.py``), by the poses' numbers. Never opened here.
TRUTH_FOLDERS = (*map(data_set.truth_folder, (data_set.TRAIN, data_set.TEST)), "images_hdr", "exr")


@dataclass(frozen=True)
class PictureFile:
    """A file and its exposure, seconds. ``source``: what is done to it; None: nothing."""

    path: Path
    seconds: float
    source: PictureSource | None = None

    @property
    def as_source(self) -> PictureSource:
        return self.source or PictureSource(self.path)


@dataclass(frozen=True)
class Pose:
    """A camera at full size and its pictures, by their place in the bracket, rising."""

    name: str
    index: int
    camera: Camera
    pictures: dict[int, PictureFile]
    lighting_levels: tuple[float, ...] = (1.0,)

    def view(self, reduction: Reduction, cache: PictureCache) -> View:
        """The view, its camera at the reduced size."""
        return View(
            self.name,
            reduction.camera(self.camera),
            tuple(picture.seconds for picture in self.pictures.values()),
            tuple(picture.as_source for picture in self.pictures.values()),
            self.index,
            self.lighting_levels,
            cache,
            tuple(self.pictures),
        )


def one_size(paths: Sequence[Path]) -> tuple[int, int]:
    """``(width, height)`` that all these pictures have, after a look at each header.

    Raises what ``picture_size`` raises, ``DataMismatchError`` where sizes differ: the first fault, and how
    many there are.
    """
    faults: list[PhysHDRError] = []
    first: tuple[Path, tuple[int, int]] | None = None
    for path in paths:
        try:
            size = picture_size(path)
            if first is not None and size != first[1]:
                raise wrong_size(path, size, *first)
            first = first or (path, size)
        except PhysHDRError as error:
            faults.append(error)
    if faults:
        if len(faults) > 1:
            message = f"{len(faults)} of {len(paths)} pictures cannot be used. The first: {faults[0].message}"
            raise type(faults[0])(message, faults[0].hint)
        raise faults[0]
    assert first is not None, "a reader asks for the size of one picture at least"
    return first[1]


def wrong_size(path: Path, size: tuple[int, int], first: Path, right: tuple[int, int]) -> DataMismatchError:
    """The error for a picture that has not the size of the others."""
    return DataMismatchError(
        f"{path} is {size[0]}×{size[1]} pixels, {first} is {right[0]}×{right[1]}",
        "All pictures must have one size: resize it, or delete it and make the data set again.",
    )


def fitted(camera: Camera, size: tuple[int, int], told_by: Path, picture: Path) -> Camera:
    """A camera that was measured at another size, at the size of the pictures.

    Raises ``DataMismatchError`` where the two have not one shape, to a pixel's rounding.
    """
    width, height = size
    if (camera.width, camera.height) == size:
        return camera
    if abs(camera.height * width - height * camera.width) > max(camera.width, width):
        raise DataMismatchError(
            f"{told_by} was made from pictures of {camera.width}×{camera.height}, {picture} is "
            f"{width}×{height}: another shape",
            "Use the pictures that the cameras were found with, neither cropped nor turned.",
        )
    return camera.resized(width, height)


# ---- splits and names --------------------------------------------------------------------------------


def split_named(name: str) -> str | None:
    """``train`` or ``test``, where a name has one of them as a word (``train_r_0``; ``latest`` has none)."""
    words = {word for word in re.split(r"[^a-z]+", name.lower()) if word in ("train", "test")}
    return words.pop() if len(words) == 1 else None


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
    """Training and test poses and the rule in words: by name, else every eighth pose is for testing."""
    named = split_by_name(poses)
    if named is not None and named[1]:
        return *named, "split by names: they say 'train' or 'test'"
    if len(poses) == 1:
        return list(poses), [], "no test views: there is one pose only"
    test = list(poses[::TEST_EVERY])
    train = [pose for k, pose in enumerate(poses) if k % TEST_EVERY]
    return train, test, f"split by order of names: poses 0, {TEST_EVERY}, {2 * TEST_EVERY} … are for testing"


def bracket_name(name: str) -> tuple[str, int, str] | None:
    """``train_r_0_2.png`` → ``("train_r_0", 2, "png")``: pose, place in the bracket; None for other names.

    One digit without a leading zero is a place; ``frame_00012`` is a pose's number.
    """
    parts = re.fullmatch(r"(.+)_(\d)\.([^./]+)", name)
    return (parts.group(1), int(parts.group(2)), parts.group(3)) if parts else None


def pose_number(name: str) -> int | None:
    """The number at the end of a name (``train_r_12`` → 12); None where there is none."""
    digits = re.search(r"(\d+)$", name)
    return int(digits.group()) if digits else None


def numbered(root: Path, poses: Sequence[Pose]) -> list[Pose]:
    """The poses by the numbers of their names where the data set holds true radiance, which these name.

    Elsewhere as they are. Raises ``DataMismatchError`` for a name without a number; ``check_numbers`` of each
    split comes after it.
    """
    truth = next((folder for folder in TRUTH_FOLDERS if (root / folder).is_dir()), None)
    if truth is None:
        return list(poses)
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


def check_numbers(poses: Sequence[Pose], split: str, told_by: Path) -> None:
    """Raises ``DataMismatchError`` where two poses of a split have one number, which names their truth."""
    number, times = max(Counter(pose.index for pose in poses).items(), key=lambda c: c[1], default=(0, 1))
    if times > 1:
        names = [pose.name for pose in poses if pose.index == number]
        raise DataMismatchError(
            f"{told_by}: {split} poses {', '.join(map(repr, names))} have one number, {number}",
            "Number the poses of a split without repetition: the number names the truth.",
        )


def missing_in_words(poses: Sequence[Pose]) -> str | None:
    """Which exposures some poses have not, for ``Scene.messages``; None where all have all."""
    places = sorted({k for pose in poses for k in pose.pictures})
    counts = {k: sum(k not in pose.pictures for pose in poses) for k in places}
    lacking = [f"{k} in {count}" for k, count in counts.items() if count]
    return f"exposures are missing: {', '.join(lacking)} of {len(poses)} poses" if lacking else None
