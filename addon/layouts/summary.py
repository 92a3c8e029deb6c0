# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set's folder holds, in a few lines, and what is wrong with it. No bpy; no pixel is decoded.

It reads JSON files and headers of pictures only, so that a panel can show it at once. The trainer's readers
(backend/scene) check more.
"""

import math
import struct
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...bridge import data_set
from ...bridge.contents import SplitContents, split_contents
from ...bridge.errors import FileDamagedError, FileMissingError, PhysHDRError
from ...bridge.layouts import GAUSSHDR, HDR_NERF_SYN, layout_of, looked_for
from ...bridge.layouts.picture_files import PICTURES
from ...bridge.layouts.transforms import frames_of
from ...bridge.light_groups import LightGroups, read_light_groups
from ...bridge.light_report import light_report
from ...bridge.lights import AMBIENT
from ...bridge.limits import LEVEL, is_number
from ...bridge.regular import read_json_object, regular_file
from ...bridge.words import counted
from .picture_size import PNG_SIGNATURE, picture_size
from .views import VIEWS, View, read_views

#: Of a number of points.
MOST_DIGITS = 12
#: From one exposure no dynamic range can be learned.
FEWEST_EXPOSURES = 2
#: float32 has 277.
MOST_STOPS = 1000
#: So many missing files are named; the rest are counted.
NAMED = 3
#: Exposures that are listed; of more, as automatic exposure gives them, the shortest and the longest.
MOST_NAMED = 8

MAKE_AGAIN = "Render the data set again into the same folder: only what is missing is made."
CHOOSE = "Choose a data set's folder, prepare photos, or render a data set from this scene."
#: Of those that a capture may have, headers are read of so many pictures: enough to see whether sizes differ.
HEADERS = 400


@dataclass(frozen=True)
class DatasetSummary:
    """What ``summarise`` found.

    ``views``: poses in each split that there is, or in ``VIEWS``. ``size``: width and height in pixels,
    ``None`` where pictures differ or none can be read. ``exposures``: seconds, shortest first, of the
    training views. ``stops``: dynamic range, and ``stops_from``: whether it was measured on the true radiance
    or only follows from the exposures. ``levels``, ``relit_levels``: ambient levels of extra training views
    and of the relit truth. ``lights``: those that the scene has, each with a level of its own;
    ``lit_lights``: those whose levels differ in the extra training views; ``turnable``: a sentence for each
    light of a capture that can be turned afterwards; ``mixtures``: how many settings of
    the relit truth change another light than the ambient one. ``layout``: of a capture; empty for our own.
    ``warnings``: what is wrong, the worst first.
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
    turnable: tuple[str, ...] = ()
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
        if VIEWS in views:
            size = f", {self.size[0]} × {self.size[1]}" if self.size else ""
            lit = f", {views[data_set.LIT]} under other light" if data_set.LIT in views else ""
            head = f"{self.name}: {views[VIEWS]} views{lit}{size}, {self.layout}"
            return [head, *self._of_exposures(), *self.turnable]
        parts = [f"{views.get(data_set.TRAIN, 0)} training views", f"{views.get(data_set.TEST, 0)} test"]
        if data_set.LIT in views:
            parts.append(f"{views[data_set.LIT]} under other light")
        if data_set.VALIDATION in views:
            parts.append(f"{views[data_set.VALIDATION]} validation")
        size = f", {self.size[0]} × {self.size[1]}" if self.size else ""
        lines = [f"{self.name}: {', '.join(parts)}{size}", *self._of_exposures()]
        light = []
        if self.levels:
            light.append(f"trained at {_levels(self.levels)}")
        if self.relit_levels:
            light.append(f"truth at {_levels(self.relit_levels)}")
        if light:
            lines.append(f"Ambient light: {'; '.join(light)}")
        if self.lights:
            parts = [", ".join(self.lights)]
            if self.lit_lights:
                parts.append(f"levels to learn from: {', '.join(self.lit_lights)}")
            if self.mixtures:
                parts.append(f"truth for {counted(self.mixtures, 'mixture')}")
            lines.append(f"Lights: {'; '.join(parts)}")
        return [*lines, *self.turnable]

    def _of_exposures(self) -> list[str]:
        """A line each for exposures, dynamic range and points, where known."""
        lines = []
        if len(self.exposures) > MOST_NAMED:
            lines.append(f"{len(self.exposures)} exposures: EV {self.evs[0]:+.3g} to {self.evs[-1]:+.3g}")
        elif self.exposures:
            many = "exposures" if len(self.exposures) > 1 else "exposure"
            lines.append(f"{len(self.exposures)} {many}: EV {', '.join(f'{ev:+.3g}' for ev in self.evs)}")
        if self.stops is not None:
            lines.append(f"Dynamic range: {self.stops:.1f} stops ({self.stops_from})")
        if self.points is not None:
            lines.append(f"Starts from {self.points:,} points")
        return lines


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
    layout = layout_of(folder)
    if layout is None:
        if unfinished:
            raise FileMissingError(f"The data set in {folder} has only just been begun", MAKE_AGAIN)
        raise FileMissingError(f"{folder} is not a data set: looked for {looked_for()}", CHOOSE)
    if layout is not HDR_NERF_SYN:
        return _of_capture(folder)
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
        _check_frames(name, split, warnings)
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
        # A folder from elsewhere may name only those that vary.
        lights=_names(info, "lights", data_set.INFO_FILE, warnings) or lit_lights,
        lit_lights=lit_lights,
        mixtures=len(mixtures) - len(relit),
        warnings=tuple(warnings),
    )


