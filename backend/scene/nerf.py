# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of NeRF's synthetic scenes (https://github.com/bmild/nerf) and of all that are laid out as they.

``transforms_train.json``, ``transforms_val.json`` and ``transforms_test.json``: a ``camera_angle_x`` (or the
intrinsics of ``transforms.json``) for all frames of the file, and names without suffix, ``./train/r_0``. Each
frame is ``transforms.json``'s: so is everything but the split and the poses' numbers.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...bridge import data_set
from ...bridge.errors import DataMismatchError, FileMissingError
from ...bridge.layouts import NERF
from ...bridge.layouts.checks import read_json
from ...bridge.layouts.picture_files import pose_number
from ...bridge.layouts.transforms import SPLIT_LISTS, frames_of
from . import nerfstudio
from .scene import Scene, View

#: What stands for the names of the files in messages about all of them.
FILES = data_set.transforms_file("*")


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder, split as its files say.

    ``downscale``, what is raised and what is left out: as of ``transforms.json``.
    """
    root = Path(root)
    scene = nerfstudio.scene_of(root, root / FILES, _as_one(root), downscale)
    named = [
        data_set.transforms_file(split)
        for split in SPLIT_LISTS
        if (root / data_set.transforms_file(split)).exists()
    ]
    return replace(
        scene,
        train=_by_number(scene.train),
        test=_by_number(scene.test),
        validation=_by_number(scene.validation),
        layout=NERF.name,
        of_renders=True,
        messages=(f"split as {', '.join(named)} say", *scene.messages[1:]),
    )


def _as_one(root: Path) -> dict[str, Any]:
    """The files as one ``transforms.json``: what a file says of all its frames is written into each."""
    content: dict[str, Any] = {"frames": []}
    seen: dict[str, str] = {}
    for split, key in SPLIT_LISTS.items():
        path = root / data_set.transforms_file(split)
        if not path.exists():
            continue
        of_all = read_json(path)
        shared = {name: value for name, value in of_all.items() if name != "frames"}
        names = []
        for name, entry in frames_of(path, of_all, fewest=0):
            former = seen.setdefault(data_set.stem_of(name), split)
            if former != split:
                if split == data_set.VALIDATION:
                    continue
                raise DataMismatchError(
                    f"{path}: '{name:.80}' is in {data_set.transforms_file(former)}, too",
                    "Remove it from one of them.",
                )
            names.append(name)
            content["frames"].append(shared | entry)
        content[key] = names
    _refuse_brackets(root, next(iter(seen), ""))
    return content


def _refuse_brackets(root: Path, stem: str) -> None:
    """Raise ``FileMissingError`` for HDR-NeRF's pictures, whose exposures were lost."""
    first = data_set.picture_file(stem, 0)
    # os.path.isfile: that of Path raises where a name is too long; the reader of pictures then says so.
    if os.path.isfile(root / first) and not os.path.isfile(root / f"{stem}.png"):
        raise FileMissingError(
            f"{root / data_set.exposure_file(data_set.TRAIN)} is missing: {first:.80} is part of a bracket",
            'Copy it there, or write it: {"./train/r_0_0.png": 0.125, …}, seconds of each picture.',
        )


def _by_number(views: Sequence[View]) -> list[View]:
    """In the order of the numbers that end their names, which become the views' own; else as they are."""
    numbers = [pose_number(view.name) for view in views]
    if None in numbers or len(set(numbers)) < len(views):
        return list(views)
    numbered = (
        replace(view, index=number) for view, number in zip(views, numbers, strict=True) if number is not None
    )
    return sorted(numbered, key=lambda view: view.index)
