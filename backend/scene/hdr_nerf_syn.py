# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of HDR-NeRF-Syn's layout and of our own data sets, which extend it (docs/formats.md).

Source of the layout: HDR-NeRF's loader (shared/method.md section 1). Headers of all pictures are checked
here, once; their pixels are decoded when a view is asked for them.
"""

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plyfile

from ...bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    PhysHDRError,
)
from ...bridge.lights import AMBIENT, check_lights, in_words, named_levels
from .camera import Camera
from .pictures import png_size
from .scene import PictureCache, Points, Scene, View

#: The response of HDR-NeRF-Syn at exposure × radiance = 1: the constant of its unit-exposure loss.
ORIGINAL_ANCHOR = (1.0, 0.73)

NAME = "HDR-NeRF-Syn"
#: What a folder must hold to be taken for this layout.
LOOKS_FOR = "transforms_train.json"
#: The version of ``dataset.json`` that is understood.
DATASET_FORMAT, DATASET_VERSION = "physhdr-dataset", 1
#: A rotation's columns may be this far from orthonormal: poses are written with about six digits.
RIGID_TOLERANCE = 1e-3

MAKE_AGAIN = "Make the data set again (only what is missing is rendered), or copy it again."


def is_mine(root: Path) -> bool:
    """Whether ``root`` looks like this layout."""
    return (root / LOOKS_FOR).is_file()


def read_scene(root: Path) -> Scene:
    """Read a data set folder. Nothing of the true radiance is opened.

    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each
    naming the file, the entry and the remedy.
    """
    root = Path(root)
    info = _read_info(root)
    cache = PictureCache()
    lights = _read_lights(root) if _has_split(root, "lit") else (AMBIENT,)
    train = _read_split(root, "train", cache, lights)
    test = _read_split(root, "test", cache, lights) if _has_split(root, "test") else []
    lit = _read_split(root, "lit", cache, lights) if _has_split(root, "lit") else []
    _check_one_size([*train, *test, *lit])
    points_path = root / "points3d.ply"
    return Scene(
        root=root,
        name=str(info.get("scene") or root.resolve().name),
        train=train,
        test=test,
        lit=lit,
        points=read_points(points_path) if points_path.exists() else None,
        response_anchor=_read_anchor(root, info),
        info=info,
        lights=lights,
    )


# ---- JSON --------------------------------------------------------------------------------------------


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileMissingError(f"{path} is missing", MAKE_AGAIN)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise FileDamagedError(
            f"{path} is not valid JSON: line {error.lineno}, column {error.colno}: {error.msg}",
            f"Mend that line. {MAKE_AGAIN}",
        ) from error
    except (UnicodeDecodeError, RecursionError, OSError) as error:
        raise FileDamagedError(f"{path} cannot be read as JSON: {error}", MAKE_AGAIN) from error
    if not isinstance(content, dict):
        raise FileDamagedError(f"{path} holds a {type(content).__name__}, not an object", MAKE_AGAIN)
    return content


def _require(path: Path, content: dict[str, Any], key: str, where: str = "") -> Any:
    if key not in content:
        raise FileDamagedError(
            f"{path}{where} has no '{key}'", f"Add it as docs/formats.md says. {MAKE_AGAIN}"
        )
    return content[key]


def _number(path: Path, value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadValueError(f"{path}: {what} must be a finite number, got {value!r}", "Mend it in that file.")
    return float(value)


def _read_info(root: Path) -> dict[str, Any]:
    path = root / "dataset.json"
    if not path.exists():
        return {}  # the original data sets have none
    info = _read_json(path)
    if info.get("format", DATASET_FORMAT) != DATASET_FORMAT:
        raise BadValueError(
            f"{path}: the format is {info['format']!r}, not '{DATASET_FORMAT}'",
            "Choose a PhysHDR data set, or remove dataset.json to read the folder as plain HDR-NeRF-Syn.",
        )
    if _number(path, info.get("version", DATASET_VERSION), "'version'") > DATASET_VERSION:
        raise BadValueError(
            f"{path}: version {info['version']} is newer than this program knows ({DATASET_VERSION})",
            "Update PhysHDR.",
        )
    return info


def _read_anchor(root: Path, info: dict[str, Any]) -> tuple[float, float] | None:
    """(exposure × radiance, code value); None where a ``dataset.json`` names none.

    Folders without one are HDR-NeRF's own, whose anchor is known.
    """
    if not info:
        return ORIGINAL_ANCHOR
    response = info.get("response")
    anchor = response.get("anchor") if isinstance(response, dict) else None
    if anchor is None:
        return None
    path = root / "dataset.json"
    if not isinstance(anchor, list) or len(anchor) != 2:
        raise BadValueError(
            f"{path}: response.anchor must be [exposure × radiance, code value], got {anchor!r}",
            "Mend it, or remove it: the absolute scale of the radiance is then unknown.",
        )
    light, code = (_number(path, value, "response.anchor") for value in anchor)
    if light <= 0.0 or not 0.0 < code < 1.0:
        raise BadValueError(
            f"{path}: response.anchor {anchor} is outside (0, ∞) × (0, 1)",
            "Give a point at which the response is neither black nor saturated.",
        )
    return light, code


# ---- splits ------------------------------------------------------------------------------------------


def _has_split(root: Path, split: str) -> bool:
    """Whether any of a split's two files is there: half a split is an error, none is no split."""
    return any((root / f"{kind}_{split}.json").exists() for kind in ("transforms", "exposure"))


