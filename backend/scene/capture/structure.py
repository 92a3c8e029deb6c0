# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the cameras were: structure from motion by COLMAP (pycolmap), or a reconstruction that exists.

pycolmap is optional (the extra ``prepare``) and is imported only in ``scene/lens.py``, here, and in the
process that ``colmap_process.py`` is.
"""

import itertools
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ....bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, OutputError, PhysHDRError
from ..exif import LYING
from ..lens import require_pycolmap
from .brackets import Bracket
from .exposures import some_names
from .photos import Photo

#: Pictures are matched at most this wide and high: features of finer detail cost time and match badly.
MATCH_SIDE = 2000
#: Below this, features are looked for more patiently.
SMALL_SIDE = 800
#: Up to so many pictures each is matched with each other.
MOST_FOR_EXHAUSTIVE = 100
#: A longer capture matches each picture with so many that follow, and with some further ones.
SEQUENTIAL_OVERLAP = 12
#: Fewer cameras are no capture: nothing could be trained on them.
FEWEST_POSES = 3
CAPTURE_REMEDY = (
    "Neighbouring photos must show the same things from places a step apart (not only turned), sharp and "
    "with texture: docs/photos.md says how to shoot. --camera SIMPLE_RADIAL helps where photos are few."
)
NOT_OBEYED = (
    "COLMAP does not obey EXIF's orientation: give the pictures as COLMAP saw them, without that tag, or "
    "leave --poses out."
)


#: With less than this left (SQLite's pages, a log's lines) a disk counts as full.
FULL_BYTES = 1 << 20


class StructureError(PhysHDRError):
    """The photos' cameras cannot be recovered."""


@dataclass(frozen=True, eq=False)
class RegisteredPose:
    """One registered pose. World to camera in OpenCV axes: x_camera = ``rotation`` x + ``translation``.

    ``camera``: number in ``Structure.cameras``. ``keypoints``: ``[M, 2]`` pixels in the photo; ``points``:
    ``[M]`` index of the point that each shows.
    """

    camera: int
    rotation: np.ndarray
    translation: np.ndarray
    keypoints: np.ndarray
    points: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """Where it was, ``[3]``."""
        return -self.rotation.T @ self.translation


@dataclass(frozen=True, eq=False)
class Structure:
    """Cameras and points of one capture.

    ``cameras``: pycolmap's by number, those that are used, for photos of full size. ``registered``: by the
    pose's number in the capture. ``positions`` ``[P, 3]``, ``colours`` ``[P, 3]`` uint8, ``errors`` ``[P]``
    pixels of the full photo.
    """

    cameras: dict[int, Any]
    registered: dict[int, RegisteredPose]
    positions: np.ndarray
    colours: np.ndarray
    errors: np.ndarray

    def turned(self, rotation: np.ndarray) -> "Structure":
        """The same in a world that is turned by ``rotation`` ``[3, 3]``."""
        registered = {
            k: replace(pose, rotation=pose.rotation @ rotation.T) for k, pose in self.registered.items()
        }
        return replace(self, registered=registered, positions=self.positions @ rotation.T)


# ---- structure from motion ---------------------------------------------------------------------------


