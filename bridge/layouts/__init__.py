# SPDX-License-Identifier: GPL-3.0-or-later
"""Which layout a folder is: the table by which the extension, ``physhdr inspect`` and the trainer all go.

The modules beside read what layouts have in common, and need no library that Blender's Python lacks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .. import data_set
from ..colmap import find_model
from ..errors import PhysHDRError
from ..regular import read_json_object
from .llff import PICTURES as LLFF_PICTURES
from .llff import POSES_FILE
from .picture_files import MASKS, PICTURES, folder_there, split_named
from .transforms import TRANSFORMS_FILE
from .truth_folders import HDR_GS as HDR_GS_TRUTH
from .truth_folders import holds_truth


@dataclass(frozen=True)
class Layout:
    """One layout of data sets.

    ``looks_for``: in words, what a folder of it has. ``matches``: whether a folder is of it, asked in the
    table's order. ``reads``: patterns (``fnmatch``) of the files that its readers open, beside
    ``dataset.json`` and what these files name; nobody reads what else is in the folder.
    """

    name: str
    looks_for: str
    matches: Callable[[Path], bool]
    reads: tuple[str, ...]


def _is_gausshdr(root: Path) -> bool:
    """Whether all names in a model's exposure file say train or test."""
    path = root / data_set.EXPOSURE_FILE
    if find_model(root) is None or not path.exists() or not (root / PICTURES).is_dir():
        return False
    try:
        names = read_json_object(path)
    except PhysHDRError:
        return False  # the next reader says what is wrong with it
    return bool(names) and all(split_named(name) for name in names)


def _is_colmap(root: Path) -> bool:
    return find_model(root) is not None and folder_there(root / PICTURES) is not None


_TRAINING = data_set.transforms_file(data_set.TRAIN)
_TRANSFORMS, _EXPOSURES = data_set.transforms_file("*"), data_set.exposure_file("*")
_MODEL = (f"{PICTURES}/*", f"{MASKS}/*", "sparse/*", data_set.EXPOSURE_FILE)

HDR_NERF_SYN = Layout(
    "HDR-NeRF-Syn",
    f"{_TRAINING} and {data_set.exposure_file(data_set.TRAIN)}",
    data_set.is_layout,
    (_TRANSFORMS, _EXPOSURES, data_set.PARTIAL_FILE, data_set.POINTS_FILE),
)
HDR_NERF_REAL = Layout(
    "HDR-NeRF-Real",
    POSES_FILE,
    lambda root: (root / POSES_FILE).exists(),
    (POSES_FILE, f"{LLFF_PICTURES}/*", f"{LLFF_PICTURES}_*/*", "sparse/*"),
)
GAUSSHDR = Layout(
    "GaussHDR",
    f"{PICTURES}/, sparse/0 and {data_set.EXPOSURE_FILE} with names of train and test",
    _is_gausshdr,
    (*_MODEL, data_set.CAPTURE_FILE),
)
HDR_GS = Layout(
    "HDR-GS",
    f"{PICTURES}/ with 0_0.png and so on, sparse/0 and {HDR_GS_TRUTH}/0.exr",
    lambda root: holds_truth(root, HDR_GS_TRUTH),
    (*_MODEL, f"{HDR_GS_TRUTH}/*"),
)
COLMAP = Layout("COLMAP", f"{PICTURES}/ and sparse/0", _is_colmap, (*_MODEL, f"{PICTURES}_*/*"))
#: NeRF's synthetic scenes: those with exposures beside are HDR-NeRF-Syn.
NERF = Layout("NeRF-Synthetic", _TRAINING, lambda root: (root / _TRAINING).exists(), (_TRANSFORMS,))
#: ``transforms.json`` of nerfstudio and instant-ngp.
NERFSTUDIO = Layout(
    "nerfstudio", TRANSFORMS_FILE, lambda root: (root / TRANSFORMS_FILE).exists(), (TRANSFORMS_FILE,)
)

#: Every layout that is read, in the order in which they are tried.
LAYOUTS = (HDR_NERF_SYN, HDR_NERF_REAL, GAUSSHDR, HDR_GS, COLMAP, NERF, NERFSTUDIO)


def layout_of(root: Path) -> Layout | None:
    """The layout of a folder; None where it is of none. Opens no picture and no true radiance."""
    return next((layout for layout in LAYOUTS if layout.matches(root)), None)


def looked_for() -> str:
    """What a folder lacks that is of no layout, for messages."""
    return "; ".join(f"{layout.looks_for} ({layout.name})" for layout in LAYOUTS)