@dataclass(frozen=True)
class _Frame:
    """A frame of a transforms file: ``stem`` is ``train/r_3``, without a leading ``./``."""

    stem: str
    index: int
    pose: np.ndarray
    lighting_levels: tuple[float, ...]


def _plain(name: str) -> str:
    """A path as the data sets write it, without ``./`` and with forward slashes."""
    return name.replace("\\", "/").removeprefix("./")


def _read_lights(root: Path) -> tuple[str, ...]:
    """The lights whose levels differ between the lit views; older data sets name none: the ambient one."""
    path = root / "transforms_lit.json"
    try:
        return check_lights(_read_json(path).get("lights", [AMBIENT]), str(path))
    except BadValueError as error:
        raise BadValueError(error.message, error.hint or "Mend 'lights' in that file.") from error


def _read_split(root: Path, split: str, cache: PictureCache, lights: tuple[str, ...]) -> list[View]:
    transforms_path = root / f"transforms_{split}.json"
    exposure_path = root / f"exposure_{split}.json"
    transforms = _read_json(transforms_path)
    angle = _number(
        transforms_path, _require(transforms_path, transforms, "camera_angle_x"), "'camera_angle_x'"
    )
    frames = _read_frames(transforms_path, transforms, lights, is_lit=split == "lit")
    brackets = _read_exposures(exposure_path)

    views = []
    for frame in frames:
        bracket = brackets.get(frame.stem, {})
        if sorted(bracket) != list(range(len(bracket))) or not bracket:
            raise DataMismatchError(
                f"{exposure_path} does not match {transforms_path.name}: pose '{frame.stem}' has exposures "
                f"for pictures {sorted(bracket) or 'none'}, expected 0, 1, 2 …",
                f"Add '{frame.stem}_0.png' and so on to {exposure_path.name}, or remove the pose. "
                + MAKE_AGAIN,
            )
        paths = tuple(root / f"{frame.stem}_{k}.png" for k in range(len(bracket)))
        width, height = _check_bracket(paths, exposure_path)
        camera = _camera(transforms_path, frame, width, height, angle)
        exposures = tuple(bracket[k] for k in range(len(bracket)))
        views.append(View(frame.stem, camera, exposures, paths, frame.index, frame.lighting_levels, cache))

    odd = next((view for view in views if len(view.exposures) != len(views[0].exposures)), None)
    if odd is not None:
        raise DataMismatchError(
            f"{exposure_path}: pose '{odd.name}' has {len(odd.exposures)} exposures, '{views[0].name}' has "
            f"{len(views[0].exposures)}",
            "Give all poses of a split the same number of exposures.",
        )
    return views


