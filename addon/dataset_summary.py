# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set's folder holds, in a few lines, and what is wrong with it. No bpy; no pixel is decoded.

It looks at the JSON files and at the headers of pictures, so that a panel can show it at once. The trainer's
own reader checks more when it reads (backend/scene).
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..bridge.errors import BadValueError, FileDamagedError, FileMissingError, PhysHDRError
from ..bridge.limits import EXPOSURE, LEVEL
from ..bridge.regular import read_json_object, regular_file

SPLITS = ("train", "test", "lit")
FORMAT, VERSION = "physhdr-dataset", 1
FINAL, PARTIAL = "dataset.json", "dataset.partial.json"
POINTS = "points3d.ply"
MOST_DIGITS = 12
"""Of a number of points."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
FEWEST_EXPOSURES = 2
"""From one exposure no dynamic range can be learned."""
MOST_STOPS = 1000
"""float32 has 277."""
NAMED = 3
"""So many missing files are named; of the rest the number is told."""

MAKE_AGAIN = "Render the data set again into the same folder: only what is missing is made."
CHOOSE = "Choose the folder that holds transforms_train.json, or render a data set from this scene."


@dataclass(frozen=True)
class DatasetSummary:
    """What ``summarise`` found.

    ``views``: poses in each split that there is. ``size``: width and height in pixels, ``None`` where
    pictures differ or none can be read. ``exposures``: seconds, shortest first, of the training views.
    ``stops``: dynamic range, and ``stops_from``: whether it was measured on the true radiance or only
    follows from the exposures. ``levels``, ``relit_levels``: ambient levels of extra training views and
    of the relit truth. ``lights``: those that the scene has, each with a level of its own; ``lit_lights``:
    those whose levels differ in the extra training views; ``mixtures``: how many settings of the relit truth
    change another light than the ambient one. ``warnings``: what is wrong, in the order of its weight.
    """

    folder: Path
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
    truth: bool = False
    complete: bool = True
    warnings: tuple[str, ...] = field(default=())

    @property
    def evs(self) -> tuple[float, ...]:
        """The exposures as EV: 0 is one second."""
        return tuple(math.log2(seconds) for seconds in self.exposures)

    @property
    def lines(self) -> list[str]:
        """What a panel shows, without the warnings."""
        return lines(self)


def lines(summary: DatasetSummary) -> list[str]:
    """One line each of views and size, exposures, dynamic range, ambient light, lights, points."""
    views = summary.views
    parts = [f"{views.get('train', 0)} training views", f"{views.get('test', 0)} test"]
    if "lit" in views:
        parts.append(f"{views['lit']} under other light")
    size = f", {summary.size[0]} × {summary.size[1]}" if summary.size else ""
    told = [f"{summary.name}: {', '.join(parts)}{size}"]
    if summary.exposures:
        many = "exposures" if len(summary.exposures) > 1 else "exposure"
        told.append(f"{len(summary.exposures)} {many}: EV {', '.join(f'{ev:+.3g}' for ev in summary.evs)}")
    if summary.stops is not None:
        told.append(f"Dynamic range: {summary.stops:.1f} stops ({summary.stops_from})")
    light = []
    if summary.levels:
        light.append(f"trained at {_levels(summary.levels)}")
    if summary.relit_levels:
        light.append(f"truth at {_levels(summary.relit_levels)}")
    if light:
        told.append(f"Ambient light: {'; '.join(light)}")
    if summary.lights:
        parts = [", ".join(summary.lights)]
        if summary.lit_lights:
            parts.append(f"levels to learn from: {', '.join(summary.lit_lights)}")
        if summary.mixtures:
            parts.append(f"truth for {summary.mixtures} mixture{'s' if summary.mixtures > 1 else ''}")
        told.append(f"Lights: {'; '.join(parts)}")
    if summary.points is not None:
        told.append(f"{summary.points} first points")
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
    if not (folder / "transforms_train.json").exists():
        if (folder / PARTIAL).exists():
            raise FileMissingError(f"The data set in {folder} has only just been begun", MAKE_AGAIN)
        raise FileMissingError(f"{folder} is no data set: it has no transforms_train.json", CHOOSE)
    info = _info(folder)
    warnings: list[str] = []
    if (folder / PARTIAL).exists():
        warnings.append(f"The data set is not complete yet. {MAKE_AGAIN}")
    views: dict[str, int] = {}
    brackets: dict[str, dict[str, float]] = {}
    levels: set[float] = set()
    lit_lights = _names(info, "lit_lights", FINAL, warnings)
    for split in SPLITS:
        path = folder / f"transforms_{split}.json"
        if not path.exists():
            continue
        content = _transforms(path)
        frames = content["frames"]
        views[split] = len(frames)
        brackets[split] = _exposures(folder / f"exposure_{split}.json", warnings)
        if split == "lit":
            levels = _lit_levels(frames, path.name, warnings)
            lit_lights = _names(content, "lights", path.name, warnings) or lit_lights
        _check_frames(split, frames, brackets[split], warnings)
    size = _check_pictures(folder, brackets, warnings)
    exposures = _check_exposures(brackets.get("train", {}), warnings)
    if "test" not in views:
        warnings.append("There is no test split: the quality cannot be measured.")
    stops, stops_from = _stops(info, exposures)
    points = _point_count(folder / POINTS, warnings)
    relit = [_number(path.name.removeprefix("level_")) for path in folder.glob("relit/level_*")]
    settings = [path for path in folder.glob("relit/*") if path.is_dir()]
    return DatasetSummary(
        folder=folder,
        name=str(info.get("scene") or folder.resolve().name),
        views=views,
        size=size,
        exposures=exposures,
        stops=stops,
        stops_from=stops_from,
        points=points,
        levels=tuple(sorted(levels)),
        relit_levels=tuple(sorted(level for level in relit if level is not None)),
        # A folder from elsewhere may tell of no others than those that vary.
        lights=_names(info, "lights", FINAL, warnings) or lit_lights,
        lit_lights=lit_lights,
        mixtures=len(settings) - sum(level is not None for level in relit),
        truth=(folder / "test_hdr").is_dir(),
        complete=not (folder / PARTIAL).exists(),
        warnings=tuple(warnings),
    )


def _levels(levels: tuple[float, ...]) -> str:
    return ", ".join(f"{level:g}" for level in levels)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


# ---- JSON --------------------------------------------------------------------------------------------------


def _info(folder: Path) -> dict[str, Any]:
    """dataset.json, or {} where there is none: HDR-NeRF-Syn's own folders have none."""
    if not (folder / FINAL).exists():
        return {}
    info = read_json_object(folder / FINAL, MAKE_AGAIN)
    if info.get("format", FORMAT) != FORMAT:
        raise BadValueError(f"{folder / FINAL} is of the format {info['format']!r}, not {FORMAT}", CHOOSE)
    version = info.get("version", VERSION)
    if not isinstance(version, int) or version > VERSION:
        raise BadValueError(f"{folder / FINAL}: version {version} is not known here", "Update PhysHDR.")
    return info


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


