# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a data set: how each file in it is called, and when the folder is whole.

The layout is HDR-NeRF-Syn's (https://arxiv.org/abs/2111.14451), with what it does not know added beside;
docs/formats.md says what each file holds. Who makes such a folder, who trains from it, who evaluates with it
and who only tells what is in it take all names from here.

- A *split* is a set of poses: ``transforms_<split>.json``, ``exposure_<split>.json``, a folder of pictures
  and one of true radiance, all named after it. A further split is one more entry of ``SPLITS``.
- A *pose* is named by its split and number: ``train/r_3``, its *stem*. A *picture* is a pose at one *place*
  of its bracket: ``train/r_3_0.png``. A further file for each of them is one more function beside theirs.
- A *mixture* is a setting of the lights under which test poses have true radiance: a folder in ``relit/``.
- A file under its final name is whole. The data set is, once ``dataset.json`` is there and
  ``dataset.partial.json``, which stands for it until then, no longer is. Those from elsewhere have neither.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import BadValueError
from .lights import AMBIENT
from .limits import is_number
from .regular import read_json_object, resolved

FORMAT, VERSION = "physhdr-dataset", 1
#: The ``name`` of the ``generator`` in ``dataset.json``: who rendered the data.
MAKER = "physhdr synth"
INFO_FILE = "dataset.json"
PARTIAL_FILE = "dataset.partial.json"
POINTS_FILE = "points3d.ply"

#: What ``physhdr prepare`` writes into the data sets that it makes of photos, and its "format".
CAPTURE_FILE, CAPTURE_FORMAT = "prepare.json", "physhdr-capture"
#: Beside ``images/`` of captures: {picture's file name: exposure in seconds} (GaussHDR's file).
EXPOSURE_FILE = "exposure.json"

#: Trained from; evaluated with, once a choice is made; trained from, under other light than the rest; choices
#: are made with these, at poses of their own.
TRAIN, TEST, LIT, VALIDATION = "train", "test", "lit", "val"
SPLITS = (TRAIN, TEST, LIT, VALIDATION)
#: Never trained from.
HELD_OUT = (TEST, VALIDATION)
#: Of captures with ``lights.json`` alone: views under other light that are never trained from.
LIT_TEST = "lit_test"

#: The true radiance under other light, and the renders from which all else was derived: evaluation only.
RELIT_FOLDER = "relit"
PASSES_FOLDER = "passes"
#: In the name of a mixture of the ambient light alone, which is the only one of older data sets: so no light
#: may be called this.
LEVEL = "level"
#: The files of a folder of true radiance.
TRUTH_FILES = "hdr_*.exr"

#: A longer number counts nothing that can be counted, and int() refuses those of thousands of digits.
_NUMBER = r"\d{1,18}"


# ---- splits, poses, pictures ---------------------------------------------------------------------------


def transforms_file(split: str) -> str:
    """The poses: ``transforms_train.json``."""
    return f"transforms_{split}.json"


def exposure_file(split: str) -> str:
    """The exposures of all pictures, seconds: ``exposure_train.json``."""
    return f"exposure_{split}.json"


def has_split(root: Path, split: str) -> bool:
    """Whether any of a split's two files is there: half a split is an error, none is no split."""
    return any((root / name).exists() for name in (transforms_file(split), exposure_file(split)))


def is_layout(root: Path) -> bool:
    """Whether a folder has this layout: poses of training views, and exposures or a ``dataset.json``.

    A ``transforms_train.json`` with neither is of NeRF's synthetic scenes, one picture a pose.
    """
    named = (INFO_FILE, PARTIAL_FILE, *map(exposure_file, SPLITS))
    there = (root / transforms_file(TRAIN)).exists()
    return there and any((root / name).exists() for name in named)


def splits_there(root: Path) -> list[str]:
    """The splits that a folder of this layout has, or has half of.

    A ``transforms_val.json`` alone, in data that are not ours, is NeRF's: no exposures, and nothing of ours.
    """
    there = [split for split in SPLITS if has_split(root, split)]
    named = (exposure_file(VALIDATION), INFO_FILE)
    if VALIDATION in there and not any((root / name).exists() for name in named):
        there.remove(VALIDATION)
    return there


def pose_stem(split: str, index: int) -> str:
    """``train/r_3``."""
    return f"{split}/r_{index}"


def picture_file(stem: str, place: int) -> str:
    """``train/r_3_0.png``: the pose's picture at a place of the bracket, 0 the shortest exposure."""
    return f"{stem}_{place}.png"


def plain_name(name: str) -> str:
    """A path as the data sets write it, without ``./`` and with forward slashes."""
    return name.replace("\\", "/").removeprefix("./")


def stem_of(file_path: str) -> str:
    """The stem of a frame's ``file_path``, which may begin with ``./`` and end in ``.png``."""
    return plain_name(file_path).removesuffix(".png")