def recover(
    photos: Mapping[int, Photo],
    folder: Path,
    camera_model: str,
    threads: int = -1,
    at: Callable[[str, float], None] = lambda step, share: None,
    pairs: Sequence[tuple[int, int]] | None = None,
) -> Structure:
    """Structure from motion on one photo for each pose number.

    Photos of one ``lens`` share a camera. ``folder``: an empty one for what COLMAP writes.
    ``at`` is told each step and which share of it is done. ``pairs``: which are matched, by number; None:
    all, or neighbours in time where they are many. Photos of several exposures are matched as they are:
    SIFT's descriptors know no brightness, and CLAHE placed 27, 23 and 18 of 27 photos of hand-held brackets
    of 7, 11 and 14 EV, where these are 27, 22 and 18. Raises
    ``StructureError`` where fewer than ``FEWEST_POSES`` can be placed, or COLMAP fails; its log stays in the
    message. ``OutputError`` where the disk is full.
    """
    require_pycolmap()
    lenses = {lens: number for number, lens in enumerate(dict.fromkeys(p.lens for p in photos.values()))}
    names = {number: f"{lenses[photo.lens]}/{number:05d}.png" for number, photo in photos.items()}
    masked = _write_pictures(photos, names, folder, at)
    groups = []
    for lens in lenses:
        numbers = [number for number, photo in photos.items() if photo.lens == lens]
        guess = _first_guess(camera_model, [photos[number] for number in numbers])
        groups.append({"names": [names[number] for number in numbers], "camera_params": guess})
    if pairs is None:
        pairs = pairs_in_time(list(photos))
    job = {
        "folder": str(folder),
        "groups": groups,
        "match": [(names[one], names[other]) for one, other in pairs],
        "camera_model": camera_model,
        "masks": str(folder / "masks") if masked else "",
        "small": max(max(photo.width, photo.height) for photo in photos.values()) < SMALL_SIDE,
        "threads": threads,
    }
    run_colmap(job, folder, at=at)
    pieces = json.loads((folder / "pieces.json").read_text(encoding="utf-8"))
    if not pieces or len(pieces[0]) < FEWEST_POSES:
        most = len(pieces[0]) if pieces else 0
        raise StructureError(
            f"the photos do not fit together: of {len(photos)} poses {most} could be placed", CAPTURE_REMEDY
        )
    structure = _read(folder / "model", {Path(name).name: number for number, name in names.items()})
    return _at_size(structure, {number: (photo.width, photo.height) for number, photo in photos.items()})


