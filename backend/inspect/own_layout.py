# SPDX-License-Identifier: GPL-3.0-or-later
"""Inspects a data set of our own layout, file by file."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set
from ...bridge.contents import SplitContents, split_contents
from ...bridge.errors import PhysHDRError
from ...bridge.layouts import HDR_NERF_SYN
from ...bridge.lights import AMBIENT
from ...bridge.limits import is_number
from ...bridge.regular import read_json_object
from ..scene.hdr_nerf_syn import OURS
from ..scene.pictures import read_codes
from ..scene.source import exr_rec709
from .findings import Inspection, Split, add_exposures, warn_of_exposures
from .layers import read_layers
from .pixels import TrainingPixels

#: The default remedy.
MAKE_AGAIN = (
    "Delete what is damaged, then make the data set again (which only makes what is missing) or copy it."
)
#: dataset.json may differ from measurements by its rounding.
STOPS_TOLERANCE = 0.05


def look_at_folder(root: Path, found: Inspection) -> set[Path]:
    """Add the content and every fault to ``found``; returns the faulty files."""
    return _Walk(root, found).faulty


class _Walk:
    """One walk through a folder; ``found`` is the result, ``faulty`` the files with a fault."""

    def __init__(self, root: Path, found: Inspection) -> None:
        self.root, self.found = root, found
        self.faulty: set[Path] = set()
        self.info: dict[str, Any] = {}
        if (root / data_set.INFO_FILE).exists():
            self.info = self._json(root / data_set.INFO_FILE)
        self.found.layout = OURS if self.info else HDR_NERF_SYN.name
        self.splits = {split: self._split(split) for split in data_set.splits_there(root)}
        self.pixels = TrainingPixels()
        self._head()
        self._splits()
        add_exposures(
            found, {name: [frame.seconds for frame in split.frames] for name, split in self.splits.items()}
        )
        self._pictures()
        self._truth()
        self.pixels.summarise(found)
        self._relit()
        self._passes()
        self._warn()

    # -- text ----------------------------------------------------------------------------------------------

    def _json(self, path: Path) -> dict[str, Any]:
        """The object in a file; {} and a fault if there is none."""
        try:
            return read_json_object(path)
        except PhysHDRError as error:
            return self._fault(path, error.message, error.hint)

    def _fault(self, path: Path, message: str, remedy: str = "") -> dict[str, Any]:
        self.faulty.add(path)
        self.found.add_fault(message, remedy or MAKE_AGAIN)
        return {}

    def _split(self, name: str) -> SplitContents:
        transforms = self._json(self.root / data_set.transforms_file(name))
        return split_contents(transforms, self._json(self.root / data_set.exposure_file(name)))

    def _head(self) -> None:
        info, found = self.info, self.found
        found.scene = data_set.scene_name(self.root, info)
        maker = _object(info.get("generator"))
        found.made_by = " ".join(str(maker[key]) for key in ("name", "version") if key in maker)
        if "blender" in maker:
            found.made_by += f", Blender {maker['blender']}"
        found.response = str(_object(info.get("response")).get("name", ""))
        found.camera = _object(info.get("camera_model"))
        found.noise_floor, found.reference_floor = map(
            _floor, (info.get("noise_floor"), info.get("reference_floor"))
        )
        lights = info.get("lights")
        found.lights = [str(name) for name in lights] if isinstance(lights, list) else [AMBIENT]

    def _splits(self) -> None:
        for name, split in self.splits.items():
            levels: dict[str, set[float]] = {}
            for frame in split.frames:
                for light, level in frame.levels.items():
                    if is_number(level):
                        levels.setdefault(light, set()).add(float(level))
            described = {light: sorted(values) for light, values in levels.items()}
            self.found.splits[name] = Split(len(split.frames), described)
        for name, count in _object(self.info.get("splits")).items():
            there = self.found.splits[name].poses if name in self.found.splits else 0
            if count != there:
                self.found.add_fault(
                    f"{self.root / data_set.INFO_FILE} states {count} {name} poses, "
                    f"{data_set.transforms_file(name)} has {there}",
                    MAKE_AGAIN,
                )

    # -- pictures ------------------------------------------------------------------------------------------

    def _pictures(self) -> None:
        """Check every picture."""
        for name, split in self.splits.items():
            for frame in split.frames:
                for place, seconds in frame.seconds.items():
                    path = self.root / data_set.picture_file(frame.stem, place)
                    picture = self._picture(path, lambda path: read_codes(path)[0])
                    if picture is not None and name == data_set.TRAIN:
                        self.pixels.add_picture(picture, place, seconds)

    def _picture(self, path: Path, read: Callable[[Path], np.ndarray]) -> np.ndarray | None:
        """The result of ``read``; None and a fault if it fails, or the size is not the data set's."""
        try:
            picture = read(path)
        except PhysHDRError as error:
            self._fault(path, error.message, error.hint)
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
        """Check the true radiance of each split, if any."""
        for name, split in self.splits.items():
            folder = self.root / data_set.truth_folder(name)
            for frame in split.frames if folder.is_dir() else []:
                radiance = self._picture(folder / data_set.truth_file(frame.index), exr_rec709)
                if radiance is not None:
                    self.found.splits[name].hdr += 1
                    if name == data_set.TRAIN:
                        self.pixels.add_truth(radiance)

    def _relit(self) -> None:
        """Check every picture of all relit folders, those listed in dataset.json and those that exist."""
        named = self.info.get("relit")
        listed = {
            str(entry["folder"]): {k: v for k, v in _object(entry.get("levels")).items() if is_number(v)}
            for entry in (named if isinstance(named, list) else [])
            if isinstance(entry, dict) and "folder" in entry
        }
        for folder in dict.fromkeys([*listed, *data_set.mixture_folders(self.root)]):
            paths = sorted((self.root / folder).glob(data_set.TRUTH_FILES))
            whole = [path for path in paths if self._picture(path, exr_rec709) is not None]
            if not paths:
                self._fault(
                    self.root / folder, f"{self.root / folder} holds no relit truth ({data_set.TRUTH_FILES})"
                )
            numbers = (data_set.truth_number(path.name) for path in whole)
            poses = [number for number in numbers if number is not None]
            levels = listed.get(folder) or data_set.mixture_levels(folder)
            self.found.relit.append({"folder": folder, "levels": levels, "poses": poses})

    def _passes(self) -> None:
        """Check that every pose's passes are readable and have the hash in dataset.json."""
        hashes = {}
        for name, frame in _object(self.info.get("frames")).items():
            frame = _object(frame)
            hashes[self.root / str(frame.get("file"))] = frame.get("sha256")
            if is_number(samples := frame.get("samples")):
                self.found.samples.setdefault(name.partition("/")[0], []).append(samples)
            if is_number(noise := frame.get("noise_psnr")):
                self.found.noise_psnr.append(noise)
        if is_number(stated := self.info.get("test_samples")):
            for name in data_set.HELD_OUT:  # truth that was rendered elsewhere: no frame states its samples
                if name in self.splits:
                    self.found.samples.setdefault(name, [stated])
        for path in data_set.passes_files(self.root):
            if self._picture(path, lambda path: next(iter(read_layers(path).values()))) is None:
                continue
            self.found.passes += 1
            if hashes.get(path, "") and hashes[path] != hashlib.sha256(path.read_bytes()).hexdigest():
                self._fault(path, f"{path} was changed: its hash differs from dataset.json")
        absent = sum(not path.is_file() for path in hashes)
        if absent:
            self.found.warnings.append(f"{absent} of {len(hashes)} passes are missing: training needs none")

    # -- warnings ------------------------------------------------------------------------------------------

    def _warn(self) -> None:
        found, warn = self.found, self.found.warnings.append
        if data_set.is_unfinished(self.root):
            warn("the data set is not finished: make_scene.py is running or was interrupted (start it again)")
        warn_of_exposures(found)
        stated, measured = data_set.stated_stops(self.info), found.dynamic_range
        known = measured.stops if measured and not measured.estimated else None
        if stated is not None and known is not None and abs(stated - known) > STOPS_TOLERANCE:
            warn(f"dataset.json says {stated} stops, train_hdr/ has {known}: has it been replaced?")


# ---- parts of dataset.json ---------------------------------------------------------------------------


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _floor(value: Any) -> dict[str, Any] | None:
    """A noise floor in ``dataset.json``; None if missing or invalid."""
    floor = _object(value)
    psnr = floor.get("psnr")
    return floor if isinstance(psnr, list) and psnr and all(map(is_number, psnr)) else None


def _size(value: Any) -> tuple[int, int] | None:
    if isinstance(value, list) and len(value) == 2 and all(isinstance(side, int) for side in value):
        return value[0], value[1]
    return None
