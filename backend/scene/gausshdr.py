# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of GaussHDR's packaging, in which it ships HDR-NeRF-Syn, HDR-NeRF-Real and HDR-Plenoxels-Real,
and which ``physhdr prepare`` writes (https://github.com/LiuJF1226/GaussHDR).

``images/<name>_<k>.png`` or ``.jpg``, ``sparse/0`` of COLMAP with one picture a pose, ``exposure.json`` of
seconds by file name. Names say ``train`` or ``test``. Exposures that were not taken have no entry.
"""

from pathlib import Path

from ...bridge.colmap import find_model
from ...bridge.data_set import CAPTURE_FILE, EXPOSURE_FILE, scene_name
from ...bridge.errors import DataMismatchError
from ...bridge.layouts import GAUSSHDR as LAYOUT
from ...bridge.layouts.checks import path_inside
from ...bridge.layouts.picture_files import PICTURES, bracket_name, mask_beside, pose_number
from ...bridge.layouts.truth_folders import GAUSSHDR, holds_truth
from .colmap_model import SparseImage, read_model
from .exposures import read_exposure_file
from .info import ORIGINAL_ANCHOR, read_anchor, read_info
from .lighting import by_light
from .poses import (
    PictureFile,
    Pose,
    Views,
    all_sizes,
    at_size_of_pictures,
    check_numbers,
    mask_messages,
    missing_message,
    numbered,
    split_by_name,
    widest,
)
from .resize import Reduction, capped
from .scene import Scene

#: The resolutions of GaussHDR's paper, by the factor that gives them: HDR-NeRF-Syn, HDR-NeRF-Real and
#: HDR-Plenoxels-Real. Pictures that no factor brings there are another's.
PUBLISHED = {2: (400, 400), 4: (804, 534), 6: (992, 746)}


def published_factor(width: int, height: int) -> float:
    """The reduction that the paper's resolution needs; 3DGS's limit of the width for other pictures."""
    for factor, size in PUBLISHED.items():
        if Reduction(factor).size(width, height) == size:
            return factor
    return capped(width)


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder. Nothing of the true radiance is opened.

    ``downscale``: None takes the published factor, found by the pictures' size (``published_factor``), or
    for a user's own captures 3DGS's limit of the width.
    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each
    naming the file, the entry and the remedy.
    """
    folder = find_model(root)
    assert folder is not None, "the layout has one"
    model = read_model(folder)
    brackets, unused = _brackets(root, model.images)
    sizes = all_sizes([picture.path for bracket in brackets.values() for picture in bracket.values()])
    poses = []
    for order, image in enumerate(model.images):
        name = _base(image)
        bracket = brackets[name]
        number = pose_number(name)
        index = order if number is None else number
        pose = Pose(name, index, model.camera(image), bracket, lens=model.lens(image))
        poses.append(at_size_of_pictures(pose, sizes, folder))
    poses = numbered(root, poses)
    lighting = by_light(root, [root / PICTURES], poses)
    split = split_by_name(lighting.standard)
    if split is None:
        raise DataMismatchError(
            f"{folder}: the names of the pictures do not all say 'train' or 'test', or none is for training",
            "Name them as train_000_0.jpg and test_007_0.jpg, in the model and in exposure.json.",
        )
    for poses_of_split, which in zip(split, ("train", "test"), strict=True):
        check_numbers(poses_of_split, which, folder)

    info = read_info(root)
    if downscale is None:
        own = bool(info) or (root / CAPTURE_FILE).is_file() or len(set(sizes.values())) > 1
        width, height = next(iter(sizes.values()))
        downscale = capped(widest(poses)) if own else published_factor(width, height)
    views = Views(root, poses, Reduction(downscale, "bicubic"))
    train, test = (views.of(poses_of_split) for poses_of_split in split)
    is_synthetic = holds_truth(root, GAUSSHDR)  # it says that the camera is HDR-NeRF-Syn's
    messages = [
        "split by names: they say 'train' or 'test'",
        *lighting.messages,
        *views.messages,
        f"exposures from {EXPOSURE_FILE}",
        missing_message(poses),
        *mask_messages(poses),
        f"{unused} entries of {EXPOSURE_FILE} are of no pose in the model" if unused else None,
    ]
    return Scene(
        root=root,
        name=scene_name(root, info),
        train=train,
        test=test,
        lit=views.of(lighting.train),
        points=model.points,
        response_anchor=read_anchor(root, info, otherwise=ORIGINAL_ANCHOR if is_synthetic else None),
        info=info,
        lights=lighting.lights,
        layout=LAYOUT.name,
        messages=tuple(message for message in messages if message),
        lit_test=views.of(lighting.test),
    )


def _base(image: SparseImage) -> str:
    """``train_r_0`` of ``train_r_0_2.png``; raises ``DataMismatchError`` for a name without a place."""
    parts = bracket_name(image.name)
    if parts is None:
        raise DataMismatchError(
            f"the model's picture '{image.name}' is not named <pose>_<exposure>, as train_000_0.jpg",
            "Rename it in the model and in images/.",
        )
    return parts[0]


def _brackets(root: Path, images: list[SparseImage]) -> tuple[dict[str, dict[int, PictureFile]], int]:
    """The pictures of each of the model's poses, as the exposure file lists them; how many it lists more."""
    path = root / EXPOSURE_FILE
    listed: dict[str, dict[int, PictureFile]] = {}
    for name, seconds in read_exposure_file(path).items():
        parts = bracket_name(name)
        if parts is None:
            raise DataMismatchError(
                f"{path}: '{name}' is not named <pose>_<exposure>, as train_000_0.jpg", "Fix or remove it."
            )
        place = listed.setdefault(parts[0], {})
        if parts[1] in place:
            raise DataMismatchError(
                f"{path}: '{name}' and '{place[parts[1]].path.name}' are the same exposure of one pose",
                "Remove one of them.",
            )
        place[parts[1]] = PictureFile(
            path_inside(root / PICTURES, name, path), seconds, mask_beside(root, name)
        )
    brackets: dict[str, dict[int, PictureFile]] = {}
    for image in images:
        name = _base(image)
        if name in brackets:
            raise DataMismatchError(
                f"the model has two pictures of the pose '{name}', one of them '{image.name}'",
                "This layout has one picture a pose in sparse/0.",
            )
        brackets[name] = dict(sorted(listed.get(name, {}).items()))
        if 0 not in brackets[name]:
            raise DataMismatchError(
                f"{path} has no exposure for '{name}_0', the first picture of a pose in the model",
                "Add it in seconds: exposure 0 must be there, others may be missing.",
            )
    unused = sum(len(bracket) for name, bracket in listed.items() if name not in brackets)
    return brackets, unused