def pairs_in_time(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """Which of the pictures, in the order in which they were taken, are matched: each with each, or, of more
    than ``MOST_FOR_EXHAUSTIVE``, with those that follow next and, at doubling distances, further ones.
    """
    if len(numbers) <= MOST_FOR_EXHAUSTIVE:
        return list(itertools.combinations(numbers, 2))
    return _neighbours(numbers)


def _neighbours(numbers: Sequence[int]) -> list[tuple[int, int]]:
    steps = {*range(1, SEQUENTIAL_OVERLAP + 1), *(1 << k for k in range(SEQUENTIAL_OVERLAP))}
    return [(numbers[k], numbers[k + step]) for step in sorted(steps) for k in range(len(numbers) - step)]


def pairs_of_places(places: Sequence[int], steps: Sequence[int]) -> list[tuple[int, int]]:
    """The same of hand-held brackets, by the place and the step of the bracket of each picture.

    Of many: the same steps of places as above, and neighbouring steps of one place and the next.
    """
    if len(places) <= MOST_FOR_EXHAUSTIVE:
        return pairs_in_time(range(len(places)))
    number = {key: k for k, key in enumerate(zip(places, steps, strict=True))}
    pairs: set[tuple[int, int]] = set()
    for step in set(steps):
        pairs |= set(_neighbours([k for (_, each), k in number.items() if each == step]))
        for (place, each), k in number.items():
            if each == step:
                near = [(place, step + 1), (place + 1, step + 1), (place - 1, step + 1)]
                pairs |= {(k, number[key]) for key in near if key in number}
    return sorted({(min(pair), max(pair)) for pair in pairs})


def pairs_of_lights(
    groups: Mapping[str, tuple[Sequence[int], Sequence[tuple[int, int]]]],
) -> list[tuple[int, int]]:
    """The same of photos under several lights: numbers and pairs by light, the standard one first.

    Pictures under another light are matched among themselves and with those under the standard one, or with
    ``MOST_FOR_EXHAUSTIVE`` of them, spread evenly. Of few pictures in all each is matched with each.
    """
    everything = [number for numbers, _ in groups.values() for number in numbers]
    if len(everything) <= MOST_FOR_EXHAUSTIVE:
        return pairs_in_time(everything)
    (standard, _), *others = groups.values()
    spread = standard[:: -(-len(standard) // MOST_FOR_EXHAUSTIVE)]
    across = [(one, other) for numbers, _ in others for one in spread for other in numbers]
    return [pair for _, pairs in groups.values() for pair in pairs] + across


def _write_pictures(
    photos: Mapping[int, Photo],
    names: Mapping[int, str],
    folder: Path,
    at: Callable[[str, float], None],
) -> bool:
    """The pictures to match, upright and not too large, and their masks; whether there are any masks."""
    masked = any(photo.mask is not None for photo in photos.values())
    for done, (number, photo) in enumerate(photos.items()):
        at("reading photos", done / len(photos))
        size = match_size(photo)
        picture = photo.copy(max(size))
        if picture.size != size:
            picture = picture.resize(size, Image.Resampling.HAMMING)
        path = folder / "pictures" / names[number]
        path.parent.mkdir(parents=True, exist_ok=True)
        picture.save(path, compress_level=1)
        if masked:  # COLMAP wants one for every picture then
            keep = photo.keep()
            mask = Image.new("1", size, 1) if keep is None else Image.fromarray(keep)
            path = folder / "masks" / f"{names[number]}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            mask.resize(size, Image.Resampling.NEAREST).convert("L").save(path)
    return masked


def match_size(photo: Photo) -> tuple[int, int]:
    """Width and height at which a photo is matched."""
    scale = min(1.0, MATCH_SIDE / max(photo.width, photo.height))
    return round(photo.width * scale), round(photo.height * scale)


def _first_guess(camera_model: str, photos: Sequence[Photo]) -> str:
    """The camera's parameters as COLMAP reads them, where EXIF tells the focal length; else empty."""
    photo = next((photo for photo in photos if photo.focal_pixels is not None), None)
    if photo is None or photo.focal_pixels is None:
        return ""
    pycolmap = require_pycolmap()
    width, height = match_size(photo)
    camera = pycolmap.Camera.create_from_model_name(
        0, camera_model, photo.focal_pixels * width / photo.width, width, height
    )
    return camera.params_to_string()


def run_colmap(
    job: dict[str, Any],
    folder: Path,
    say: Callable[[str], None] = lambda step: None,
    remedy: str = CAPTURE_REMEDY,
    full: str = "give an --out on another disk",
    at: Callable[[str, float], None] = lambda step, share: None,
) -> None:
    """``colmap_process.py`` with ``job`` in ``folder``, its work place.

    ``say`` is told each step, ``at`` also which share of it is done. Whatever ends this, ends that: the
    process lives while the pipe to it is open. Raises ``StructureError`` with ``remedy`` where COLMAP fails,
    its last words in the message, or ``OutputError`` where the disk is full: what helps beside freeing space
    is ``full``.
    """
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    log = folder / "colmap.log"
    command = [sys.executable, str(Path(__file__).with_name("colmap_process.py")), str(folder / "job.json")]
    utf8 = {**os.environ, "PYTHONIOENCODING": "utf-8:backslashreplace"}  # Windows' pipes have a code page
    with (
        open(log, "w", encoding="utf-8") as errors,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, env=utf8, encoding="utf-8"
        ) as process,
    ):
        assert process.stdout is not None
        try:
            for line in process.stdout:
                step, _, share = line.strip().partition("\t")
                if not share:
                    say(step)
                at(step, float(share or 0.0))
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        last = "; ".join(log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-3:])
        if shutil.disk_usage(folder).free < FULL_BYTES or "disk is full" in last:
            raise OutputError(
                f"COLMAP cannot write to {folder}: its disk is full",
                f"Free some space, or {full}.",
            )
        raise StructureError(f"COLMAP failed (status {process.returncode}): {last}", remedy)


# ---- a reconstruction that exists --------------------------------------------------------------------


def existing(folder: Path, poses: Sequence[Bracket]) -> Structure:
    """The reconstruction in ``folder`` (``sparse/0``, or the files themselves) of these poses.

    A picture of it belongs to the pose that has a photo of the same file name, or else of the same stem; of
    files of one name in several folders, that of the standard light, unless it is named with its folder.
    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` (no picture, or too few, belong
    to the photos; another shape of picture; photos of which it is unknown which way up it saw them).
    """
    candidates = (folder / "sparse" / "0", folder / "sparse", folder)
    model = next((path for path in candidates if (path / "cameras.bin").is_file()), None)
    model = model or next((path for path in candidates if (path / "cameras.txt").is_file()), None)
    if model is None:
        raise FileMissingError(
            f"{folder} has no reconstruction of COLMAP: looked for sparse/0/cameras.bin and .txt",
            "Give the folder that holds sparse/0, or leave --poses out.",
        )
    structure = _read(model, _numbers(poses))
    if len(structure.registered) < FEWEST_POSES:
        raise DataMismatchError(
            f"{model} places {len(structure.registered)} of the {len(poses)} poses; photos are named as "
            f"{some_names([photo.name for photo in poses[0].photos])}",
            "Its pictures must have the photos' file names.",
        )
    _require_one_way_up([photo for number in structure.registered for photo in poses[number].photos])
    sizes = {number: (pose.photos[0].width, pose.photos[0].height) for number, pose in enumerate(poses)}
    return _at_size(structure, sizes)


def _numbers(poses: Sequence[Bracket]) -> dict[str, int]:
    """The poses by all names that their photos may have in a reconstruction."""
    stems: dict[str, int] = {}
    files: dict[str, int] = {}
    whole: dict[str, int] = {}
    for number, pose in enumerate(poses):  # those of the standard light come first
        for photo in pose.photos:
            stems.setdefault(photo.path.stem, number)
            files.setdefault(photo.path.name, number)
            whole[photo.name] = whole[f"{photo.path.parent.name}/{photo.path.name}"] = number
    return {**stems, **files, **whole}


def _require_one_way_up(photos: Sequence[Photo]) -> None:
    """No photo is one that EXIF turns without a change of its size, by which ``_at_size`` would find out."""
    odd = [
        photo
        for photo in photos
        if photo.orientation != 1 and (photo.orientation not in LYING or photo.width == photo.height)
    ]
    if odd:
        raise DataMismatchError(
            f"EXIF turns {len(odd)} of {len(photos)} photos, which the reconstruction may have seen as they "
            f"are stored: {some_names([photo.name for photo in odd])}",
            NOT_OBEYED,
        )


# ---- reading ------------------------------------------------------------------------------------------


def _read(model: Path, numbers: Mapping[str, int]) -> Structure:
    """COLMAP's model of the images in ``numbers`` (pose by name, or by stem)."""
    pycolmap = require_pycolmap()
    try:
        model_read = pycolmap.Reconstruction(str(model))
    except (ValueError, RuntimeError, IndexError, OverflowError, MemoryError) as error:
        raise FileDamagedError(
            f"{model} is not a readable reconstruction of COLMAP ({str(error).splitlines()[0]})",
            "Export it again from COLMAP.",
        ) from error
    point_ids = sorted(model_read.points3D)
    index = {point_id: k for k, point_id in enumerate(point_ids)}
    points = [model_read.points3D[point_id] for point_id in point_ids]
    registered: dict[int, RegisteredPose] = {}
    for image_id in sorted(model_read.reg_image_ids(), key=lambda k: model_read.image(k).name):
        image = model_read.image(image_id)
        name = Path(image.name)
        number = next((numbers[key] for key in (image.name, name.name, name.stem) if key in numbers), None)
        if number is None or number in registered:
            continue
        matrix = image.cam_from_world().matrix()
        seen = [point for point in image.points2D if point.has_point3D()]
        registered[number] = RegisteredPose(
            image.camera_id,
            matrix[:, :3],
            matrix[:, 3],
            np.array([point.xy for point in seen], np.float64).reshape(-1, 2),
            np.array([index[point.point3D_id] for point in seen], np.int64),
        )
    return Structure(
        {k: deepcopy(model_read.cameras[k]) for k in sorted({pose.camera for pose in registered.values()})},
        dict(sorted(registered.items())),
        np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        np.array([point.error for point in points], np.float64),
    )


def _at_size(structure: Structure, sizes: Mapping[int, tuple[int, int]]) -> Structure:
    """The same for photos of these widths and heights; COLMAP may have seen smaller copies of them."""
    registered, factors = dict(structure.registered), [1.0]
    for number, camera in structure.cameras.items():
        of_camera = [place for place, pose in registered.items() if pose.camera == number]
        width, height = sizes[of_camera[0]]
        factor = width / camera.width
        odd = next((sizes[place] for place in of_camera if sizes[place] != (width, height)), None)
        if odd is not None or abs(height - camera.height * factor) > max(1.0, factor):
            width, height = odd or (width, height)
            turned = (height > width) != (camera.height > camera.width)
            raise DataMismatchError(
                f"the reconstruction is of pictures of {camera.width}×{camera.height}, the photos are "
                f"{width}×{height}",
                "It must be of these photos, not cropped and not turned."
                + (f" {NOT_OBEYED}" if turned else ""),
            )
        scale = np.array([factor, height / camera.height])
        for place in of_camera:
            registered[place] = replace(registered[place], keypoints=registered[place].keypoints * scale)
        camera.rescale(width, height)
        factors.append(factor)
    return replace(structure, registered=registered, errors=structure.errors * factors[-1])
