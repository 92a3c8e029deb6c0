# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of plain COLMAP folders: ``images/`` and ``sparse/0``, of bracketed captures or of single ones.

Pictures named ``<pose>_<k>`` are the brackets of poses, of which the model may hold one picture or all; other
pictures are a view each, as are all where most are no brackets. Exposures come from ``exposure.json`` or the
pictures' EXIF (docs/formats.md).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...bridge.colmap import find_model
from ...bridge.data_set import EXPOSURE_FILE, scene_name
from ...bridge.errors import DataMismatchError
from ...bridge.layouts import COLMAP
from ...bridge.layouts.checks import path_inside
from ...bridge.layouts.picture_files import PICTURES, folder_there, mask_beside, picture_there, pictures_in
from .colmap_brackets import (
    Group,
    alike,
    best_of,
    camera_of,
    grouped,
    moved,
    placed,
    single,
    turn,
    with_pictures,
)
from .colmap_model import SparseModel, other_model_messages, read_model
from .exposures import MOST_UNKNOWN, SAY_EXPOSURES, exposures_from_exif, read_exposure_file
from .info import read_anchor, read_info
from .lighting import NO_OTHER_LIGHT, Lighting, by_light
from .poses import (
    PictureFile,
    Pose,
    Views,
    at_size_of_pictures,
    check_numbers,
    mask_messages,
    missing_message,
    numbered,
    size_of_bracket,
    sizes_of,
    skipped_messages,
    split_somehow,
    widest,
)
from .resize import Reduction, capped
from .scene import Points, Scene

