# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set's folder holds, in a few lines, and what is wrong with it. No bpy; no pixel is decoded.

It looks at the JSON files and at the headers of pictures, so that a panel can show it at once. The trainer's
own reader checks more when it reads (backend/scene).
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...bridge import data_set
from ...bridge.contents import SplitContents, split_contents
from ...bridge.errors import FileDamagedError, FileMissingError, PhysHDRError
from ...bridge.lights import AMBIENT
from ...bridge.limits import LEVEL, is_number
from ...bridge.regular import read_json_object, regular_file
from ...bridge.words import counted
from .captures import LOOKED_FOR, NERF, Capture, read_capture
from .picture_size import PNG_SIGNATURE, picture_size

#: Of a number of points.
MOST_DIGITS = 12
#: From one exposure no dynamic range can be learned.
FEWEST_EXPOSURES = 2
#: float32 has 277.
MOST_STOPS = 1000
#: So many missing files are named; of the rest the number is told.
NAMED = 3
#: Exposures of a bracket; of more, as automatic exposure gives them, the ends are told.
MOST_NAMED = 8

MAKE_AGAIN = "Render the data set again into the same folder: only what is missing is made."
TRAINING = data_set.transforms_file(data_set.TRAIN)
#: Captures of which the trainer leaves out what has no picture.
LEAVE_OUT = ("transforms.json", NERF)
CHOOSE = "Choose a data set's folder, prepare photos, or render a data set from this scene."
#: In ``views``: poses of which the trainer chooses some for testing.
ALL = "all"
#: Of those that a capture may have, headers are read of so many pictures: enough to see whether sizes differ.
HEADERS = 400


@dataclass(frozen=True)
class DatasetSummary:
    """What ``summarise`` found.

    ``views``: poses in each split that there is. ``size``: width and height in pixels, ``None`` where
    pictures differ or none can be read. ``exposures``: seconds, shortest first, of the training views.
    ``stops``: dynamic range, and ``stops_from``: whether it was measured on the true radiance or only
    follows from the exposures. ``levels``, ``relit_levels``: ambient levels of extra training views and
    of the relit truth. ``lights``: those that the scene has, each with a level of its own; ``lit_lights``:
    those whose levels differ in the extra training views; ``mixtures``: how many settings of the relit truth
    change another light than the ambient one. ``layout``: of a capture, none of ours. ``warnings``: what is
    wrong, in the order of its weight.
    """

    name: str
    views: dict[str, int]
    size: tuple[int, int] | None = None
    exposures: tuple[float, ...] = ()
    stops: float | None = None
    stops_from: str = ""
    points: int | None = None
    levels: tuple[float, ...] = ()
    relit_levels: tuple[float, ...] = ()
    lights: tuple[str, ...] = ()
    lit_lights: tuple[str, ...] = ()
    mixtures: int = 0
    layout: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def evs(self) -> tuple[float, ...]:
        """The exposures as EV: 0 is one second."""
        return tuple(math.log2(seconds) for seconds in self.exposures)

    @property
    def lines(self) -> list[str]:
        """What a panel shows without the warnings: one line each of views and size, exposures, dynamic range,
        ambient light, lights, points.
        """
        views = self.views
        if ALL in views:
            size = f", {self.size[0]} × {self.size[1]}" if self.size else ""
            return [f"{self.name}: {views[ALL]} views{size}, {self.layout}", *self._of_exposures()]
        parts = [f"{views.get(data_set.TRAIN, 0)} training views", f"{views.get(data_set.TEST, 0)} test"]
        if data_set.LIT in views:
            parts.append(f"{views[data_set.LIT]} under other light")
        if data_set.VALIDATION in views:
            parts.append(f"{views[data_set.VALIDATION]} validation")
        size = f", {self.size[0]} × {self.size[1]}" if self.size else ""
        told = [f"{self.name}: {', '.join(parts)}{size}", *self._of_exposures()]
        light = []
        if self.levels:
            light.append(f"trained at {_levels(self.levels)}")
        if self.relit_levels:
            light.append(f"truth at {_levels(self.relit_levels)}")
        if light:
            told.append(f"Ambient light: {'; '.join(light)}")
        if self.lights:
            parts = [", ".join(self.lights)]
            if self.lit_lights:
                parts.append(f"levels to learn from: {', '.join(self.lit_lights)}")
            if self.mixtures:
                parts.append(f"truth for {counted(self.mixtures, 'mixture')}")
            told.append(f"Lights: {'; '.join(parts)}")
        return told

    def _of_exposures(self) -> list[str]:
        """A line each of exposures, dynamic range, points; nothing of what is not known."""
        told = []
        if len(self.exposures) > MOST_NAMED:
            told.append(f"{len(self.exposures)} exposures: EV {self.evs[0]:+.3g} to {self.evs[-1]:+.3g}")
        elif self.exposures:
            many = "exposures" if len(self.exposures) > 1 else "exposure"
            told.append(f"{len(self.exposures)} {many}: EV {', '.join(f'{ev:+.3g}' for ev in self.evs)}")
        if self.stops is not None:
            told.append(f"Dynamic range: {self.stops:.1f} stops ({self.stops_from})")
        if self.points is not None:
            told.append(f"Starts from {self.points:,} points")
        return told


