# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of ``transforms.json``, nerfstudio's and instant-ngp's: a frame is a view at one exposure.

Frames of one camera that are named ``<pose>_<k>`` and have an ``exposure_time`` each, no two the same, are
the bracket of one view.

Poses are camera to world with OpenGL axes, kept as they are; intrinsics stand once or in each frame, with a
lens's distortion as OpenCV numbers it. Sources: nerfstudio's documentation, "Data conventions"; instant-ngp's
"Tips for training NeRF models".
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.data_set import plain_name, scene_name
from ...bridge.errors import BadValueError, DataMismatchError
from ...bridge.layouts import NERFSTUDIO
from ...bridge.layouts.checks import exposure, read_json
from ...bridge.layouts.picture_files import PICTURES, bracket_name
from ...bridge.layouts.transforms import (
    SPLIT_LISTS,
    TRANSFORMS_FILE,
    file_inside,
    frames_of,
    picture_of,
    reduction_of,
    stated_camera,
    stated_lens,
)
from ...bridge.light_groups import LightGroups, groups_of
from ...bridge.regular import regular_file
from .camera import Camera
from .exposures import exposures_from_exif
from .info import read_anchor, read_info
from .lens import RealCamera
from .lighting import Lighting, by_light
from .points import read_points
from .poses import (
    PictureFile,
    Pose,
    Views,
    at_size_of_pictures,
    check_numbers,
    mask_messages,
    numbered,
    sizes_of,
    skipped_messages,
    split_somehow,
)
from .resize import WIDEST, Reduction
from .scene import Points, Scene

#: What to do where only some pictures state their exposure.
SAY_EXPOSURES = (
    f"Give each frame in {TRANSFORMS_FILE} an 'exposure_time' in seconds; or use pictures that still have "
    "the camera's EXIF data, or none of it."
)


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder.

    ``downscale``: None halves pictures until no side of the largest is longer than 1600, as nerfstudio does.
    Frames without a picture are skipped and counted. Raises ``FileMissingError``, ``FileDamagedError``,
    ``DataMismatchError`` or ``BadValueError``, each naming the file, the entry and the remedy.
    """
    path = root / TRANSFORMS_FILE
    return scene_of(root, path, read_json(path), downscale)


def scene_of(root: Path, path: Path, content: dict[str, Any], downscale: float | None) -> Scene:
    """As ``read_scene``, of what ``path`` holds; the first of the scene's messages is about its split."""
    listed = _frames(root, path, content)
    sizes, faults = sizes_of(file for file, _ in listed)
    skipped = skipped_messages("frames", len(listed), faults, root, len(sizes) / len(listed))
    # Each keeps its place among all that are listed: a picture that is added later changes no other number.
    frames = {order: frame for order, frame in enumerate(listed) if frame[0] in sizes}
    seconds, exposure_message = _exposures(path, list(frames.values()))
    reduced = {}
    poses = []
    for (order, (file, frame)), time in zip(frames.items(), seconds, strict=True):
        if time is None:
            continue
        name = file.relative_to(root).as_posix().rsplit(".", 1)[0]
        where = f"frame '{name:.80}'"
        entries = content | frame
        instead, factor = reduction_of(root, path, frame["file_path"])
        reduced |= instead
        stated = stated_camera(path, where, entries, (factor * sizes[file][0], factor * sizes[file][1]))
        lens = RealCamera.of(stated_lens(path, where, entries, stated))
        pictures = {0: PictureFile(file, time, _mask(root, path, where, frame))}
        pose = Pose(name, order, Camera(*stated), pictures, lens=lens)
        poses.append(at_size_of_pictures(pose, sizes, path))
    if all("exposure_time" in frame for _, frame in frames.values()):
        poses = _bracketed(poses)
    folders = [root, root / PICTURES]
    lighting = by_light(root, folders, numbered(root, poses), _stated_light(root, path, content, listed))
    train, validation, test, rule = _split(root, path, content, lighting.standard)
    lit, lit_test = _split_lit(lighting, _lists(root, path, content))
    check_numbers(train, "training", path)
    check_numbers(validation, "validation", path)
    check_numbers(test, "test", path)
    longest = max(max(pose.camera.width, pose.camera.height) for pose in poses)
    reduction = Reduction(_published_factor(longest) if downscale is None else downscale)
    views = Views(root, poses, reduction)
    small = (f"pictures from {there}/, because there is no {folder}/" for folder, there in reduced.items())
    info = read_info(root)
    return Scene(
        root=root,
        name=scene_name(root, info),
        train=views.of(train),
        test=views.of(test),
        lit=views.of(lit),
        points=_points(root, path, content),
        response_anchor=read_anchor(root, info, otherwise=None),
        info=info,
        lights=lighting.lights,
        layout=NERFSTUDIO.name,
        messages=(
            rule,
            *lighting.messages,
            *skipped,
            *small,
            *views.messages,
            exposure_message,
            *mask_messages(poses),
        ),
        validation=views.of(validation),
        lit_test=views.of(lit_test),
    )


