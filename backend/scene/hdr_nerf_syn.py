# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of HDR-NeRF-Syn's layout and of our own data sets, which extend it (docs/formats.md).

The layout is that of Blender's NeRF scenes with a file of exposures, as HDR-NeRF loads it
(https://github.com/xhuangcv/hdr-nerf). Headers of all pictures are checked here, once; their pixels are
decoded when a view is asked for them.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...bridge import data_set
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.layouts import HDR_NERF_SYN
from ...bridge.layouts.checks import MAKE_AGAIN, exposure, number, path_inside, read_json, require, rigid_pose
from ...bridge.layouts.transforms import frames_of, own_camera
from ...bridge.layouts.truth_folders import truth_there
from ...bridge.lights import AMBIENT, check_lights, in_words, named_levels
from ...bridge.limits import check_level
from .camera import Camera
from .info import ORIGINAL_ANCHOR, read_anchor, read_info
from .lens import RealCamera
from .pictures import picture_size
from .points import read_points
from .poses import PictureFile, Pose, Views, fitted, wrong_size
from .resize import Reduction
from .scene import Scene

#: The name of the layout where a ``dataset.json`` says that the data are ours.
OURS = "PhysHDR"
#: HDR-NeRF's pictures as they are downloaded, and its ``half_res``.
ORIGINAL_SIZE, ORIGINAL_REDUCTION = (800, 800), 2.0


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder. Nothing of the true radiance is opened.

    ``downscale``: None reduces the original 800×800 to 400×400 as HDR-NeRF does, and leaves ours as they are.
    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each
    naming the file, the entry and the remedy.
    """
    root = Path(root)
    info = read_info(root)
    lights = _read_lights(root) if data_set.has_split(root, data_set.LIT) else (AMBIENT,)
    there = {data_set.TRAIN, *data_set.splits_there(root)}
    splits = {split: _read_split(root, split, lights) if split in there else [] for split in data_set.SPLITS}
    every = [pose for poses in splits.values() for pose in poses]
    size = _check_one_size(every)
    _require_one_geometry(root, every)
    if downscale is None:
        downscale = ORIGINAL_REDUCTION if not info and size == ORIGINAL_SIZE else 1.0
    made = Views(root, every, Reduction(downscale))
    views = {split: made.of(poses) for split, poses in splits.items()}
    points_path = root / data_set.POINTS_FILE
    messages = (
        f"split as transforms_*.json say: {', '.join(split for split in data_set.SPLITS if views[split])}",
        *made.messages,
        "exposures from exposure_*.json",
    )
    return Scene(
        root=root,
        name=data_set.scene_name(root, info),
        train=views[data_set.TRAIN],
        test=views[data_set.TEST],
        lit=views[data_set.LIT],
        validation=views[data_set.VALIDATION],
        points=read_points(points_path) if points_path.exists() else None,
        response_anchor=read_anchor(root, info, otherwise=ORIGINAL_ANCHOR),
        info=info,
        lights=lights,
        layout=OURS if info else HDR_NERF_SYN.name,
        messages=messages,
    )


# ---- splits ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Frame:
    """A frame of a transforms file: ``stem`` is ``train/r_3``, without a leading ``./``.

    ``entry``: all that it has.
    """

    stem: str
    index: int
    entry: dict[str, Any]
    lighting_levels: tuple[float, ...]


def _read_lights(root: Path) -> tuple[str, ...]:
    """The lights whose levels differ between the lit views; older data sets name none: the ambient one."""
    path = root / data_set.transforms_file(data_set.LIT)
    try:
        return check_lights(read_json(path).get("lights", [AMBIENT]), str(path))
    except BadValueError as error:
        raise BadValueError(error.message, error.hint or "Fix 'lights' in that file.") from error


def _read_split(root: Path, split: str, lights: tuple[str, ...]) -> list[Pose]:
    transforms_path = root / data_set.transforms_file(split)
    exposure_path = root / data_set.exposure_file(split)
    transforms = read_json(transforms_path)
    require(transforms_path, transforms, "camera_angle_x")
    frames = _read_frames(transforms_path, transforms, lights, is_lit=split == data_set.LIT)
    brackets = _read_exposures(exposure_path)

    poses = []
    for frame in frames:
        bracket = brackets.get(frame.stem, {})
        if sorted(bracket) != list(range(len(bracket))) or not bracket:
            raise DataMismatchError(
                f"{exposure_path} does not match {transforms_path.name}: pose '{frame.stem:.80}' has "
                f"exposures for pictures {sorted(bracket) or 'none'}, expected 0, 1, 2 …",
                f"Add '{frame.stem:.80}_0.png' and so on to {exposure_path.name}, or remove the pose. "
                + MAKE_AGAIN,
            )
        names = [data_set.picture_file(frame.stem, k) for k in range(len(bracket))]
        paths = tuple(path_inside(root, name, transforms_path) for name in names)
        size = _check_bracket(paths, exposure_path)
        camera, lens = _camera(transforms_path, transforms, frame, paths[0], size)
        pictures = {k: PictureFile(path, bracket[k]) for k, path in enumerate(paths)}
        poses.append(Pose(frame.stem, frame.index, camera, pictures, frame.lighting_levels, lens=lens))

    odd = next((pose for pose in poses if len(pose.pictures) != len(poses[0].pictures)), None)
    if odd is not None:
        raise DataMismatchError(
            f"{exposure_path}: pose '{odd.name}' has {len(odd.pictures)} exposures, '{poses[0].name}' has "
            f"{len(poses[0].pictures)}",
            "Give all poses of a split the same number of exposures.",
        )
    return poses


def _read_frames(
    path: Path, transforms: dict[str, Any], lights: tuple[str, ...], is_lit: bool
) -> list[_Frame]:
    frames = []
    for ordinal, (file_path, entry) in enumerate(frames_of(path, transforms)):
        stem = data_set.stem_of(file_path)
        which = f"{ordinal} ('{stem:.80}')"
        levels = _levels(path, entry, f"frame {which}", lights, is_lit)
        rigid_pose(path, require(path, entry, "transform_matrix", f": frame {which}"), which)
        index = data_set.number_of(stem)
        frames.append(_Frame(stem, ordinal if index is None else index, entry, levels))
    if len({frame.index for frame in frames}) != len(frames):
        twice = next(f for f in frames if sum(f.index == g.index for g in frames) > 1)
        raise DataMismatchError(
            f"{path}: two frames have the pose number {twice.index} (one is '{twice.stem:.80}')",
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
            f"{path}: {which}: 'lighting_levels' is {named!r:.80}, not an object",
            'Write it as {"ambient": 0.25} and so on.',
        )
    levels = {str(n): number(path, v, f"{which}: the level of {n!r:.80}") for n, v in named.items()}
    if "lighting_level" in entry:
        ambient = number(path, entry["lighting_level"], f"{which}: 'lighting_level'")
        if levels.setdefault(AMBIENT, ambient) != ambient:
            raise DataMismatchError(
                f"{path}: {which}: 'lighting_level' is {ambient:g}, but 'lighting_levels' has "
                f"{levels[AMBIENT]:g} for {AMBIENT}",
                "Both are the ambient light's: fix one of them.",
            )
    elif is_lit and "lighting_levels" not in entry:
        key = "lighting_level" if lights == (AMBIENT,) else "lighting_levels"
        require(path, entry, key, f": {which}")
    for name, level in levels.items():
        check_level(level, f"{path}: {which}: the lighting level of {name!r:.80}")
    if not is_lit:
        changed = {name: level for name, level in levels.items() if level != 1.0}
        if changed:
            raise BadValueError(
                f"{path}: {which} has the lighting levels {in_words(changed):.200}",
                "All views but those of the split 'lit' are under the standard light, at 1: move it.",
            )
        return (1.0,) * len(lights)
    if levels.get(AMBIENT) == 1.0 and AMBIENT not in lights:
        del levels[AMBIENT]  # as captured: nothing that would have to be learned
    return named_levels(levels, lights, f"{path}: {which}")


def _camera(
    path: Path, transforms: dict[str, Any], frame: _Frame, picture: Path, size: tuple[int, int]
) -> tuple[Camera, RealCamera | None]:
    """The camera at the ``size`` of its pictures, and its lens where that bends straight lines."""
    where = f"frame '{frame.stem:.80}'"
    stated, lens = own_camera(path, where, transforms | frame.entry, size)
    remedy = (
        f"Fix 'w' and 'h' in {path.name}, the picture size that 'fl_x' is for; or remove them: then only "
        "'camera_angle_x' counts."
    )
    real = RealCamera.of(lens)
    camera = fitted(Camera(*stated), size, path, picture, remedy)
    return camera, None if real is None else real.resized(*size)


def _read_exposures(path: Path) -> dict[str, dict[int, float]]:
    """``{"train/r_3": {0: seconds, 1: …}}``; keys may or may not begin with ``./``."""
    brackets: dict[str, dict[int, float]] = {}
    for key, value in read_json(path).items():
        parts = data_set.stem_and_place(key)
        if parts is None:
            raise FileDamagedError(
                f"{path}: '{key:.80}' is not of the form './train/r_3_0.png'", "Fix or remove that entry."
            )
        stem, place = parts
        brackets.setdefault(stem, {})[place] = exposure(path, value, key)
    return brackets


def _check_bracket(paths: tuple[Path, ...], exposure_path: Path) -> tuple[int, int]:
    """``(width, height)`` of a bracket, after looking at each picture's header."""
    following = paths[0].with_name(re.sub(r"_0\.png$", f"_{len(paths)}.png", paths[0].name))
    if following.exists():
        raise DataMismatchError(
            f"{exposure_path} has no exposure for {following}",
            f"Add its exposure in seconds to {exposure_path.name}, or remove the picture.",
        )
    sizes = [picture_size(path) for path in paths]
    for path, size in zip(paths, sizes, strict=True):
        if size != sizes[0]:
            raise wrong_size(path, size, paths[0], sizes[0])
    return sizes[0]


def _check_one_size(poses: list[Pose]) -> tuple[int, int]:
    """``(width, height)`` of all pictures; within each bracket it has been checked."""
    first = poses[0]
    right = (first.camera.width, first.camera.height)
    for pose in poses:
        size = (pose.camera.width, pose.camera.height)
        if size != right:
            raise wrong_size(pose.pictures[0].path, size, first.pictures[0].path, right)
    return right


def _require_one_geometry(root: Path, poses: list[Pose]) -> None:
    """True radiance and pictures show the same; raises ``DataMismatchError`` where a lens is between them.

    Pictures lose its distortion, true radiance is compared as it is.
    """
    truth = [*truth_there(root), *data_set.mixture_folders(root)]
    lens = next((pose.lens for pose in poses if pose.lens is not None), None)
    if truth and lens is not None:
        raise DataMismatchError(
            f"{root}: its lens bends straight lines ({lens.in_words()}), which is removed from pictures, but "
            f"not from the true radiance in {truth[0]}/: they could not be compared",
            f"Undistort pictures and radiance beforehand, and remove k1 and the like from transforms_*.json; "
            f"or move {', '.join(folder + '/' for folder in truth)} away.",
        )