def summarise(folder: Path | str) -> DatasetSummary:
    """Look at a data set.

    Raises:
        FileMissingError: no such folder, or no data set in it.
        FileDamagedError: its JSON cannot be read.
        BadValueError: it is of a format or version that is not known.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise FileMissingError(f"The data set folder {folder} {what}", CHOOSE)
    unfinished = data_set.is_unfinished(folder)
    if not data_set.is_layout(folder):
        if unfinished:
            raise FileMissingError(f"The data set in {folder} has only just been begun", MAKE_AGAIN)
        capture = read_capture(folder)
        if capture is not None:
            return _of_capture(folder, capture)
        raise FileMissingError(f"{folder} is not a data set: it has no {TRAINING}, no {LOOKED_FOR}", CHOOSE)
    info = data_set.read_info(folder, MAKE_AGAIN)
    warnings: list[str] = []
    if unfinished:
        warnings.append(f"The data set is not complete yet. {MAKE_AGAIN}")
    splits: dict[str, SplitContents] = {}
    views: dict[str, int] = {}
    levels: set[float] = set()
    lit_lights = _names(info, "lit_lights", data_set.INFO_FILE, warnings)
    for name in data_set.splits_there(folder):
        path = folder / data_set.transforms_file(name)
        if not path.exists():
            continue
        transforms = _transforms(path)
        views[name] = len(transforms["frames"])
        split = splits[name] = _split(folder / data_set.exposure_file(name), transforms, warnings)
        if name == data_set.LIT:
            levels = _lit_levels(split, path.name, warnings)
            lit_lights = _names(transforms, "lights", path.name, warnings) or lit_lights
        _check_frames(name, split, views[name], warnings)
    size = _check_pictures(folder, splits.values(), warnings)
    exposures = _check_exposures(splits[data_set.TRAIN], warnings)
    if data_set.TEST not in views:
        warnings.append("There is no test split: the quality cannot be measured.")
    stops, stops_from = _stops(info, exposures)
    points = _point_count(folder / data_set.POINTS_FILE, warnings)
    mixtures = [data_set.mixture_levels(name) for name in data_set.mixture_folders(folder)]
    relit = [mixture[AMBIENT] for mixture in mixtures if list(mixture) == [AMBIENT]]
    return DatasetSummary(
        name=data_set.scene_name(folder, info),
        views=views,
        size=size,
        exposures=exposures,
        stops=stops,
        stops_from=stops_from,
        points=points,
        levels=tuple(sorted(levels)),
        relit_levels=tuple(sorted(relit)),
        # A folder from elsewhere may tell of no others than those that vary.
        lights=_names(info, "lights", data_set.INFO_FILE, warnings) or lit_lights,
        lit_lights=lit_lights,
        mixtures=len(mixtures) - len(relit),
        warnings=tuple(warnings),
    )


def _of_capture(folder: Path, capture: Capture) -> DatasetSummary:
    """What a capture holds: photographs, or renders of other programs."""
    info = data_set.read_info(folder, MAKE_AGAIN)
    warnings: list[str] = []
    if capture.missing:
        kept = "; they are left out" if capture.layout in LEAVE_OUT else ""
        warnings.append(
            f"Pictures are missing ({len(capture.missing)}): {_some(list(capture.missing))}{kept}."
        )
    if not capture.poses:
        raise FileMissingError(f"{folder} names no picture that is there", CHOOSE)
    sizes = {size for file in list(capture.pictures)[:HEADERS] if (size := picture_size(file))}
    exposures = tuple(sorted({seconds for seconds in capture.pictures.values() if seconds is not None}))
    if None not in capture.pictures.values() and len(exposures) < FEWEST_EXPOSURES:
        warnings.append("All pictures have one exposure: high dynamic range cannot be learned.")
    stops, stops_from = _stops(info, exposures)
    splits = capture.splits
    if splits is not None and not splits[data_set.TEST]:
        warnings.append("There is no test split: the quality cannot be measured.")
    return DatasetSummary(
        name=data_set.scene_name(folder, info),
        views=splits or {ALL: len(capture.poses)},
        size=next(iter(sizes)) if len(sizes) == 1 else None,
        exposures=exposures,
        stops=stops,
        stops_from=stops_from,
        points=capture.points,
        layout="photographs" if capture.prepared else capture.layout,
        warnings=tuple(warnings),
    )


def _levels(levels: tuple[float, ...]) -> str:
    return ", ".join(f"{level:g}" for level in levels)


# ---- JSON --------------------------------------------------------------------------------------------------


def _transforms(path: Path) -> dict[str, Any]:
    """A transforms_*.json whose ``frames`` is a list of objects, and not empty."""
    content = read_json_object(path, MAKE_AGAIN)
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise FileDamagedError(f"{path} has no list 'frames'", MAKE_AGAIN)
    if not isinstance(content.get("camera_angle_x"), int | float):
        raise FileDamagedError(f"{path} has no 'camera_angle_x'", MAKE_AGAIN)
    if not frames:
        raise FileDamagedError(f"{path} has no frames", MAKE_AGAIN)
    return content


def _names(content: dict[str, Any], key: str, file: str, warnings: list[str]) -> tuple[str, ...]:
    """A list of names that may be missing; () and a warning where it is something else."""
    names = content.get(key, [])
    if isinstance(names, list) and all(isinstance(name, str) for name in names):
        return tuple(names)
    warnings.append(f"{file}: '{key}' is {str(names)[:60]!r}, not a list of lights.")
    return ()


def _lit_levels(split: SplitContents, file: str, warnings: list[str]) -> set[float]:
    """The ambient levels of the extra training views; a warning where one is none."""
    given = [frame.levels.get(AMBIENT, 1.0) for frame in split.frames]
    right = [level for level in given if is_number(level) and (level == 0 or level in LEVEL)]
    if len(right) < len(given):
        wrong = next(level for level in given if level not in right)
        warnings.append(f"{file}: the lighting level {wrong!r:.80} is not a number of 0 or more.")
    return {float(level) for level in right}


def _split(path: Path, transforms: dict[str, Any], warnings: list[str]) -> SplitContents:
    """The split of which ``path`` tells the exposures; warnings where it is missing or one is none."""
    exposures: dict[str, Any] = {}
    if path.exists():
        exposures = read_json_object(path, MAKE_AGAIN)
    else:
        warnings.append(f"{path.name} is missing: the exposures are unknown, and training needs them.")
    split = split_contents(transforms, exposures)
    for name, seconds in split.wrong.items():
        warnings.append(f"{path.name}: the exposure of {name} is {seconds!r:.80}, no time in seconds.")
    return split


# ---- checks ------------------------------------------------------------------------------------------------


def _check_frames(name: str, split: SplitContents, count: int, warnings: list[str]) -> None:
    """``count``: of all frames; those that name no file are told as ``?``."""
    if not split.pictures:
        return
    without = [frame.stem for frame in split.frames if not frame.seconds]
    without += ["?"] * (count - len(split.frames))
    if without:
        warnings.append(f"{data_set.exposure_file(name)} names no picture of {_some(without)}.")


def _check_pictures(
    folder: Path, splits: Iterable[SplitContents], warnings: list[str]
) -> tuple[int, int] | None:
    missing: list[str] = []
    damaged: list[str] = []
    sizes: dict[tuple[int, int], str] = {}
    for split in splits:
        for name in split.pictures:
            try:
                with open(regular_file(folder / name), "rb") as file:
                    head = file.read(24)
            except (OSError, PhysHDRError):
                missing.append(name)
                continue
            if len(head) < 24 or head[:8] != PNG_SIGNATURE:
                damaged.append(name)
            else:
                width, height = struct.unpack(">II", head[16:24])
                sizes.setdefault((width, height), name)
    if missing:
        warnings.append(f"Pictures are missing ({len(missing)}): {_some(missing)}. {MAKE_AGAIN}")
    if damaged:
        warnings.append(f"Pictures are no PNG files ({len(damaged)}): {_some(damaged)}.")
    if len(sizes) > 1:
        told = ", ".join(f"{w} × {h} ({name})" for (w, h), name in list(sizes.items())[:NAMED])
        warnings.append(f"The pictures are not of one size: {told}. Training needs one.")
        return None
    return next(iter(sizes), None)


def _check_exposures(train: SplitContents, warnings: list[str]) -> tuple[float, ...]:
    exposures = tuple(sorted(set(train.pictures.values())))
    if train.pictures and len(exposures) < FEWEST_EXPOSURES:
        warnings.append("All training pictures have one exposure: high dynamic range cannot be learned.")
    counts = {frame.stem: len(frame.seconds) for frame in train.frames if frame.seconds}
    if len(set(counts.values())) > 1:
        odd = min(counts, key=lambda stem: counts[stem])
        warnings.append(f"Not all poses have the same number of exposures: {odd} has {counts[odd]}.")
    return exposures


def _stops(info: dict[str, Any], exposures: tuple[float, ...]) -> tuple[float | None, str]:
    stops = data_set.stated_stops(info)
    if stops is not None and abs(stops) < MOST_STOPS:
        return float(stops), "measured"
    if len(exposures) > 1:
        return math.log2(exposures[-1] / exposures[0]), "between the shortest and the longest exposure"
    return None, ""


def _point_count(path: Path, warnings: list[str]) -> int | None:
    """The number of vertices that the PLY's header names; ``None`` where there is no file."""
    if not path.exists():
        warnings.append(f"{path.name} is missing: training starts from points made up from the views.")
        return None
    try:
        with open(regular_file(path), "rb") as file:
            head = file.read(4096).partition(b"end_header")[0].split(b"\n")
    except (OSError, PhysHDRError) as error:
        warnings.append(f"{path.name} cannot be read: {error}.")
        return None
    counts = [line.split()[-1] for line in head if line.startswith(b"element vertex ")]
    if (
        not head[0].startswith(b"ply")
        or not counts
        or not counts[0].isdigit()
        or len(counts[0]) > MOST_DIGITS
    ):
        warnings.append(f"{path.name} is no PLY file of points.")
        return None
    return int(counts[0])


def _some(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
