# SPDX-License-Identifier: GPL-3.0-or-later
"""Which folders of a data set hold true radiance, by their names and those of the files in them.

None of the files is ever opened here, and which of them is whose is ``evaluate/truth.py``'s to know. Users
have folders of these names, too (``exr/`` of a shot, or of merged brackets): truth is what is named as truth.
"""

import os
import re
from pathlib import Path

from .. import data_set
from ..colmap import find_model

#: GaussHDR's packaging; HDR-GS's, which has all poses in one folder.
GAUSSHDR, HDR_GS = "images_hdr", "exr"
_NUMBER = r"(?:0|[1-9]\d{0,17})"
#: Folder → how its files are named. HDR-GS's have no zeros before their numbers.
FOLDERS = {
    **{data_set.truth_folder(split): r"hdr_\d+\.exr" for split in data_set.SPLITS},
    GAUSSHDR: r"(?:train|test)_hdr_\d+\.exr",
    HDR_GS: rf"{_NUMBER}\.exr",
}


def holds_truth(root: Path, folder: str) -> bool:
    """Whether ``folder``, one of ``FOLDERS``, is there and a layout's truth: one without any EXR counts, too.

    What is missing is then named by whoever looks for it. ``exr/`` is truth in HDR-GS's packaging alone.
    """
    if not (root / folder).is_dir():
        return False
    if folder == HDR_GS:
        return _is_hdr_gs(root)
    names = _names(root / folder, ".exr")
    return not names or any(re.fullmatch(FOLDERS[folder], name) for name in names)


def truth_there(root: Path) -> list[str]:
    """The folders of true radiance that a data set has."""
    return [folder for folder in FOLDERS if holds_truth(root, folder)]


def _is_hdr_gs(root: Path) -> bool:
    """Whether there is a model, most pictures are ``images/<pose>_<k>``, and ``exr/`` has any ``<pose>.exr``.

    Most: a stray picture does not make it another layout, with another split.
    """
    pictures = [re.fullmatch(rf"({_NUMBER})_\d\.\w+", name) for name in _names(root / "images")]
    poses = [parts.group(1) for parts in pictures if parts]
    if len(poses) <= 0.5 * len(pictures) or find_model(root) is None:
        return False
    truth = _names(root / HDR_GS, ".exr")
    return not truth or not {name.removesuffix(".exr") for name in truth}.isdisjoint(poses)


def _names(folder: Path, suffix: str = "") -> list[str]:
    """Names in a folder, without those that systems hide; none where it is not there."""
    if not folder.is_dir():
        return []
    hidden = (".", "Thumbs.db", "desktop.ini")
    return [name for name in os.listdir(folder) if name.endswith(suffix) and not name.startswith(hidden)]