def _read_frames(
    path: Path, transforms: dict[str, Any], lights: tuple[str, ...], is_lit: bool
) -> list[_Frame]:
    entries = _require(path, transforms, "frames")
    if not isinstance(entries, list) or not entries:
        raise FileDamagedError(f"{path}: 'frames' must be a list with at least one frame", MAKE_AGAIN)
    frames = []
    for number, entry in enumerate(entries):
        where = f": frame {number}"
        if not isinstance(entry, dict):
            raise FileDamagedError(f"{path}{where} is a {type(entry).__name__}, not an object", MAKE_AGAIN)
        file_path = _require(path, entry, "file_path", where)
        if not isinstance(file_path, str):
            raise FileDamagedError(f"{path}{where}: 'file_path' is {file_path!r}, not a text", MAKE_AGAIN)
        stem = _plain(file_path).removesuffix(".png")
        levels = _levels(path, entry, f"frame {number} ('{stem}')", lights, is_lit)
        pose = _pose(
            path, _require(path, entry, "transform_matrix", f"{where} ('{stem}')"), f"{number} ('{stem}')"
        )
        digits = re.search(r"(\d+)$", stem)
        frames.append(_Frame(stem, int(digits.group()) if digits else number, pose, levels))
    if len({frame.index for frame in frames}) != len(frames):
        twice = next(f for f in frames if sum(f.index == g.index for g in frames) > 1)
        raise DataMismatchError(
            f"{path}: two frames have the pose number {twice.index} (one is '{twice.stem}')",
            "Number the poses of a split without repetition: the number names the truth, hdr_003.exr.",
        )
    return frames


def _levels(
    path: Path, entry: dict[str, Any], which: str, lights: tuple[str, ...], is_lit: bool
) -> tuple[float, ...]:
    """The level of each of ``lights`` in a frame: 1 but for lit views, which must say theirs.

    ``lighting_levels`` names lights, those not named are at 1; ``lighting_level`` is the ambient one's.
    """
    named = entry.get("lighting_levels", {})
    if not isinstance(named, dict):
        raise BadValueError(
            f"{path}: {which}: 'lighting_levels' is {named!r}, not an object",
            'Write it as {"ambient": 0.25} and so on.',
        )
    levels = {str(n): _number(path, v, f"{which}: the level of {n!r}") for n, v in named.items()}
    if "lighting_level" in entry:
        ambient = _number(path, entry["lighting_level"], f"{which}: 'lighting_level'")
        if levels.setdefault(AMBIENT, ambient) != ambient:
            raise DataMismatchError(
                f"{path}: {which}: 'lighting_level' is {ambient:g}, but 'lighting_levels' has "
                f"{levels[AMBIENT]:g} for {AMBIENT}",
                "Both are the ambient light's: mend one of them.",
            )
    elif is_lit and "lighting_levels" not in entry:
        key = "lighting_level" if lights == (AMBIENT,) else "lighting_levels"
        _require(path, entry, key, f": {which}")
    for name, level in levels.items():
        if level < 0.0:
            raise BadValueError(
                f"{path}: {which}: the lighting level of {name!r} is {level}",
                "Light cannot be negative: mend it.",
            )
    if not is_lit:
        changed = {name: level for name, level in levels.items() if level != 1.0}
        if changed:
            raise BadValueError(
                f"{path}: {which} has the lighting levels {in_words(changed)}",
                "Training and test views are under the standard light, at 1: move it to the split 'lit'.",
            )
        return (1.0,) * len(lights)
    if levels.get(AMBIENT) == 1.0 and AMBIENT not in lights:
        del levels[AMBIENT]  # as captured: nothing that would have to be learned
    return named_levels(levels, lights, f"{path}: {which}")


def _pose(path: Path, matrix: Any, which: str) -> np.ndarray:
    """``[4, 4]`` float64 camera to world, checked to be a rotation and a translation."""
    remedy = f"Mend 'transform_matrix' of that frame in {path.name}; scale and shear must be removed."
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape != (4, 4):
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a 4×4 matrix of numbers", remedy
        )
    if not np.isfinite(pose).all():
        raise BadValueError(f"{path}: frame {which}: 'transform_matrix' holds NaN or infinity", remedy)
    rotation = pose[:3, :3]
    rigid = (
        np.allclose(rotation.T @ rotation, np.eye(3), atol=RIGID_TOLERANCE)
        and np.linalg.det(rotation) > 0.0
        and np.allclose(pose[3], (0.0, 0.0, 0.0, 1.0), atol=RIGID_TOLERANCE)
    )
    if not rigid:
        raise BadValueError(
            f"{path}: frame {which}: 'transform_matrix' is not a rotation and a translation", remedy
        )
    return pose