def number_of(stem: str) -> int | None:
    """The number at the end of a stem, which names the pose's truth; None where it ends in none."""
    digits = re.search(rf"{_NUMBER}$", stem)
    return int(digits.group()) if digits else None


def stem_and_place(picture: str) -> tuple[str, int] | None:
    """``./train/r_3_0.png`` → ``("train/r_3", 0)``; None for a name of another form."""
    parts = re.fullmatch(rf"(.+)_({_NUMBER})\.png", plain_name(picture))
    return (parts.group(1), int(parts.group(2))) if parts else None


# ---- truth ---------------------------------------------------------------------------------------------


def truth_folder(split: str) -> str:
    """``train_hdr``."""
    return f"{split}_hdr"


def truth_file(index: int) -> str:
    """The true radiance of pose ``index`` in a split's truth folder or a mixture's: ``hdr_003.exr``."""
    return f"hdr_{index:03d}.exr"


def truth_number(name: str) -> int | None:
    """The pose of ``hdr_003.exr``; None for a name of another form."""
    number = re.fullmatch(rf"hdr_({_NUMBER})\.exr", name)
    return int(number.group(1)) if number else None


def passes_file(split: str, index: int) -> str:
    """One render of one pose, each light by itself: ``passes/train_003.exr``."""
    return f"{PASSES_FOLDER}/{split}_{index:03d}.exr"


def passes_files(root: Path) -> list[Path]:
    """The renders that are there, by name; not the hidden files of a writer that has not finished."""
    return sorted(path for path in (root / PASSES_FOLDER).glob("*.exr") if not path.name.startswith("."))


def mixture_folder(levels: Mapping[str, float]) -> str:
    """``relit/level_0.25`` for the ambient light alone, else ``relit/ambient_4+pendant_0.25``.

    ``levels``: of the lights that are not at 1.
    """
    if list(levels) == [AMBIENT]:
        return f"{RELIT_FOLDER}/{LEVEL}_{levels[AMBIENT]:g}"
    return f"{RELIT_FOLDER}/" + "+".join(f"{name}_{level:g}" for name, level in levels.items())


def mixture_levels(folder: str) -> dict[str, float]:
    """The levels that the name of a mixture's folder tells; {} where it is of another form."""
    levels = {}
    for part in re.split(r"(?<!\de)\+", folder.removeprefix(f"{RELIT_FOLDER}/")):  # not at 1e+06's sign
        light, _, level = part.rpartition("_")
        try:
            levels[AMBIENT if light == LEVEL else light] = float(level)
        except ValueError:
            return {}
    return levels


def mixture_folders(root: Path) -> list[str]:
    """The folders of all mixtures that are there, in the order of their names: ``relit/level_0.25``."""
    return sorted(f"{RELIT_FOLDER}/{path.name}" for path in (root / RELIT_FOLDER).glob("*") if path.is_dir())


# ---- dataset.json --------------------------------------------------------------------------------------


def is_unfinished(root: Path) -> bool:
    """Whether the data set is being made, or its making was interrupted."""
    return (root / PARTIAL_FILE).exists()


def scene_name(root: Path, info: dict[str, Any]) -> str:
    """What ``dataset.json`` calls the scene, else the folder's name."""
    said = info.get("scene")
    return said if isinstance(said, str) and said else resolved(root).name


def stated_stops(info: dict[str, Any]) -> float | None:
    """The dynamic range that ``dataset.json`` states; None where it states none."""
    measured = info.get("dynamic_range")
    stops = measured.get("stops") if isinstance(measured, dict) else None
    return stops if is_number(stops) else None


def read_info(root: Path, remedy: str) -> dict[str, Any]:
    """``dataset.json`` as it is, checked to be ours; ``{}`` where there is none.

    ``remedy``: the hint where it cannot be read. Raises ``FileDamagedError`` there, and ``BadValueError``
    where it is of another format or of a newer version.
    """
    path = root / INFO_FILE
    if not path.exists():
        return {}  # the original data sets have none
    info = read_json_object(path, remedy)
    if info.get("format", FORMAT) != FORMAT:
        raise BadValueError(
            f"{path} is of the format {info['format']!r:.80}, not '{FORMAT}'",
            f"Choose a PhysHDR data set, or remove {INFO_FILE} to read the folder as plain HDR-NeRF-Syn.",
        )
    version = info.get("version", VERSION)
    if not is_number(version):
        raise BadValueError(
            f"{path}: 'version' must be a finite number, got {version!r:.80}", "Fix it in that file."
        )
    if version > VERSION:
        raise BadValueError(
            f"{path}: version {version:g} is newer than this program knows ({VERSION})", "Update PhysHDR."
        )
    return info