def _lit_levels(frames: list[dict[str, Any]], file: str, warnings: list[str]) -> set[float]:
    """The ambient levels of the extra training views; a warning where one is none."""
    given = [frame.get("lighting_level", 1.0) for frame in frames]
    right = [level for level in given if _is_number(level) and (level == 0 or level in LEVEL)]
    if len(right) < len(given):
        wrong = next(level for level in given if level not in right)
        warnings.append(f"{file}: the lighting level {wrong!r:.80} is no number of 0 or more.")
    return {float(level) for level in right}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _exposures(path: Path, warnings: list[str]) -> dict[str, float]:
    """Picture → seconds, the names without a leading './'."""
    if not path.exists():
        warnings.append(f"{path.name} is missing: the exposures are unknown, and training needs them.")
        return {}
    found = {}
    for name, seconds in read_json_object(path, MAKE_AGAIN).items():
        if not _is_number(seconds) or seconds not in EXPOSURE:
            warnings.append(f"{path.name}: the exposure of {name} is {seconds!r:.80}, no time in seconds.")
        else:
            found[_plain(name)] = float(seconds)
    return found


def _plain(name: str) -> str:
    return name.replace("\\", "/").removeprefix("./")


# ---- checks ------------------------------------------------------------------------------------------------


def _check_frames(
    split: str, frames: list[dict[str, Any]], brackets: dict[str, float], warnings: list[str]
) -> None:
    if not brackets:
        return
    of = {name.rpartition("_")[0] for name in brackets}
    without = [
        stem
        for stem in (_plain(str(frame.get("file_path", "?"))).removesuffix(".png") for frame in frames)
        if stem not in of
    ]
    if without:
        warnings.append(f"exposure_{split}.json names no picture of {_some(without)}.")


def _check_pictures(
    folder: Path, brackets: dict[str, dict[str, float]], warnings: list[str]
) -> tuple[int, int] | None:
    missing, damaged, sizes = [], [], {}
    for names in brackets.values():
        for name in names:
            try:
                with open(regular_file(folder / name), "rb") as file:
                    head = file.read(24)
            except (OSError, PhysHDRError):
                missing.append(name)
                continue
            if len(head) < 24 or head[:8] != PNG_SIGNATURE:
                damaged.append(name)
            else:
                sizes.setdefault(struct.unpack(">II", head[16:24]), name)
    if missing:
        warnings.append(f"Pictures are missing ({len(missing)}): {_some(missing)}. {MAKE_AGAIN}")
    if damaged:
        warnings.append(f"Pictures are no PNG files ({len(damaged)}): {_some(damaged)}.")
    if len(sizes) > 1:
        told = ", ".join(f"{w} × {h} ({name})" for (w, h), name in list(sizes.items())[:NAMED])
        warnings.append(f"The pictures are not of one size: {told}. Training needs one.")
        return None
    return next(iter(sizes), None)


def _check_exposures(train: dict[str, float], warnings: list[str]) -> tuple[float, ...]:
    exposures = tuple(sorted(set(train.values())))
    if train and len(exposures) < FEWEST_EXPOSURES:
        warnings.append("All training pictures have one exposure: high dynamic range cannot be learned.")
    counts = {}
    for name in train:
        stem = name.rpartition("_")[0]
        counts[stem] = counts.get(stem, 0) + 1
    if len(set(counts.values())) > 1:
        odd = min(counts, key=lambda stem: counts[stem])
        warnings.append(f"Not all poses have the same number of exposures: {odd} has {counts[odd]}.")
    return exposures


def _stops(info: dict[str, Any], exposures: tuple[float, ...]) -> tuple[float | None, str]:
    measured = info.get("dynamic_range")
    stops = measured.get("stops") if isinstance(measured, dict) else None
    if _is_number(stops) and abs(stops) < MOST_STOPS:
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