def _stated_light(
    root: Path, path: Path, content: dict[str, Any], frames: Sequence[tuple[Path, dict[str, Any]]]
) -> LightGroups | None:
    """The frames by their ``lighting_levels``, as ``lights.json`` would say it; None where none has any.

    Those that stand once are of all frames that have none: the standard light.
    """
    if not any("lighting_levels" in frame for _, frame in frames):
        return None
    standard = content.get("lighting_levels", {})
    groups: dict[str, dict[str, Any]] = {}
    for file, frame in frames:
        levels = frame.get("lighting_levels", standard)
        if not isinstance(levels, dict):
            raise BadValueError(
                f"{path}: frame '{file.name:.80}': 'lighting_levels' is {levels!r:.80}, not an object",
                'Write it as {"pendant": 0} and so on.',
            )
        if levels == standard:
            continue
        name = " + ".join(f"{light} {level}" for light, level in levels.items()) or "as usual"
        group = groups.setdefault(name, {"name": name, "levels": levels, "pictures": []})
        group["pictures"].append(file.relative_to(root).as_posix())
    if not groups:
        return None
    named = dict.fromkeys(light for group in groups.values() for light in group["levels"])
    lights = content.get("lights", list(named))
    return groups_of({"lights": lights, "standard": standard, "groups": list(groups.values())}, path)


def _split_lit(lighting: Lighting, lists: dict[str, set[Path]]) -> tuple[list[Pose], list[Pose]]:
    """Training and test poses under other light: by the lists where there are any."""
    if not any(lists.values()):
        return lighting.train, lighting.test
    every = [*lighting.train, *lighting.test]
    held_out = set().union(*(names for key, names in lists.items() if key != "train_filenames"))
    test = [pose for pose in every if _is_in(pose, held_out)]
    rest = [pose for pose in every if not _is_in(pose, held_out)]
    listed = lists.get("train_filenames")
    return [pose for pose in rest if listed is None or _is_in(pose, listed)], test


def _published_factor(longest: int) -> float:
    factor = 1.0
    while longest / factor > WIDEST:
        factor *= 2.0
    return factor


def _frames(root: Path, path: Path, content: dict[str, Any]) -> list[tuple[Path, dict[str, Any]]]:
    """Each frame's picture and its entry, sorted by the picture's name."""
    frames: dict[Path, dict[str, Any]] = {}
    for name, entry in frames_of(path, content):
        file = picture_of(root, path, name)
        if file in frames:
            raise DataMismatchError(
                f"{path}: two frames have the picture '{name:.80}'", "Remove one of them."
            )
        frames[file] = entry
    return sorted(frames.items())


