# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in a data folder: a list of everything, with all that is missing or damaged instead of the first.

The reader (``backend/scene``) stops at the first fault, as training must. Here each file is looked at by
itself, and then the reader has the last word.
"""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.errors import PhysHDRError
from ...bridge.limits import EXPOSURE
from ...bridge.regular import read_json_object
from ..scene import Scene, read_scene
from ..scene.hdr_nerf_syn import LOOKS_FOR, NAME, OURS
from ..scene.pictures import read_exr, read_png
from .inspect_scene import look_at_scene
from .inspected import (
    LUMINANCE,
    Clipped,
    Estimate,
    Inspection,
    Split,
    dynamic_range_of,
    is_number,
    tell_exposures,
    warn_of_exposures,
)
from .layers import read_layers

SPLITS = ("train", "test", "lit")
#: dataset.json may differ from what is measured by its rounding.
STOPS_TOLERANCE = 0.05


def inspect(root: Path, downscale: float | None = None) -> Inspection:
    """Look at every file of a data set, in whichever layout; ``downscale`` as training would read it.

    Raises nothing that a damaged data set could cause.
    """
    root = Path(root)
    if (root / LOOKS_FOR).exists():
        walk = _Inspector(root)
        _ask_the_reader(root, downscale, walk.found, walk.faulty)
        return walk.found
    found = Inspection(str(root), scene=root.resolve().name)
    scene = _ask_the_reader(root, downscale, found, set())
    if scene is not None:
        look_at_scene(scene, found)
    return found


def _ask_the_reader(
    root: Path, downscale: float | None, found: Inspection, faulty: set[Path]
) -> Scene | None:
    """What training would say, unless it has been said of one of the ``faulty`` files already."""
    try:
        scene = read_scene(root, downscale)
    except PhysHDRError as error:
        if not any(str(path) in error.message for path in faulty):
            found.errors.append(error.message)
        return None
    camera = scene.train[0].camera
    found.layout, found.messages = scene.layout, list(scene.messages)
    found.resolution = camera.width, camera.height
    found.points = len(scene.points.positions) if scene.points else None
    return scene


class _Inspector:
    """One walk through a folder of our own layout; ``found`` is the result."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.info: dict[str, Any] = {}
        self.found = Inspection(str(root), scene=root.resolve().name)
        self.faulty: set[Path] = set()
        if (root / "dataset.json").exists():
            self.info = self._json(root / "dataset.json")
        self.found.layout = OURS if self.info else NAME
        self.frames = {split: self._frames(split) for split in SPLITS if self._has(split)}
        self._head()
        self._splits()
        self._exposures()
        self._pictures()
        self._truth()
        self._relit()
        self._passes()
        self._warn()

    # -- text ----------------------------------------------------------------------------------------------

    def _has(self, split: str) -> bool:
        return any((self.root / f"{kind}_{split}.json").exists() for kind in ("transforms", "exposure"))

    def _json(self, path: Path) -> dict[str, Any]:
        """The object in a file; {} and an error where it holds none."""
        try:
            return read_json_object(path)
        except PhysHDRError as error:
            return self._fault(path, error.message)

    def _fault(self, path: Path, message: str) -> dict[str, Any]:
        self.faulty.add(path)
        self.found.errors.append(message)
        return {}

    def _frames(self, split: str) -> list[dict[str, Any]]:
        """The frames that can be understood, each with ``stem`` (train/r_3), ``index`` and ``seconds``."""
        transforms = self._json(self.root / f"transforms_{split}.json")
        brackets: dict[str, dict[int, float]] = {}
        for key, seconds in self._json(self.root / f"exposure_{split}.json").items():
            parts = re.fullmatch(r"(?:\./)?(.+)_(\d+)\.png", key)
            if parts and is_number(seconds) and seconds in EXPOSURE:
                brackets.setdefault(parts.group(1), {})[int(parts.group(2))] = float(seconds)
        frames = []
        listed = transforms.get("frames")
        for number, entry in enumerate(listed if isinstance(listed, list) else []):
            if isinstance(entry, dict) and isinstance(entry.get("file_path"), str):
                stem = entry["file_path"].replace("\\", "/").removeprefix("./").removesuffix(".png")
                digits = re.search(r"(\d+)$", stem)
                index = int(digits.group()) if digits else number
                frames.append({**entry, "stem": stem, "index": index, "seconds": brackets.get(stem, {})})
        return frames

    def _head(self) -> None:
        info, found = self.info, self.found
        said = info.get("scene")
        found.scene = said if said and isinstance(said, str) else found.scene
        maker = _object(info.get("generator"))
        found.made_by = " ".join(str(maker[key]) for key in ("name", "version") if key in maker)
        if "blender" in maker:
            found.made_by += f", Blender {maker['blender']}"
        found.response = str(_object(info.get("response")).get("name", ""))
        found.camera = _object(info.get("camera_model"))
        floor = _object(info.get("noise_floor"))
        if isinstance(floor.get("psnr"), list) and all(map(is_number, floor["psnr"])):
            found.noise_floor = floor
        lights = info.get("lights")
        found.lights = [str(name) for name in lights] if isinstance(lights, list) else ["ambient"]

    def _splits(self) -> None:
        for split, frames in self.frames.items():
            levels: dict[str, set[float]] = {}
            for frame in frames:
                given = _object(frame.get("lighting_levels")) or {"ambient": frame.get("lighting_level")}
                for light, level in given.items():
                    if is_number(level):
                        levels.setdefault(light, set()).add(float(level))
            described = {light: sorted(values) for light, values in levels.items()}
            self.found.splits[split] = Split(len(frames), described)
        for split, count in _object(self.info.get("splits")).items():
            there = len(self.frames.get(split, []))
            if count != there:
                self.found.errors.append(
                    f"{self.root / 'dataset.json'} speaks of {count} {split} poses, "
                    f"transforms_{split}.json holds {there}"
                )

    def _exposures(self) -> None:
        tell_exposures(
            self.found, {split: [frame["seconds"] for frame in self.frames[split]] for split in self.frames}
        )

    # -- pictures ------------------------------------------------------------------------------------------

    def _pictures(self) -> None:
        """Every PNG; how much of the training views is white or black at each exposure."""
        clipped, estimate = Clipped(), Estimate()
        for split, frames in self.frames.items():
            for frame in frames:
                for k, seconds in frame["seconds"].items():
                    picture = self._picture(self.root / f"{frame['stem']}_{k}.png", read_png)
                    if picture is not None and split == "train":
                        clipped.add(picture, k)
                        estimate.add(picture, seconds)
        clipped.tell(self.found)
        self.found.dynamic_range = estimate.range()

    def _picture(self, path: Path, read: Callable[[Path], np.ndarray]) -> np.ndarray | None:
        """What ``read`` returns; None and an error where it fails, or the size is not the data set's."""
        try:
            picture = read(path)
        except PhysHDRError as error:
            self._fault(path, error.message)
            return None
        height, width = picture.shape[:2]
        if self.found.resolution is None:
            self.found.resolution = _size(self.info.get("resolution")) or (width, height)
        right = self.found.resolution
        if (width, height) != right:
            self._fault(path, f"{path} is {width}×{height} pixels, not {right[0]}×{right[1]}")
            return None
        return picture

    def _truth(self) -> None:
        """The true radiance of each split, where the data set has any, and its dynamic range."""
        luminance = []
        for split, frames in self.frames.items():
            folder = self.root / f"{split}_hdr"
            for frame in frames if folder.is_dir() else []:
                radiance = self._picture(folder / f"hdr_{frame['index']:03d}.exr", read_exr)
                if radiance is not None:
                    self.found.splits[split].hdr += 1
                    if split == "train":
                        luminance.append((radiance.astype(np.float64) @ LUMINANCE).ravel())
        if luminance:
            self.found.dynamic_range = dynamic_range_of(np.concatenate(luminance))

    def _relit(self) -> None:
        """Every picture of every relit folder, those that dataset.json names and those that are there."""
        named = self.info.get("relit")
        told = {
            str(entry["folder"]): {k: v for k, v in _object(entry.get("levels")).items() if is_number(v)}
            for entry in (named if isinstance(named, list) else [])
            if isinstance(entry, dict) and "folder" in entry
        }
        there = sorted(f"relit/{path.name}" for path in (self.root / "relit").glob("*") if path.is_dir())
        for folder in [*told, *(name for name in there if name not in told)]:
            paths = sorted((self.root / folder).glob("hdr_*.exr"))
            whole = [path for path in paths if self._picture(path, read_exr) is not None]
            if not paths:
                self._fault(self.root / folder, f"{self.root / folder} holds no relit truth (hdr_*.exr)")
            poses = [int(number) for path in whole if (number := path.stem.removeprefix("hdr_")).isdigit()]
            levels = told.get(folder) or _levels_of(folder)
            self.found.relit.append({"folder": folder, "levels": levels, "poses": poses})

    def _passes(self) -> None:
        """Every pose's passes: readable, and the bytes that dataset.json has the hash of."""
        told = {}
        for frame in map(_object, _object(self.info.get("frames")).values()):
            told[self.root / str(frame.get("file"))] = frame.get("sha256")
            for key in ("samples", "noise_psnr"):
                if is_number(frame.get(key)):
                    self.found.renders.setdefault(key, []).append(frame[key])
        for path in sorted((self.root / "passes").glob("*.exr")):
            if self._picture(path, lambda path: next(iter(read_layers(path).values()))) is None:
                continue
            self.found.passes += 1
            if told.get(path, "") and told[path] != hashlib.sha256(path.read_bytes()).hexdigest():
                self._fault(path, f"{path} was changed: it has not the hash that dataset.json tells")
        absent = sum(not path.is_file() for path in told)
        if absent:
            self.found.warnings.append(f"{absent} of {len(told)} passes are missing: training needs none")

    # -- judgement -----------------------------------------------------------------------------------------

    def _warn(self) -> None:
        found, warn = self.found, self.found.warnings.append
        if (self.root / "dataset.partial.json").exists():
            warn("the data set is not finished: make_scene.py is at it, or was interrupted (start it again)")
        warn_of_exposures(found)
        said, measured = _object(self.info.get("dynamic_range")).get("stops"), found.dynamic_range
        known = measured.stops if measured and not measured.estimated else None
        if is_number(said) and known is not None and abs(said - known) > STOPS_TOLERANCE:
            warn(f"dataset.json says {said} stops, train_hdr/ has {known}: was it made anew?")


# ---- parts of dataset.json ---------------------------------------------------------------------------


def _levels_of(folder: str) -> dict[str, float]:
    """``relit/level_0.25`` → {"ambient": 0.25}; ``relit/ambient_4+lamp_2`` → both; {} for other names."""
    levels = {}
    for part in folder.removeprefix("relit/").split("+"):
        light, _, level = part.rpartition("_")
        try:
            levels["ambient" if light == "level" else light] = float(level)
        except ValueError:
            return {}
    return levels


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _size(value: Any) -> tuple[int, int] | None:
    if isinstance(value, list) and len(value) == 2 and all(isinstance(side, int) for side in value):
        return value[0], value[1]
    return None
