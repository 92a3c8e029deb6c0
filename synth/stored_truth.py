# SPDX-License-Identifier: GPL-3.0-or-later
"""True radiance that was rendered once and is kept: ``--test-truth FOLDER`` takes it instead of rendering.

A folder holds ``test_003.exr``, ``val_000.exr`` …: RGB as half floats, scene-linear Rec.709, standard light,
in whose header is what the render was (``FACTS``), its camera among it; and ``truth.json``, which describes
all of them: scene, size, rig, seed, samples, and how far it can be trusted. Made by
``lab/tools/keep_truth.py``.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..bridge.data_set import HELD_OUT
from . import exr, folder
from .errors import ConflictError, DamagedFileError, OutputFolderError
from .passes import FACTS, Passes
from .plan import Shot

TRUTH_FILE = "truth.json"
FORMAT, VERSION = "physhdr-truth", 1
#: Options that decide what is seen; with others a kept picture would be another one.
SAME = ("scene", "resolution", "views", "camera_rig", "assets")
#: Elements of a camera's matrix that differ by more are another camera's.
SAME_POSE = 1e-6
#: Significant bits that are kept of a half float's 11: an error of 0.09 % (root mean square), 20 dB below the
#: noise, in exchange for files a sixth smaller.
BITS = 9


def file_name(split: str, index: int) -> str:
    """``test_003.exr``."""
    return f"{split}_{index:03d}.exr"


def rounded(radiance: np.ndarray) -> np.ndarray:
    """float32 of any shape, ≥ 0, each to the nearest half float of ``BITS`` significant bits."""
    step = 1 << (11 - BITS)
    codes = radiance.astype(np.float16).view(np.uint16).astype(np.uint32)
    return ((codes + step // 2) // step * step).astype(np.uint16).view(np.float16).astype(np.float32)


def write(path: Path, radiance: np.ndarray, facts: dict[str, Any]) -> None:
    """Keep a picture [height, width, 3]. ``facts``: what the render was, with ``camera_to_world`` [4][4].

    Raises:
        OutputFolderError: a value is larger than half floats are, or the disk is full.
    """
    small = rounded(np.minimum(radiance, exr.LARGEST_HALF))
    if not np.isfinite(small).all() or radiance.max() > exr.LARGEST_HALF:
        raise OutputFolderError(
            f"'{path}': {radiance.max():g} is more than half floats hold ({exr.LARGEST_HALF:g})",
            "this scene's truth cannot be kept: render it when it is needed",
        )
    text = {FACTS: json.dumps(facts, sort_keys=True)}
    folder.write(path, exr.encode_rgb(small, text, exr.HALF, exr.LEAST_SIZE))


def read(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """A picture [height, width, 3] float32 and its facts, of ``write`` or in float as ``exr`` writes it.

    Raises:
        DamagedFileError: not whole, or not of this program.
    """
    try:
        channels, texts = exr.read_channels(path)
        facts = json.loads(texts[FACTS])
        pose = np.array(facts["camera_to_world"], np.float64)
        if pose.shape != (4, 4):
            raise ValueError("no camera")
        return np.stack([channels[name] for name in "RGB"], -1), facts
    except DamagedFileError as error:  # whose remedy is to render it anew
        raise DamagedFileError(f"'{path}' cannot be read, or is damaged: fetch it again") from error
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(f"'{path}' is damaged ({error!r}): fetch it again") from error


@dataclass(frozen=True)
class StoredTruth:
    """A folder of kept truth, opened for a data set of the same scene, size and rig."""

    root: Path
    info: dict[str, Any]

    @property
    def floors(self) -> dict[str, Any]:
        """``noise_floor``, and ``reference_floor`` where it was measured, with the exposures of both.

        Neither these nor the response that they name need be those of the data set.
        """
        there = [name for name in ("noise_floor", "reference_floor") if self.info.get(name)]
        return {name: {**self.info[name], "exposures": self.info["exposures"]} for name in there}

    def shots(self, shots: list[Shot]) -> list[Shot]:
        """The same, with those marked that are taken from here: all that are never trained from.

        Raises:
            DamagedFileError: one of them is not here.
        """
        for shot in shots:
            path = self.root / file_name(shot.split, shot.index)
            if shot.split in HELD_OUT and not path.exists():
                raise DamagedFileError(
                    f"there is no '{path}': what is kept has fewer {shot.split} views than are asked for, or "
                    "is not complete"
                )
        return [replace(shot, stored=shot.split in HELD_OUT) for shot in shots]

    def passes(self, shot: Shot) -> Passes:
        """The radiance of a pose as if one light gave it all; there is no geometry.

        Raises:
            DamagedFileError: the file is not whole.
            ConflictError: it was rendered from elsewhere.
        """
        path = self.root / file_name(shot.split, shot.index)
        radiance, facts = read(path)
        if np.abs(np.array(facts.pop("camera_to_world")) - shot.pose).max() > SAME_POSE:
            raise ConflictError(
                f"'{path}' was rendered from another place than the rig's {shot.split} view {shot.index}",
                "the scene or its rig has changed since: render the truth again, without --test-truth",
            )
        nothing = np.zeros(radiance.shape[:2], np.float32)
        return Passes(
            {"all": radiance},
            depth=nothing,
            normal=np.zeros_like(radiance),
            index=nothing,
            samples=nothing,
            facts=facts,
        )


def opened(root: Path, options: dict[str, Any]) -> StoredTruth:
    """
    ``options``: what the data set is asked for, as it remembers it.

    Raises:
        DamagedFileError: there is no such folder, or its ``truth.json`` cannot be read.
        ConflictError: it is of another scene, size or rig.
    """
    info = folder.read_json(root / TRUTH_FILE)
    same = info.get("options")
    whole = all(name in info for name in ("noise_floor", "samples", "exposures"))
    ours = info.get("format") == FORMAT and info.get("version") == VERSION
    if not (ours and whole and isinstance(same, dict)):
        raise DamagedFileError(f"'{root / TRUTH_FILE}' is not of this program: choose another --test-truth")
    if other := [name for name in SAME if same.get(name) != options.get(name)]:
        differing = "; ".join(
            f"{name} is {same.get(name)} there, {options.get(name)} asked" for name in other
        )
        raise ConflictError(
            f"the truth in '{root}' was rendered with other options: {differing:.400}",
            "ask for the same, or render the test views here, without --test-truth",
        )
    return StoredTruth(root, info)
