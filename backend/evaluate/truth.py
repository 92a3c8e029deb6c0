# SPDX-License-Identifier: GPL-3.0-or-later
"""The true radiance of a data set. Only evaluation may ask for it: no module that trains imports this."""

import re
from dataclasses import dataclass
from pathlib import Path

import torch

from ...bridge.errors import BadValueError
from ..scene.pictures import read_exr


def hdr_truth_path(root: Path, split: str, index: int) -> Path:
    """Where the true radiance of pose ``index`` of ``split`` (train, test, lit) lies: ``hdr_003.exr``."""
    return Path(root) / f"{split}_hdr" / f"hdr_{index:03d}.exr"


def has_hdr_truth(root: Path, split: str) -> bool:
    """Whether the data set knows the true radiance of ``split`` at all (photographs do not)."""
    return (Path(root) / f"{split}_hdr").is_dir()


def hdr_truth(root: Path, split: str, index: int) -> torch.Tensor:
    """``[3, H, W]`` float32 scene-linear radiance; raises what ``read_exr`` raises."""
    return _as_tensor(hdr_truth_path(root, split, index))


@dataclass(frozen=True)
class RelitTruth:
    """The true picture of test pose ``index`` with the ambient light ``level`` times as strong."""

    level: float
    index: int
    path: Path

    def radiance(self) -> torch.Tensor:
        """``[3, H, W]`` float32 scene-linear radiance; raises what ``read_exr`` raises."""
        return _as_tensor(self.path)


def relit_truth(root: Path) -> list[RelitTruth]:
    """All relit true pictures, ordered by level and pose; empty if the data set has none.

    Raises ``BadValueError`` on a folder ``relit/level_…`` whose name is no level.
    """
    found = []
    for folder in (Path(root) / "relit").glob("level_*"):
        try:
            level = float(folder.name.removeprefix("level_"))
        except ValueError:
            level = -1.0
        if not 0.0 <= level < float("inf"):
            raise BadValueError(
                f"{folder} does not name a lighting level", "Rename it to level_0.25 and so on, or remove it."
            )
        for path in folder.glob("hdr_*.exr"):
            number = re.fullmatch(r"hdr_(\d+)", path.stem)
            if number is None:
                raise BadValueError(f"{path} does not name a pose", "Rename it to hdr_003.exr, or remove it.")
            found.append(RelitTruth(level, int(number.group(1)), path))
    return sorted(found, key=lambda truth: (truth.level, truth.index))


def _as_tensor(path: Path) -> torch.Tensor:
    return torch.from_numpy(read_exr(path)).permute(2, 0, 1).contiguous()