def _camera(path: Path, frame: _Frame, width: int, height: int, angle: float) -> Camera:
    try:
        return Camera.from_field_of_view(frame.pose, width, height, angle)
    except PhysHDRError as error:
        raise BadValueError(
            f"{path}: frame '{frame.stem}': {error.message}",
            error.hint or f"Mend 'camera_angle_x' in {path.name}.",
        ) from error


def _read_exposures(path: Path) -> dict[str, dict[int, float]]:
    """``{"train/r_3": {0: seconds, 1: …}}``; keys may or may not begin with ``./``."""
    brackets: dict[str, dict[int, float]] = {}
    for key, value in _read_json(path).items():
        parts = re.fullmatch(r"(.+)_(\d+)\.png", _plain(key))
        if parts is None:
            raise FileDamagedError(
                f"{path}: '{key}' is not of the form './train/r_3_0.png'", "Mend or remove that entry."
            )
        seconds = _number(path, value, f"the exposure of '{key}'")
        if seconds <= 0.0:
            raise BadValueError(
                f"{path}: the exposure of '{key}' is {seconds} s",
                "An exposure must be longer than 0 s: mend it.",
            )
        brackets.setdefault(parts.group(1), {})[int(parts.group(2))] = seconds
    return brackets


def _check_bracket(paths: tuple[Path, ...], exposure_path: Path) -> tuple[int, int]:
    """``(width, height)`` of a bracket, after looking at each picture's header."""
    following = paths[0].with_name(re.sub(r"_0\.png$", f"_{len(paths)}.png", paths[0].name))
    if following.exists():
        raise DataMismatchError(
            f"{exposure_path} has no exposure for {following}",
            f"Add its exposure in seconds to {exposure_path.name}, or remove the picture.",
        )
    sizes = [png_size(path) for path in paths]
    for path, size in zip(paths, sizes, strict=True):
        if size != sizes[0]:
            raise _wrong_size(path, size, paths[0], sizes[0])
    return sizes[0]


def _wrong_size(path: Path, size: tuple[int, int], first: Path, right: tuple[int, int]) -> DataMismatchError:
    return DataMismatchError(
        f"{path} is {size[0]}×{size[1]} pixels, {first} is {right[0]}×{right[1]}",
        "All pictures must have one size: resize it, or delete it and make the data set again.",
    )


def _check_one_size(views: list[View]) -> None:
    first = views[0]
    right = (first.camera.width, first.camera.height)
    for view in views:
        size = (view.camera.width, view.camera.height)
        if size != right:
            raise _wrong_size(view.image_paths[0], size, first.image_paths[0], right)


# ---- points ------------------------------------------------------------------------------------------


def read_points(path: Path) -> Points:
    """The points of a PLY with ``x y z`` and ``red green blue`` (uchar, or float in 0…1).

    Raises ``FileDamagedError`` (not a PLY, truncated, columns missing, no points, NaN).
    """
    remedy = (
        "Make the data set again, write the points as docs/formats.md says, or delete the file: training "
        "then starts from random points."
    )
    try:
        vertex = plyfile.PlyData.read(str(path))["vertex"]
        positions = np.stack([np.asarray(vertex[axis], np.float32) for axis in "xyz"], axis=-1)
        channels = [np.asarray(vertex[name]) for name in ("red", "green", "blue")]
    except (
        plyfile.PlyParseError,
        ValueError,
        KeyError,
        OSError,
        EOFError,
        MemoryError,
        OverflowError,
    ) as error:
        why = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileDamagedError(f"{path} is not a readable point cloud ({why})", remedy) from error
    colours = np.stack([_unit_range(channel) for channel in channels], axis=-1)
    if len(positions) == 0:
        raise FileDamagedError(f"{path} holds no points", remedy)
    if not (np.isfinite(positions).all() and np.isfinite(colours).all()):
        raise FileDamagedError(f"{path} holds NaN or infinity", remedy)
    return Points(positions, np.clip(colours, 0.0, 1.0))


def _unit_range(channel: np.ndarray) -> np.ndarray:
    """A colour channel as float32 in 0…1: bytes are divided by 255, floats are taken as they are."""
    scale = 255.0 if np.issubdtype(channel.dtype, np.integer) else 1.0
    return (channel / scale).astype(np.float32)