def _mask(root: Path, path: Path, where: str, frame: dict[str, Any]) -> Path | None:
    """A frame's mask; raises ``FileMissingError`` where it names one that is not there."""
    name = frame.get("mask_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise BadValueError(f"{path}: {where}: 'mask_path' is {name!r:.80}, not a text", "Fix or remove it.")
    remedy = f"Put it there, or remove 'mask_path' of {where}: then all of its picture is compared."
    return regular_file(file_inside(root, path, name), remedy)


def _exposures(
    path: Path, frames: Sequence[tuple[Path, dict[str, Any]]]
) -> tuple[Sequence[float | None], str]:
    """Seconds for each frame, and a message on their origin: ``exposure_time``, EXIF, or 1 s for all.

    None: unknown; the message counts these.
    """
    known = ["exposure_time" in frame for _, frame in frames]
    if any(known):
        if not all(known):
            raise DataMismatchError(
                f"{path}: frame '{frames[known.index(False)][0].name}' has no 'exposure_time', others have",
                "Give each frame one, or none.",
            )
        seconds = [exposure(path, frame["exposure_time"], file.name) for file, frame in frames]
        return seconds, f"exposures from 'exposure_time' in {TRANSFORMS_FILE}"
    from_exif = exposures_from_exif([file for file, _ in frames], SAY_EXPOSURES)
    if from_exif is not None:
        return from_exif
    return [1.0] * len(frames), "no exposures are known: assuming 1 s for all pictures"


def _split(
    root: Path, path: Path, content: dict[str, Any], poses: list[Pose]
) -> tuple[list[Pose], list[Pose], list[Pose], str]:
    """Training, validation and test as ``train_filenames``, ``val_filenames`` and ``test_filenames`` say.

    Validation views that are trained from or are test views, which nerfstudio allows, are no such split.
    Without a list of test views those of validation are the test. Without one of training views, which
    nerfstudio refuses, all frames that no other list has are trained on; without any list, by name or order.
    """
    lists = _lists(root, path, content)
    if "train_filenames" not in lists and not any(lists.values()):
        train, test, rule = split_somehow(poses)
        return train, [], test, rule
    other = "test_filenames" if lists.get("test_filenames") else "val_filenames"
    test = [pose for pose in poses if _is_in(pose, lists.get(other, set()))]
    train = _train(path, lists, poses)
    both = {pose.name for pose in train} & {pose.name for pose in test}
    if both:
        raise DataMismatchError(
            f"{path}: '{min(both)}' is in 'train_filenames' and in '{other}'", "Remove it from one of them."
        )
    validation = []
    if other == "test_filenames":
        validation = [pose for pose in poses if _is_in(pose, lists.get("val_filenames", set()))]
        if {pose.name for pose in validation} & {pose.name for pose in (*train, *test)}:
            validation = []
    if "train_filenames" not in lists:
        named = " and ".join(key for key, names in lists.items() if names)
        rule = (
            f"split as {named} say: training on the other {len(train)} frames, because no list says which to "
            "train on"
        )
        return train, validation, test, rule
    lists_told = f"train_filenames{', val_filenames' if validation else ''} and {other}"
    rest = len(poses) - len(train) - len(validation) - len(test)
    none_of_them = "none of them" if validation else "neither"
    rule = f"split as {lists_told} say" + (f"; {rest} frames are in {none_of_them}" if rest else "")
    return train, validation, test, rule


def _lists(root: Path, path: Path, content: dict[str, Any]) -> dict[str, set[Path]]:
    """The pictures that each list of a split has; only of lists that are there."""
    lists = {}
    for key in SPLIT_LISTS.values():
        names = content.get(key)
        if names is None:
            continue
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise BadValueError(f"{path}: '{key}' is not a list of file names", "Fix it, or remove it.")
        lists[key] = {picture_of(root, path, plain_name(name)) for name in names}
    return lists


def _train(path: Path, lists: dict[str, set[Path]], poses: list[Pose]) -> list[Pose]:
    """The training poses; raises ``DataMismatchError`` where there are none, or a lone list has no frame."""
    if "train_filenames" in lists:
        train = [pose for pose in poses if _is_in(pose, lists["train_filenames"])]
        if train:
            return train
        raise DataMismatchError(f"{path}: no frame is in 'train_filenames'", "Fix that list, or remove it.")
    for key, names in lists.items():
        if names and not any(_is_in(pose, names) for pose in poses):
            raise DataMismatchError(f"{path}: no frame is in '{key}'", "Fix that list, or remove it.")
    train = [pose for pose in poses if not any(_is_in(pose, names) for names in lists.values())]
    if not train:
        named = " and ".join(f"'{key}'" for key, names in lists.items() if names)
        raise DataMismatchError(
            f"{path}: no frame is left for training: all are in {named}",
            "Fix these lists, or remove them.",
        )
    return train


def _is_in(pose: Pose, listed: set[Path]) -> bool:
    return any(picture.path in listed for picture in pose.pictures.values())


def _bracketed(poses: Sequence[Pose]) -> list[Pose]:
    """Poses of one picture each → brackets where names, cameras and exposures say so; else as they are."""
    groups: dict[str, dict[int, Pose]] = {}
    for pose in poses:
        parts = bracket_name(pose.pictures[0].path.name)
        if parts is None:
            return list(poses)
        base = f"{pose.name.rpartition('_')[0]}"
        groups.setdefault(base, {})[parts[1]] = pose
    if sum(map(len, groups.values())) < len(poses) or not all(
        _is_bracket(list(group.values())) for group in groups.values()
    ):
        return list(poses)
    if all(len(group) == 1 for group in groups.values()):
        return list(poses)
    first = min(min(group) for group in groups.values())
    return [
        replace(
            next(iter(group.values())),
            name=name,
            pictures={k - first: group[k].pictures[0] for k in sorted(group)},
        )
        for name, group in groups.items()
    ]


def _is_bracket(poses: Sequence[Pose]) -> bool:
    """Whether pictures are of one camera, at exposures of which no two are the same."""
    first = poses[0]
    seconds = {pose.pictures[0].seconds for pose in poses}
    return len(seconds) == len(poses) and all(
        np.array_equal(pose.camera.camera_to_world, first.camera.camera_to_world)
        and _pinhole(pose.camera) == _pinhole(first.camera)
        and pose.lens == first.lens
        and pose.pictures[0].orientation == first.pictures[0].orientation
        for pose in poses[1:]
    )


def _pinhole(camera: Camera) -> tuple[float, ...]:
    return (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


def _points(root: Path, path: Path, content: dict[str, Any]) -> Points | None:
    name = content.get("ply_file_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise BadValueError(f"{path}: 'ply_file_path' is {name!r:.80}, not a text", "Fix it, or remove it.")
    remedy = (
        f"Copy it there, or remove 'ply_file_path' from {path.name}: first points are then made by stereo."
    )
    return read_points(regular_file(file_inside(root, path, name), remedy))