def _of_capture(folder: Path) -> DatasetSummary:
    """What a capture holds: photographs, or renders of other programs."""
    found = read_views(folder)
    assert found is not None, "its layout is known"
    info = data_set.read_info(folder, MAKE_AGAIN)
    warnings: list[str] = []
    if found.missing:
        # GaussHDR's reader refuses them, all others train on the rest.
        ignored = "; they are ignored" if found.layout is not GAUSSHDR else ""
        warnings.append(
            f"Pictures are missing ({len(found.missing)}): {_some(list(found.missing))}{ignored}."
        )
    if not found.seen:
        raise FileMissingError(f"{folder} names no picture that is there", CHOOSE)
    pictures = {file: seconds for view in found.seen for file, seconds in view.pictures.items()}
    sizes = {size for file in list(pictures)[:HEADERS] if (size := picture_size(file))}
    exposures = tuple(sorted({seconds for seconds in pictures.values() if seconds is not None}))
    if None not in pictures.values() and len(exposures) < FEWEST_EXPOSURES:
        warnings.append("All pictures have one exposure: high dynamic range cannot be learned.")
    stops, stops_from = _stops(info, exposures)
    groups, group_of = _lights_of(folder, found.seen)
    lit = {data_set.LIT: len(group_of)} if group_of else {}
    views = dict(Counter(view.split for view in found.seen if view.name not in group_of))
    if VIEWS in views:
        views = {VIEWS: len(found.seen) - len(group_of)}
    elif data_set.TEST not in views:
        warnings.append("There is no test split: the quality cannot be measured.")
    turnable: list[str] = []
    if groups is not None:
        turnable, apart = light_report(groups, Counter(group_of.values()), "view")
        warnings += [f"{each[0].upper()}{each[1:]}." for each in apart]
    return DatasetSummary(
        name=data_set.scene_name(folder, info),
        views={**views, **lit},
        turnable=tuple(turnable),
        size=next(iter(sizes)) if len(sizes) == 1 else None,
        exposures=exposures,
        stops=stops,
        stops_from=stops_from,
        points=found.points,
        layout="photographs" if (folder / data_set.CAPTURE_FILE).is_file() else found.layout.name,
        warnings=tuple(warnings),
    )


def _lights_of(folder: Path, views: Sequence[View]) -> tuple[LightGroups | None, dict[str, str]]:
    """What ``lights.json`` says, and the group of each view under other light, by the view's name."""
    groups = read_light_groups(folder)
    if groups is None:
        return None, {}
    group_of: dict[str, str] = {}
    for view in views:
        inside = [
            path.relative_to(root)
            for path in view.pictures
            for root in (folder, folder / PICTURES)
            if path.is_relative_to(root)
        ]
        group = groups.group_of(view.name, [path.as_posix() for path in inside])
        if group is not None:
            group_of[view.name] = group.name
    return groups, group_of


def _levels(levels: tuple[float, ...]) -> str:
    return ", ".join(f"{level:g}" for level in levels)


# ---- JSON --------------------------------------------------------------------------------------------------


def _transforms(path: Path) -> dict[str, Any]:
    """A transforms_*.json with frames, and the field of view that HDR-NeRF needs."""
    content = read_json_object(path, MAKE_AGAIN)
    frames_of(path, content)
    if not isinstance(content.get("camera_angle_x"), int | float):
        raise FileDamagedError(f"{path} has no 'camera_angle_x'", MAKE_AGAIN)
    return content


def _names(content: dict[str, Any], key: str, file: str, warnings: list[str]) -> tuple[str, ...]:
    """A list of names that may be missing; () and a warning where it is something else."""
    names = content.get(key, [])
    if isinstance(names, list) and all(isinstance(name, str) for name in names):
        return tuple(names)
    warnings.append(f"{file}: '{key}' is {str(names)[:60]!r}, not a list of lights.")
    return ()


def _lit_levels(split: SplitContents, file: str, warnings: list[str]) -> set[float]:
    """The ambient levels of the extra training views; warns where one is not a level."""
    levels = [frame.levels.get(AMBIENT, 1.0) for frame in split.frames]
    right = [level for level in levels if is_number(level) and (level == 0 or level in LEVEL)]
    if len(right) < len(levels):
        wrong = next(level for level in levels if level not in right)
        warnings.append(f"{file}: the lighting level {wrong!r:.80} is not a number of 0 or more.")
    return {float(level) for level in right}


def _split(path: Path, transforms: dict[str, Any], warnings: list[str]) -> SplitContents:
    """A split; ``path`` states its exposures. Warns where it is missing, or one is not a time."""
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


def _check_frames(name: str, split: SplitContents, warnings: list[str]) -> None:
    if not split.pictures:
        return
    without = [frame.stem for frame in split.frames if not frame.seconds]
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
        found = ", ".join(f"{w} × {h} ({name})" for (w, h), name in list(sizes.items())[:NAMED])
        warnings.append(f"The pictures are not of one size: {found}. Training needs one.")
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
