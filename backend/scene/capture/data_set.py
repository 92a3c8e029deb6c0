# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a capture as a data set in the packaging of GaussHDR (docs/formats.md).

``images/<split>_<pose:03d>_<k>.png`` (``masks/`` of the same names: black where a picture is not to be
compared), ``exposure.json`` (file name → seconds), ``sparse/0`` of COLMAP with
one image for each pose, named as its picture k = 0, ``prepare.json``: where it all came from, and of photos
under several lights ``lights.json``.
"""

import json
import math
import os
import re
import secrets
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import rmtree
from typing import Any, BinaryIO

import numpy as np
from filelock import FileLock
from PIL import Image

from ....bridge.affine import quaternion_of
from ....bridge.atomic import patiently
from ....bridge.data_set import CAPTURE_FILE, EXPOSURE_FILE
from ....bridge.errors import OutputError
from ....bridge.light_groups import LightGroups, write_light_groups
from ....bridge.regular import resolved
from ..held_out_views import held_out_places
from ..lens import Lens
from ..pictures import deep_png
from .brackets import Brackets
from .choice import NUMBERS
from .exposures import some_names
from .photos import MASKS, Photo
from .structure import RegisteredPose, Structure

#: Locked while the temporary folder that it lies in is used.
IN_USE_FILE = "in-use.lock"
#: All that this command, or a desktop unasked, writes into a data set.
WRITTEN = re.compile(
    r"prepare\.json|exposure\.json|lights\.json|images(/(train|test)_\d+_\d\.png)?"
    r"|masks(/(train|test)_\d+_\d\.png)?|sparse(/0(/(cameras|images|points3D)\.bin)?)?"
    r"|(.+/)?(\.DS_Store|Thumbs\.db|desktop\.ini)"  # by whoever has looked at the folder
)
#: Of fewer places under other light all are trained from.
FEWEST_LIT = 5
#: COLMAP's number for a pinhole camera with fx, fy, cx, cy.
PINHOLE = 1


@contextmanager
def new_folder(out: Path, overwrite: bool) -> Iterator[Path]:
    """A folder beside ``out`` whose content takes its place there only if the block ends without an error.

    Raises ``OutputError`` where ``out`` is a mount point, or is not empty, unless ``overwrite`` and this
    command made all that is in it.
    """
    out = resolved(out)
    if out.is_symlink():
        raise OutputError(f"{out} is a link that leads to itself", "Delete it, or give another folder.")
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file", "Give a folder that is not there yet.")
    if os.path.ismount(out):  # what lies beside it is another file system
        raise OutputError(f"{out} is a mount point", f"Give a folder in it, such as {out / 'data'}.")
    if out.is_dir() and any(out.iterdir()):
        if not overwrite:
            raise OutputError(f"{out} is not empty", "Give another folder, or --overwrite to replace it.")
        if not (out / CAPTURE_FILE).is_file():
            raise OutputError(
                f"{out} was not made by 'physhdr prepare': it is not replaced", "Give another folder."
            )
        if others := _not_ours(out):
            raise OutputError(
                f"{out} holds what 'physhdr prepare' did not write: {some_names(others)}: it is not replaced",
                "Move that away, or give another folder.",
            )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(out)
        # Not by tempfile: on Windows what lies in its folders stays closed to all but its maker, wherever it
        # is moved, and it tries two billion names where permissions refuse every one.
        temporary = out.with_name(f".{out.name}-{secrets.token_hex(4)}")
        temporary.mkdir()
    except OSError as error:
        raise _cannot_write(out, error) from error
    in_use = FileLock(temporary / IN_USE_FILE, mode=0o600, fallback_to_soft=False)
    failed = True
    try:
        with suppress(OSError):  # a disk that knows no locks: what a kill leaves there stays
            in_use.acquire(timeout=0)
        made = temporary / "data"
        made.mkdir()
        yield made
        if out.exists():
            _replace(out, made, temporary / "replaced")
        else:
            patiently(partial(made.rename, out))
        failed = False
    except OSError as error:
        raise _cannot_write(out, error) from error
    finally:
        in_use.release()
        # Where not even that could be put back, the former data set stays there.
        if not (failed and (temporary / "replaced").exists()):
            rmtree(temporary, ignore_errors=True)


def _remove_leftovers(out: Path) -> None:
    """Remove what calls that were killed left beside ``out``; of one that still runs the lock is held.

    Not where a data set was just being replaced: the former one lies there.
    """
    ours = re.compile(rf"\.{re.escape(out.name)}-[a-z0-9_]{{8}}")
    for folder in out.parent.iterdir():
        lock = folder / IN_USE_FILE
        if ours.fullmatch(folder.name) and lock.is_file() and not (folder / "replaced").exists():
            with suppress(OSError):
                with FileLock(lock, timeout=0, fallback_to_soft=False):
                    rmtree(folder, ignore_errors=True)
                rmtree(folder, ignore_errors=True)  # Windows removes no file that is open: the lock itself


def _replace(out: Path, made: Path, replaced: Path) -> None:
    """What is in ``made`` goes into ``out``, what was there into ``replaced``; all back where that fails.

    ``out`` itself stays: a shell may stand in it.
    """
    replaced.mkdir()
    moves = [(entry, replaced / entry.name) for entry in out.iterdir()]
    moves += [(entry, out / entry.name) for entry in made.iterdir()]
    try:
        for source, target in moves:
            patiently(partial(source.rename, target))
    except BaseException:
        for source, target in reversed(moves):
            if target.exists() and not source.exists():
                patiently(partial(target.rename, source))
        replaced.rmdir()
        raise


def _not_ours(out: Path) -> list[str]:
    """What is in ``out`` that this command does not write; of a folder only its own name."""
    others = []
    for folder, folders, files in os.walk(out):
        inside = Path(folder).relative_to(out)
        names = [(inside / name).as_posix() for name in (*folders, *files)]
        others += [name for name in names if not WRITTEN.fullmatch(name)]
        folders[:] = [name for name in folders if (inside / name).as_posix() not in others]
    return sorted(others)


def _cannot_write(out: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write {out}: {error.strerror or error}", "Check its permissions and the disk's free space."
    )


@dataclass(frozen=True)
class Written:
    """What is in a data set: poses by split, pictures, points and their mean distance from keypoints."""

    train: int
    test: int
    pictures: int
    points: int
    reprojection_error: float


def test_poses(
    brackets: Brackets, structure: Structure, every: int, borrowed: Collection[int] = ()
) -> set[int]:
    """The numbers of the registered poses for the test: all of each place that ``held_out_places`` chooses.

    By itself of the photos of each light, where those under other light than the standard have
    ``FEWEST_LIT`` places. ``every``: about how many places there are to one for the test; 0: none.
    ``borrowed``: poses that nobody found by themselves: their places are not for the test.
    """
    chosen: set[int] = set()
    place_of = brackets.place_of
    for group in brackets.groups:
        places: dict[int, list[int]] = {}
        for number in structure.registered:
            if brackets.poses[number].group == group:
                places.setdefault(place_of[number], []).append(number)
        places = {place: numbers for place, numbers in places.items() if not {*numbers} & {*borrowed}}
        if every and len(places) >= (FEWEST_LIT if group else 1):
            chosen |= _held_out(list(places.values()), structure, every)
    return chosen


def _held_out(groups: Sequence[Sequence[int]], structure: Structure, every: int) -> set[int]:
    """The poses of the places, each a group of them, that ``held_out_places`` chooses."""
    poses = [[structure.registered[number] for number in numbers] for numbers in groups]
    positions = np.array([np.mean([pose.position for pose in group], axis=0) for group in poses])
    directions = np.array([group[0].rotation[2] for group in poses])
    return {number for k in held_out_places(positions, directions, every) for number in groups[k]}


def write_data_set(
    folder: Path,
    brackets: Brackets,
    structure: Structure,
    lenses: Mapping[int, Lens],
    test_every: int,
    origin: dict[str, Any],
    done: Callable[[int, int], None] = lambda pictures, of: None,
    borrowed: Collection[int] = (),
    lights: LightGroups | None = None,
) -> Written:
    """Write the registered poses into ``folder``; ``done`` is told after every picture.

    ``lenses``: one for each of the structure's cameras. ``test_every``, ``borrowed``: as ``test_poses``.
    ``origin`` goes into ``prepare.json``, with the source of every picture. ``lights``: of the photos'
    groups, whose pictures are to be named.
    """
    test = test_poses(brackets, structure, test_every, borrowed)
    (folder / "images").mkdir()
    exposures: dict[str, float] = {}
    sources: dict[str, str] = {}
    names: dict[int, str] = {}
    pictures: dict[str, list[str]] = {}
    total = sum(len(brackets.poses[number].photos) for number in structure.registered)
    written = 0
    # Of each place, not pose: of a hand-held bracket each photo is a pose.
    place_of = brackets.place_of
    shortest: dict[int, float] = {}
    for number in structure.registered:
        place = place_of[number]
        shortest[place] = min(shortest.get(place, math.inf), *brackets.poses[number].seconds)
    # By camera: a lens keeps what it needs for one picture after the other.
    for number, pose in sorted(structure.registered.items(), key=lambda item: (item[1].camera, item[0])):
        bracket = brackets.poses[number]
        stem = f"{'test' if number in test else 'train'}_{number:03d}"
        k_of = NUMBERS[len(bracket.photos)]
        for k, photo, seconds in zip(k_of, bracket.photos, bracket.seconds, strict=True):
            name = f"{stem}_{k}.png"
            shorter = seconds > shortest[place_of[number]]
            _write_picture(folder, name, photo, lenses[pose.camera], shorter)
            exposures[name], sources[name] = seconds, photo.name
            written += 1
            done(written, total)
        names[number] = f"{stem}_0.png"
        pictures.setdefault(bracket.group, []).append(stem)
    _write_json(folder / EXPOSURE_FILE, dict(sorted(exposures.items())))
    _write_json(folder / CAPTURE_FILE, {**origin, "sources": dict(sorted(sources.items()))})
    placed = lights.of_pictures(pictures) if lights is not None else None
    if placed is not None:
        write_light_groups(folder, placed)
    points = _write_sparse(folder / "sparse" / "0", structure, lenses, names)
    error = reprojection_error(structure, lenses)
    return Written(len(structure.registered) - len(test), len(test), written, points, error)


def _write_picture(folder: Path, name: str, photo: Photo, lens: Lens, shorter: bool) -> None:
    codes, keep = photo.codes(shorter)
    picture = lens.picture(codes)
    if picture.dtype == np.uint16:
        (folder / "images" / name).write_bytes(deep_png(picture))
    else:
        Image.fromarray(picture).save(folder / "images" / name)
    if keep is not None and not (straight := lens.mask(keep)).all():
        (folder / MASKS).mkdir(exist_ok=True)
        Image.fromarray(straight).save(folder / MASKS / name)


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def reprojection_error(structure: Structure, lenses: Mapping[int, Lens]) -> float:
    """Mean distance in pixels of the written pictures, over every observation of a point."""
    distances = []
    for pose in structure.registered.values():
        lens = lenses[pose.camera]
        seen = structure.positions[pose.points] @ pose.rotation.T + pose.translation
        projected = seen[:, :2] / seen[:, 2:] * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        distances.append(np.linalg.norm(projected - lens.straightened(pose.keypoints), axis=1))
    together = np.concatenate(distances)
    return float(together.mean()) if len(together) else 0.0


# ---- COLMAP's binary files (its documentation, "Output Format") ----------------------------------------


def _write_sparse(
    folder: Path, structure: Structure, lenses: Mapping[int, Lens], names: dict[int, str]
) -> int:
    """``cameras``, ``images`` and ``points3D.bin``; returns the number of points, those that a pose sees."""
    folder.mkdir(parents=True)
    with open(folder / "cameras.bin", "wb") as file:
        file.write(struct.pack("<Q", len(lenses)))
        for number, lens in lenses.items():
            head = struct.pack("<iiQQ", number, PINHOLE, lens.width, lens.height)
            file.write(head + struct.pack("<4d", lens.fx, lens.fy, lens.cx, lens.cy))
    tracks: dict[int, list[tuple[int, int]]] = {}
    with open(folder / "images.bin", "wb") as file:
        file.write(struct.pack("<Q", len(structure.registered)))
        for number, pose in structure.registered.items():
            _write_image(file, number + 1, pose, names[number], lenses[pose.camera])
            for place, point in enumerate(pose.points):
                tracks.setdefault(int(point), []).append((number + 1, place))
    with open(folder / "points3D.bin", "wb") as file:
        file.write(struct.pack("<Q", len(tracks)))
        for point, track in sorted(tracks.items()):
            file.write(struct.pack("<Q3d", point + 1, *structure.positions[point]))
            file.write(struct.pack("<3Bd", *structure.colours[point].tolist(), structure.errors[point]))
            file.write(struct.pack("<Q", len(track)) + np.array(track, "<i4").tobytes())
    return len(tracks)


def _write_image(file: BinaryIO, image_id: int, pose: RegisteredPose, name: str, lens: Lens) -> None:
    file.write(struct.pack("<i7d", image_id, *quaternion_of(pose.rotation), *pose.translation))
    file.write(struct.pack("<i", pose.camera) + name.encode() + b"\0")
    entries = np.empty(len(pose.points), np.dtype([("xy", "<f8", 2), ("point", "<i8")]))
    entries["xy"], entries["point"] = lens.straightened(pose.keypoints), pose.points + 1
    file.write(struct.pack("<Q", len(entries)) + entries.tobytes())