#: Cameras of one bracket that are farther apart than this share of the cameras' spread are worth a message.
STEADY = 0.002
#: Those that are turned by more than this, degrees, are as well: some five pixels of 1600.
STEADY_TURN = 0.2


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a COLMAP folder.

    ``downscale``: None is 3DGS's convention, the widest picture at most 1600 pixels wide and all others by
    the same factor. It counts from the pictures that are there, which may be reduced ones (``images_4``).
    Pictures of the model that are missing are skipped and counted. Raises ``FileMissingError``,
    ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each naming the file and the remedy.
    """
    pictures = folder_there(root / PICTURES)
    assert pictures is not None, "the layout has one"
    found = read_poses(root, pictures, MOST_UNKNOWN)
    lighting = by_light(root, [pictures], found.poses)
    train, test, rule = split_somehow(lighting.standard)
    check_numbers(train, "training", pictures)
    check_numbers(test, "test", pictures)
    split = train, test, rule
    return scene_of(found, split, lighting, layout=COLMAP.name, anchor=None, downscale=downscale)


@dataclass(frozen=True, eq=False)
class FoundPoses:
    """Poses with full-size cameras, sorted by name; ``messages`` about them.

    A pose's index is its place in that order, or what ``numbered`` says.
    """

    root: Path
    poses: list[Pose]
    points: Points | None
    messages: tuple[str, ...]


def scene_of(
    found: FoundPoses,
    split: tuple[Sequence[Pose], Sequence[Pose], str],
    lighting: Lighting = NO_OTHER_LIGHT,
    *,
    layout: str,
    anchor: tuple[float, float] | None,
    downscale: float | None,
) -> Scene:
    """A scene of poses; ``split``: training and test poses of the standard light and the rule.

    ``anchor``: where none is stated.
    """
    train, test, rule = split
    factor = capped(widest(found.poses)) if downscale is None else downscale
    views = Views(found.root, found.poses, Reduction(factor, "bicubic"))
    info = read_info(found.root)
    return Scene(
        root=found.root,
        name=scene_name(found.root, info),
        train=views.of(train),
        test=views.of(test),
        lit=views.of(lighting.train),
        points=found.points,
        response_anchor=read_anchor(found.root, info, otherwise=anchor),
        info=info,
        lights=lighting.lights,
        layout=layout,
        messages=(rule, *lighting.messages, *views.messages, *found.messages),
        lit_test=views.of(lighting.test),
    )


def read_poses(root: Path, pictures: Path, most_unknown: float = 0.0) -> FoundPoses:
    """The model's poses with the brackets of each; raises as ``read_scene`` does.

    ``most_unknown``: the share of the poses that the exposure file may leave out. A layout whose split counts
    poses has none to lose.
    """
    folder = find_model(root)
    assert folder is not None, "the layout has one"
    model = read_model(folder)
    stated = read_exposure_file(root / EXPOSURE_FILE) if (root / EXPOSURE_FILE).exists() else None
    spread = float(np.ptp([model.camera(image).position for image in model.images], axis=0).max())
    there = pictures_in(pictures)
    groups, alone, messages = grouped(model, there, spread)
    messages = [*other_model_messages(folder), *messages]
    if pictures.name != PICTURES:
        messages.append(f"pictures from {pictures.name}/, because there is no {PICTURES}/")
    names = (name for group in groups for name in group.names.values())
    paths = {name: picture_there(path_inside(pictures, name, folder)) for name in names}
    sizes, faults = sizes_of(paths.values())
    usable = {name: path for name, path in paths.items() if path in sizes}
    everything, groups = groups, with_pictures(groups, usable)
    share = len(groups) / len(everything)
    messages += skipped_messages("pictures of the model", len(paths), faults, pictures, share)
    for group in groups:
        size_of_bracket([usable[name] for name in group.names.values()], sizes)
    bracketed = any(len(group.names) > 1 for group in groups)
    seconds, message = _exposures(groups, pictures, usable, stated, must=bracketed)
    messages.append(message)
    most_lost = 1.0 if stated is None else most_unknown
    groups, unstated = _of_known(groups, seconds, folder, most_lost)
    messages += unstated
    groups = placed(groups, alone, seconds)
    pair = alike(groups, seconds) if bracketed else None
    if pair:
        messages.append(
            f"names like brackets, but '{pair[0]}' and '{pair[1]}' have one exposure: each picture of the "
            "model is a separate view"
        )
        groups = with_pictures(single(model.images), usable)
        groups, _ = _of_known(groups, seconds, folder, most_lost)
    poses = []
    for order, group in enumerate(groups):
        bracket = {
            k: PictureFile(usable[name], seconds[name], mask_beside(root, name))
            for k, name in group.names.items()
        }
        pose = Pose(group.name, order, camera_of(model, group), bracket, lens=model.lens(best_of(group)))
        poses.append(at_size_of_pictures(pose, sizes, folder))
    if all(len(pose.pictures) == 1 for pose in poses):
        messages.append("one exposure a view: 'physhdr prepare' groups photographs into brackets")
    messages += _unsteady_messages(model, groups, spread)
    skipped = {name for name in paths if name not in usable or name not in seconds}
    used = {name for group in groups for name in group.names.values()} | skipped
    messages += _unused_messages(there, used, pictures)
    missing = missing_message([pose for pose in poses if pose.name not in alone])
    messages += mask_messages(poses)
    return FoundPoses(root, numbered(root, poses), model.points, (*messages, *([missing] if missing else [])))


def _unsteady_messages(model: SparseModel, groups: Sequence[Group], spread: float) -> tuple[str, ...]:
    """A message where cameras of one bracket are far apart or turned."""
    apart = max(moved(model, group) for group in groups)
    turned = max(turn(model, group, image) for group in groups for image in group.registered)
    moves = []
    if apart > STEADY * spread:
        moves.append(f"up to {apart:.2g} units apart ({apart / spread:.1%} of all cameras' spread)")
    if turned > STEADY_TURN:
        moves.append(f"turned by up to {turned:.2g}°")
    takes = "each view takes that of the picture with the most points"
    return (f"cameras of one bracket are {' and '.join(moves)}: {takes}",) if moves else ()


def _unused_messages(there: Sequence[str], used: Iterable[str], pictures: Path) -> tuple[str, ...]:
    """A message on pictures ``there`` that no pose has, mostly because COLMAP could not place them."""
    known = {name.casefold() for name in used}  # some file systems treat a.jpg and a.JPG as one
    unused = [name for name in there if name.casefold() not in known]
    if not unused:
        return ()
    return (
        f"{len(unused)} of {len(there)} pictures in {pictures.name}/ are not used: the model lacks "
        f"them (first: {unused[0]:.200})",
    )


def _exposures(
    groups: list[Group],
    pictures: Path,
    paths: Mapping[str, Path],
    stated: dict[str, float] | None,
    *,
    must: bool,
) -> tuple[dict[str, float], str]:
    """Seconds by picture name, and a message on their origin. ``must``: without any, 1 s is not assumed."""
    names = [name for group in groups for name in group.names.values()]
    if stated is not None:
        by_suffix = {_small_suffix(name): seconds for name, seconds in stated.items()}
        known = {name: stated.get(name, by_suffix.get(_small_suffix(name))) for name in names}
        found = {name: seconds for name, seconds in known.items() if seconds is not None}
        return found, f"exposures from {EXPOSURE_FILE}"
    from_exif = exposures_from_exif([paths[name] for name in names])
    if from_exif is not None:
        known = zip(names, from_exif[0], strict=True)
        return {name: seconds for name, seconds in known if seconds is not None}, from_exif[1]
    if must:
        raise DataMismatchError(
            f"{pictures}: the pictures are named as brackets ({', '.join(names[:3])} …), but nothing "
            f"states their exposures: no {EXPOSURE_FILE}, no EXIF data",
            SAY_EXPOSURES,
        )
    return dict.fromkeys(names, 1.0), "no exposures are known: assuming 1 s for all pictures"


def _small_suffix(name: str) -> str:
    """``a.JPG`` → ``a.jpg``: names that differ only in this are one picture's."""
    stem, dot, suffix = name.rpartition(".")
    return stem + dot + suffix.lower()


def _of_known(
    groups: list[Group], seconds: dict[str, float], folder: Path, most_lost: float
) -> tuple[list[Group], tuple[str, ...]]:
    """The groups without pictures of unknown exposure, and without those that are left with none; messages.

    Raises ``DataMismatchError`` where these are more than a share ``most_lost``; 1: reported already.
    """
    left = [
        Group(group.name, {k: name for k, name in group.names.items() if name in seconds}, group.registered)
        for group in groups
    ]
    lost = [group for group, known in zip(groups, left, strict=True) if not known.names]
    left = [group for group in left if group.names]
    if not lost or most_lost == 1.0:
        return left, ()
    first = next(iter(lost[0].names.values()))
    if len(lost) > most_lost * len(groups):
        raise DataMismatchError(
            f"{EXPOSURE_FILE} has no exposure for '{first}', which {folder} has (as for {len(lost)} "
            f"of {len(groups)} poses)",
            SAY_EXPOSURES,
        )
    message = f"{EXPOSURE_FILE} has no exposure for {len(lost)} of {len(groups)} poses"
    return left, (f"{message}: skipped (first: {first:.200})",)
